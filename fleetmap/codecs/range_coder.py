"""A binary range coder with adaptive probabilities: each decision costs about as many bits as it is surprising.

``Writer`` and ``Reader`` are the kernels of ``range_kernels``, one call a decision, for trials and tests; payloads are
coded in kernels from end to end. Whole numbers only: the same bytes on every machine.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

MAX_BYTES = 1 << 16
"""Most bytes that are written."""

REASONS = (
    "",
    "longer than a payload of this mode may be",
    "no range coder writes these first bytes",
    "bytes are left over",
    "the range coder's bytes are damaged, or not the shortest",
    "a number is longer than 34 bits",
    "more numbers than a payload of this size may hold",
    "a coordinate is farther than 1048576 cells from the lattice's origin",
    "a walk ends at a target that is not there",
    "a thickness is above 255 quarters of a cell",
    "the base has fewer edges than are to be removed",
    "an edge is removed twice",
)
"""In words what went wrong, by its number in ``range_kernels``."""


def start_memory(start: bytes, seen: bytes) -> NDArray[np.int64]:
    """What contexts know at first: of each the chance of a 1, out of 256, and how often it counts as seen."""
    chance = np.frombuffer(start, np.uint8).astype(np.int64) * 256 + 128
    return np.frombuffer(seen, np.uint8).astype(np.int64) << 32 | chance << 16 | chance


def count_memory(counts: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The zeros and the ones that kernels have counted, by context."""
    return counts & 0xFFFFFFFF, counts >> 32


class Writer:
    """Narrows an interval by each decision; ``finish`` names a number within by as few bytes as possible.

    Parameters
    ----------
    start, seen : of each context the chance of a 1 at first, out of 256, and how often it counts as seen
    """

    def __init__(self, start: bytes, seen: bytes) -> None:
        from fleetmap.codecs import range_kernels as k

        self._memory = start_memory(start, seen)
        self._data = np.empty(MAX_BYTES, np.uint8)
        self._coder = np.array([k.WRITE, 0, 0, 0, 0, 0, 0, 0])
        self._kernels = k
        k.begin(self._coder, self._data)

    def bit(self, context: int, value: int) -> int:
        """Write one decision, whose chance is learned in ``context``."""
        return int(self._kernels.told(self._coder, self._memory, self._data, context, value))

    def even(self, value: int) -> int:
        """Write one decision that is as likely as not."""
        return int(self._kernels.even(self._coder, self._data, value))

    def finish(self) -> bytes:
        """The bytes so far: the shortest fraction in the interval, and of those the least."""
        self._kernels.finish_writing(self._coder, self._data)
        check(self._coder)
        return self._data[: self._coder[self._kernels.AT]].tobytes()


class Reader:
    """The decisions in ``data``, asked for in the contexts in which they were written.

    It can go on for ever: who reads bounds the number of decisions, and asks ``finish`` whether they were all.
    Its first bytes may be wrong (``ValueError``).
    """

    def __init__(self, start: bytes, seen: bytes, data: bytes) -> None:
        from fleetmap.codecs import range_kernels as k

        self._memory = start_memory(start, seen)
        self._data = np.frombuffer(bytearray(data), np.uint8)
        self._coder = np.array([k.READ, 0, 0, 0, 0, 0, 0, 0])
        self._kernels = k
        k.begin(self._coder, self._data)
        check(self._coder)

    def bit(self, context: int, value: int) -> int:
        """Read one decision; ``value`` is ignored."""
        return int(self._kernels.told(self._coder, self._memory, self._data, context, value))

    def even(self, value: int) -> int:
        """Read one decision that is as likely as not."""
        return int(self._kernels.even(self._coder, self._data, value))

    def finish(self) -> None:
        """Check that the data are what ``Writer.finish`` gives for the decisions that were read.

        Raises
        ------
        ValueError : bytes are left over, or the data are not the shortest ones
        """
        self._kernels.finish_reading(self._coder, self._data)
        check(self._coder)


def check(coder: NDArray[np.int64]) -> None:
    """Raise ``ValueError`` if a coder's status says that anything went wrong."""
    from fleetmap.codecs.range_kernels import STATUS

    if coder[STATUS]:
        raise ValueError(REASONS[coder[STATUS]])
