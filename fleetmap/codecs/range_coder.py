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
    "a number is longer than 34 bits, or 24 in mode 2",
    "more numbers than a payload of this size may hold",
    "a coordinate is farther than 1048576 cells from the lattice's origin",
    "a walk ends at a target that is not there",
    "a thickness is above 255 quarters of a cell",
    "the base has fewer edges than are to be removed",
    "an edge is removed twice",
)
"""In words what went wrong, by its number in ``range_kernels``."""


def start_probabilities(table: bytes) -> NDArray[np.int64]:
    """One byte a context -> the probability that its first decision is 0, out of 2^12."""
    return np.frombuffer(table, np.uint8).astype(np.int64) * 16 + 8


class Writer:
    """Narrows an interval by each decision; ``finish`` names a number within by as few bytes as possible.

    Parameters
    ----------
    table : start probabilities, one byte a context
    """

    def __init__(self, table: bytes) -> None:
        from fleetmap.codecs import range_kernels as k

        self._probabilities = start_probabilities(table)
        self._data = np.empty(MAX_BYTES, np.uint8)
        self._coder = np.array([k.WRITE, 0, 0, 0, 0, 0, 0, 0])
        self._kernels = k
        k.begin(self._coder, self._data)

    def bit(self, context: int, value: int) -> int:
        """Write one decision, whose probability is learned in ``context``."""
        return int(self._kernels.bit(self._coder, self._probabilities, self._data, context, value))

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

    def __init__(self, table: bytes, data: bytes) -> None:
        from fleetmap.codecs import range_kernels as k

        self._probabilities = start_probabilities(table)
        self._data = np.frombuffer(bytearray(data), np.uint8)
        self._coder = np.array([k.READ, 0, 0, 0, 0, 0, 0, 0])
        self._kernels = k
        k.begin(self._coder, self._data)
        check(self._coder)

    def bit(self, context: int, value: int) -> int:
        """Read one decision; ``value`` is ignored."""
        return int(self._kernels.bit(self._coder, self._probabilities, self._data, context, value))

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
