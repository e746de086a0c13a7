"""The edges of a map in bands: what makes a small change to a large map cheap.

A band holds the edges whose lower end lies in one of 64 rows of the lattice. Bands are never changed: a new map shares
all of them but those that it touches, and two maps that share a band needn't compare it.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

BAND_BITS = 6
"""A band is 2^6 lattice rows high, 3.2 m at 5 cm: a delta of a robot that explores touches three to eight of them."""

REASONS = (
    "",
    "the delta speaks of an edge that the base does not have",
    "the delta adds an edge twice, or one that the base has, or its edges are not in canonical order",
    "a coordinate is farther than 1048576 cells from the lattice's origin",
    "a label is not 3 * left + right with two different states",
    "an edge has no length",
    "a thickness is not in 0 to 255 quarters of a cell",
    "an edge of the delta has its upper end first",
)
"""In words what the kernels found, by their numbers."""

NO_ROWS: NDArray[np.int32] = np.zeros((0, 6), np.int32)
NO_EDGES: NDArray[np.int32] = np.zeros((0, 5), np.int32)


class Bands:
    """Rows (y0, x0, y1, x1, label, thickness), int32, in canonical order.

    Parameters
    ----------
    numbers : (b,) y0 >> 6 of each band, ascending; none is empty
    parts : the rows of each, (n_i, 6)
    """

    __slots__ = ("_starts", "_where", "numbers", "parts")

    def __init__(self, numbers: tuple[int, ...], parts: tuple[NDArray[np.int32], ...]) -> None:
        self.numbers, self.parts = numbers, parts
        self._starts: list[int] | None = None
        self._where: dict[int, int] | None = None

    @classmethod
    def of(cls, rows: NDArray[np.int32]) -> Bands:
        """(n, 6) rows in canonical order, cut into bands; they are not checked, and are the bands' from now on."""
        if len(rows) == 0:
            return cls((), ())
        rows.flags.writeable = False
        band = rows[:, 0] >> BAND_BITS
        cuts = [0, *(np.flatnonzero(band[1:] != band[:-1]) + 1).tolist(), len(rows)]
        parts = tuple(rows[a:b] for a, b in zip(cuts, cuts[1:], strict=False))
        return cls(tuple(band[cuts[:-1]].tolist()), parts)

    @property
    def starts(self) -> list[int]:
        """(b + 1,) how many edges lie in the bands before each."""
        if self._starts is None:
            self._starts = list(accumulate(map(len, self.parts), initial=0))
        return self._starts

    def __len__(self) -> int:
        return self.starts[-1]

    def rows(self) -> NDArray[np.int32]:
        """(n, 6) all rows, as a copy."""
        return np.concatenate(self.parts) if self.parts else NO_ROWS.copy()

    @staticmethod
    def touched(
        a: NDArray[np.int32], b: NDArray[np.int32] = NO_EDGES, c: NDArray[np.int32] = NO_EDGES
    ) -> NDArray[np.int64]:
        """The numbers of the bands in which some edges, (k, 5) each, lie or would lie, ascending."""
        from fleetmap.model.band_kernels import numbers_of_bands

        return numbers_of_bands(a, b, c)

    def places(self, numbers: NDArray[np.int64]) -> list[int]:
        """Where the bands of some numbers stand among all; those that there aren't are left out."""
        if self._where is None:
            self._where = dict(zip(self.numbers, range(len(self.numbers)), strict=True))
        where = self._where
        return [where[number] for number in numbers.tolist() if number in where]

    def block(self, places: Sequence[int]) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
        """(n, 6) rows of the bands at ``places``, and (b, 4): number, first and last row + 1 in them, rows before."""
        starts = self.starts
        table, end = [], 0
        for place in places:
            start, end = end, end + starts[place + 1] - starts[place]
            table.append((self.numbers[place], start, end, starts[place]))
        return self.gather(places), np.array(table, np.int64).reshape(-1, 4)

    def gather(self, places: Sequence[int]) -> NDArray[np.int32]:
        """(n, 6) a copy of the rows of the bands at ``places``."""
        return np.concatenate([self.parts[place] for place in places]) if places else NO_ROWS.copy()

    def find(self, edges: NDArray[np.int32]) -> NDArray[np.int64]:
        """(k,) place of each of some edges, (k, 5), in the canonical order; -1 where it is missing."""
        from fleetmap.model.band_kernels import find_places

        return find_places(*self.block(self.places(self.touched(edges))), edges)

    def take(self, places: NDArray[np.int64]) -> NDArray[np.int32]:
        """(k, 6) the rows at some places of the canonical order; each lies in 0 to n - 1."""
        starts = np.array(self.starts)
        band = np.searchsorted(starts, places, "right") - 1
        used, which = np.unique(band, return_inverse=True)
        rows, table = self.block(used.tolist())
        return rows[places - table[which, 3] + table[which, 1]] if len(places) else NO_ROWS.copy()

    def differing(self, other: Bands) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """(n, 6) and (m, 6) rows of the bands that are not the same object in both."""
        if self.numbers == other.numbers:
            pairs = [(a, b) for a, b in zip(self.parts, other.parts, strict=True) if a is not b]
            here, there = [a for a, _ in pairs], [b for _, b in pairs]
        else:
            mine, theirs = (dict(zip(bands.numbers, bands.parts, strict=True)) for bands in (self, other))
            here = [rows for number, rows in mine.items() if theirs.get(number) is not rows]
            there = [rows for number, rows in theirs.items() if mine.get(number) is not rows]
        return tuple(np.concatenate(rows) if rows else NO_ROWS.copy() for rows in (here, there))  # type: ignore[return-value]

    def replaced(self, numbers: Sequence[int], rows: NDArray[np.int32], ends: Sequence[int]) -> Bands:
        """The same bands but for those of some numbers, ascending, whose rows end at ``ends`` of ``rows``."""
        rows.flags.writeable = False
        new = dict(zip(self.numbers, self.parts, strict=True))
        start, fresh = 0, False
        for number, end in zip(numbers, ends, strict=True):
            if end > start:
                fresh |= number not in new
                new[number] = rows[start:end]
            else:
                new.pop(number, None)
            start = end
        if fresh:
            new = dict(sorted(new.items()))
        return Bands(tuple(new), tuple(new.values()))
