"""What is stored from one update to the next: states, cracks and the vertices with their edges."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.lattice import UNKNOWN
from fleetmap.vectorize.arcs import Arcs

BLOCK = 64
"""Arrays begin at, and grow by, multiples of so many cells: they are rarely copied, and buckets keep their places."""

RIM = 4
"""At least so many unknown cells, and epsilon, lie around what was ever seen: a vertex may be epsilon off the boundary,
and kernels look three cells around it without asking whether they leave the array."""


class Store:
    """Arrays that cover all that was seen of an epoch; see ``index_kernels`` for the records.

    Parameters
    ----------
    low_yx, high_yx : the cells that must have room, half open, in cells of the lattice
    epsilon_cells : the farthest that a vertex may be from the boundary
    """

    def __init__(self, low_yx: tuple[int, int], high_yx: tuple[int, int], epsilon_cells: float) -> None:
        self._rim = RIM + math.ceil(epsilon_cells)
        self.low_yx, shape = _extent(low_yx, high_yx, self._rim)
        self.raw: NDArray[np.uint8] = np.full(shape, UNKNOWN, np.uint8)
        """States of the cells as they were read, and with specks filled:"""
        self.states: NDArray[np.uint8] = np.full(shape, UNKNOWN, np.uint8)
        self.cracks: NDArray[np.uint8] = np.zeros(shape, np.uint8)
        self.seen: NDArray[np.uint8] = np.zeros(shape, np.uint8)
        self._index(1024)

    def _index(self, room: int) -> None:
        """Empty records for so many vertices."""
        from fleetmap.vectorize.index_kernels import BUCKET, COLUMNS

        height, width = self.states.shape
        self.records: NDArray[np.int32] = np.full((room, COLUMNS), -1, np.int32)
        self.local: NDArray[np.int32] = np.full(room, -1, np.int32)
        self.marks: NDArray[np.uint8] = np.zeros(room, np.uint8)
        self.free: NDArray[np.int64] = np.zeros(room, np.int64)
        self.used: NDArray[np.int64] = np.zeros(2, np.int64)
        self.table: NDArray[np.int64] = np.zeros((1 << (2 * room - 1).bit_length(), 2), np.int64)
        self.buckets: NDArray[np.int32] = np.full((height // BUCKET, width // BUCKET), -1, np.int32)
        self.links: NDArray[np.int32] = np.zeros((8 * room, 2), np.int32)
        self.free_links: NDArray[np.int64] = np.array([-1, 0], np.int64)

    def cells_to_cover(self, low_yx: tuple[int, int], high_yx: tuple[int, int]) -> int:
        """How many cells the arrays would have with room for these, too."""
        height, width = self.states.shape
        rows = max(high_yx[0], self.low_yx[0] + height) - min(low_yx[0], self.low_yx[0])
        columns = max(high_yx[1], self.low_yx[1] + width) - min(low_yx[1], self.low_yx[1])
        return int(rows * columns)

    def cover(self, low_yx: tuple[int, int], high_yx: tuple[int, int]) -> None:
        """Make room for more cells; what is stored stays."""
        from fleetmap.vectorize.index_kernels import BUCKET

        height, width = self.states.shape
        ends = (self.low_yx[0] + height, self.low_yx[1] + width)
        if all(
            a + self._rim <= low and high <= b - self._rim
            for a, b, low, high in zip(self.low_yx, ends, low_yx, high_yx, strict=True)
        ):
            return
        low, shape = _extent(
            (min(low_yx[0], self.low_yx[0] + self._rim), min(low_yx[1], self.low_yx[1] + self._rim)),
            (max(high_yx[0], ends[0] - self._rim), max(high_yx[1], ends[1] - self._rim)),
            self._rim,
        )
        y, x = self.low_yx[0] - low[0], self.low_yx[1] - low[1]
        raw, states = np.full(shape, UNKNOWN, np.uint8), np.full(shape, UNKNOWN, np.uint8)
        cracks = np.zeros(shape, np.uint8)
        buckets = np.full((shape[0] // BUCKET, shape[1] // BUCKET), -1, np.int32)
        raw[y : y + height, x : x + width] = self.raw
        states[y : y + height, x : x + width] = self.states
        cracks[y : y + height, x : x + width] = self.cracks
        by, bx = y // BUCKET, x // BUCKET
        buckets[by : by + height // BUCKET, bx : bx + width // BUCKET] = self.buckets
        self.low_yx, self.cracks, self.buckets = low, cracks, buckets
        self.raw, self.states = raw, states
        self.seen = np.zeros(shape, np.uint8)

    def reserve(self, vertices: int, cells: int) -> None:
        """Make room for so many more vertices, whose edges are so many cells long in all."""
        more = int(self.used[1]) + vertices - int(self.used[0])
        if more > len(self.records):
            room = 2 * more
            self.records = _longer(self.records, room, -1)
            self.local = _longer(self.local, room, -1)
            self.marks = _longer(self.marks, room, 0)
            self.free = _longer(self.free, room, 0)
        if 2 * more > len(self.table):
            from fleetmap.vectorize.index_kernels import insert_record

            kept = self.table[self.table[:, 0] != 0]
            self.table = np.zeros((1 << (4 * more - 1).bit_length(), 2), np.int64)
            for key, record in kept.tolist():
                insert_record(self.table, key, record)
        links = int(self.free_links[1]) + 6 * vertices + cells
        if links > len(self.links):
            self.links = _longer(self.links, 2 * links, 0)

    def remember(self, arcs: Arcs, thickness: NDArray[np.uint8]) -> None:
        """Store arcs; ``thickness`` is that of the edge that leaves each corner."""
        from fleetmap.vectorize.store_kernels import remember

        vertices = int(np.count_nonzero(arcs.is_vertex))
        lengths = np.abs(np.diff(arcs.points, axis=0)).sum() if len(arcs.points) else 0
        self.reserve(vertices + 1, int(lengths) // 8)
        remember(
            self.records, self.table, self.buckets, self.links, self.free_links, self.free, self.used, self.cracks,
            *self.low_yx, arcs.points, arcs.offsets, arcs.labels, arcs.closed, thickness, len(arcs), arcs.ends, arcs.at,
            arcs.is_vertex,
        )  # fmt: skip
        if self.free_links[1] >= len(self.links):
            raise AssertionError("the buckets are full: more room was reserved than all edges can take")


def _extent(low_yx: tuple[int, int], high_yx: tuple[int, int], rim: int) -> tuple[tuple[int, int], tuple[int, int]]:
    """Where arrays for these cells and a rim around them begin, and their shape: whole blocks."""
    low = tuple((v - rim) // BLOCK * BLOCK for v in low_yx)
    high = tuple(-(-(v + rim) // BLOCK) * BLOCK for v in high_yx)
    return (low[0], low[1]), (high[0] - low[0], high[1] - low[1])


def _longer(array: NDArray[np.generic], room: int, value: int):  # type: ignore[no-untyped-def]
    result = np.full((room, *array.shape[1:]), value, array.dtype)
    result[: len(array)] = array
    return result
