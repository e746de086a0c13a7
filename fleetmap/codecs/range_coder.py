"""A binary range coder with adaptive probabilities: each decision costs about as many bits as it is surprising.

``Writer`` and ``Reader`` have the same methods, so that one procedure can describe what is written *and* read:
``bit(context, value)`` writes the value and returns it, or returns what it reads and ignores the value.
Whole numbers only: the same bytes on every machine.
"""

from __future__ import annotations

from typing import Protocol

PROBABILITY_BITS = 12
RATE = 5
"""A probability moves 1 / 2^RATE of its way to what has happened."""

_TOP = 1 << 24
_FULL = (1 << 32) - 1


class Coder(Protocol):
    """What ``Writer`` and ``Reader`` have in common."""

    def bit(self, context: int, value: int) -> int:
        """One decision, whose probability is learned in ``context``."""
        ...

    def even(self, value: int) -> int:
        """One decision that is as likely as not."""
        ...


def start_probabilities(table: bytes) -> list[int]:
    """One byte a context -> the probability that its first decision is 0, out of 2^12."""
    return [16 * byte + 8 for byte in table]


class Writer:
    """Narrows an interval by each decision; ``finish`` names a number within by as few bytes as possible.

    Parameters
    ----------
    table : start probabilities, one byte a context
    """

    def __init__(self, table: bytes) -> None:
        self._probabilities = start_probabilities(table)
        # A Python int has room for all carries; messages are short.
        self._low, self._range, self._bytes = 0, _FULL, 4

    def bit(self, context: int, value: int) -> int:
        """Write one decision."""
        zero = self._probabilities[context]
        bound = (self._range >> PROBABILITY_BITS) * zero
        if value:
            self._low += bound
            self._range -= bound
            self._probabilities[context] = zero - (zero >> RATE)
        else:
            self._range = bound
            self._probabilities[context] = zero + (((1 << PROBABILITY_BITS) - zero) >> RATE)
        self._renew()
        return value

    def even(self, value: int) -> int:
        """Write one decision that is as likely as not."""
        half = self._range >> 1
        self._low += half if value else 0
        self._range = self._range - half if value else half
        self._renew()
        return value

    def finish(self) -> bytes:
        """The bytes so far: the shortest fraction in the interval, and of those the least."""
        size, step = 0, 8 * self._bytes
        while -(-self._low >> step) << step >= self._low + self._range:
            size, step = size + 1, step - 8
        return (-(-self._low >> step)).to_bytes(size, "big")

    def _renew(self) -> None:
        while self._range < _TOP:
            self._low <<= 8
            self._range <<= 8
            self._bytes += 1


class Reader:
    """The decisions in ``data``, asked for in the contexts in which they were written.

    It can go on for ever: who reads bounds the number of decisions, and asks ``finish`` whether they were all.
    Its first bytes may be wrong (``ValueError``).
    """

    def __init__(self, table: bytes, data: bytes) -> None:
        self._probabilities = start_probabilities(table)
        self._data, self._at = data, 4
        self._code, self._range = int.from_bytes(data[:4].ljust(4, b"\0"), "big"), _FULL
        if self._code >= self._range:
            raise ValueError("no range coder writes these first bytes")

    def bit(self, context: int, value: int) -> int:
        """Read one decision."""
        zero = self._probabilities[context]
        bound = (self._range >> PROBABILITY_BITS) * zero
        bit = int(self._code >= bound)
        if bit:
            self._code -= bound
            self._range -= bound
            self._probabilities[context] = zero - (zero >> RATE)
        else:
            self._range = bound
            self._probabilities[context] = zero + (((1 << PROBABILITY_BITS) - zero) >> RATE)
        self._renew()
        return bit

    def even(self, value: int) -> int:
        """Read one decision that is as likely as not."""
        half = self._range >> 1
        bit = int(self._code >= half)
        self._code -= half if bit else 0
        self._range = self._range - half if bit else half
        self._renew()
        return bit

    def finish(self) -> None:
        """Check that the data are what ``Writer.finish`` gives for the decisions that were read.

        Raises
        ------
        ValueError : bytes are left over, or the data are not the shortest ones
        """
        step = 8 * (self._at - len(self._data))
        if step < 0:
            raise ValueError(f"{-step // 8} bytes are left over")
        last = self._data[-1] if self._data else 0
        # The interval starts code below the data: neither a lesser number of this length may lie
        # within, nor one of fewer bytes, below (the last byte 0) or above.
        to_shorter = (256 - last) << step
        if self._code >> step or (self._data and (last == 0 or to_shorter < self._range - self._code)):
            raise ValueError("the range coder's bytes are damaged, or not the shortest")

    def _renew(self) -> None:
        while self._range < _TOP:
            byte = self._data[self._at] if self._at < len(self._data) else 0
            self._code = self._code << 8 | byte
            self._range <<= 8
            self._at += 1
