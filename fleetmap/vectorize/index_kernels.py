"""Numba kernels that find what is stored: vertices by the boundary point they stand for, edges by where they lie.

A *record* is a vertex and the edge that leaves it, a row of ``COLUMNS`` int32. Points and places are (y, x) on the
epoch's lattice; directions as in ``walk_kernels``, those of the cracks along which the boundary leaves and enters the
point. The last vertex of an open arc leaves by no edge (``OUT``, ``NEXT`` -1), its first one is entered by none
(``IN``, ``PREV`` -1). Unused records have the label -1.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.kernel import kernel

AT_Y, AT_X, POINT_Y, POINT_X, OUT, IN, LABEL, NEXT, PREV, THICK = range(10)
COLUMNS = 10

BUCKET = 16
"""Edges are looked up in squares of so many cells."""


@kernel("i8(i8, i8, i8)", inline="always")
def passage_key(y: int, x: int, code: int) -> int:
    """A number above 0 for a passage through a point: by the direction it leaves in, or 4 + the one it ends in."""
    return ((np.int64(y) + (1 << 22)) << 27) | ((np.int64(x) + (1 << 22)) << 3) | code


@kernel("i8(i8, i8)", inline="always")
def slot_of(key: int, mask: int) -> int:
    """Where the search for a key begins."""
    return (((key & 0xFFFFFFFF) * 0x2E3779B1 ^ (key >> 32) * 0x15EBCA6B) >> 15) & mask


@kernel("i8(i8[:,::1], i8)")
def find_record(table: NDArray[np.int64], key: int) -> int:
    """The record of a passage, or -1. ``table``: rows (key, record), a power of two of them, key 0 unused."""
    mask = len(table) - 1
    slot = slot_of(key, mask)
    while table[slot, 0] != 0:
        if table[slot, 0] == key:
            return table[slot, 1]
        slot = (slot + 1) & mask
    return -1


@kernel("void(i8[:,::1], i8, i8)")
def insert_record(table: NDArray[np.int64], key: int, record: int) -> None:
    """Store or replace the record of a passage; there must be room."""
    mask = len(table) - 1
    slot = slot_of(key, mask)
    while table[slot, 0] != 0 and table[slot, 0] != key:
        slot = (slot + 1) & mask
    table[slot, 0], table[slot, 1] = key, record


@kernel("void(i8[:,::1], i8)")
def remove_record(table: NDArray[np.int64], key: int) -> None:
    """Forget a passage; what was moved on past it moves back."""
    mask = len(table) - 1
    slot = slot_of(key, mask)
    while table[slot, 0] != key:
        if table[slot, 0] == 0:
            return
        slot = (slot + 1) & mask
    hole = slot
    while True:
        slot = (slot + 1) & mask
        if table[slot, 0] == 0:
            break
        home = slot_of(table[slot, 0], mask)
        if ((slot - home) & mask) >= ((slot - hole) & mask):
            table[hole, 0], table[hole, 1] = table[slot, 0], table[slot, 1]
            hole = slot
    table[hole, 0] = 0


@kernel("i8(i4[:,::1], i4[:,::1], i4[:,::1], i8, i8, i8, i8, i8[::1], b1)")
def link_edge(
    records: NDArray[np.int32],
    buckets: NDArray[np.int32],
    links: NDArray[np.int32],
    record: int,
    oy: int,
    ox: int,
    limit: int,
    free: NDArray[np.int64],
    add: bool,
) -> int:
    """Put the edge that leaves a record into the buckets that it may touch, or take it out of them.

    ``buckets`` holds the first link of each square, the square at (oy, ox) first; ``links`` rows (record, next link);
    ``free`` the first unused link and how many were ever used. Returns 0, or -1 if ``limit`` links don't suffice.
    """
    head = records[record, NEXT]
    y0, x0 = records[record, AT_Y] - oy, records[record, AT_X] - ox
    y1, x1 = records[head, AT_Y] - oy, records[head, AT_X] - ox
    if y0 > y1:
        y0, x0, y1, x1 = y1, x1, y0, x0
    for row in range(y0 // BUCKET, y1 // BUCKET + 1):
        xa, xb = x0, x1
        if y1 // BUCKET > y0 // BUCKET:
            # Rounded outwards by one cell: a bucket too many does no harm.
            xa = x0 + (max(y0, row * BUCKET) - y0) * (x1 - x0) // (y1 - y0)
            xb = x0 + (min(y1, row * BUCKET + BUCKET) - y0) * (x1 - x0) // (y1 - y0)
            xa, xb = min(xa, xb) - 1, max(xa, xb) + 1
        left, right = max(min(xa, xb), min(x0, x1)), min(max(xa, xb), max(x0, x1))
        for column in range(left // BUCKET, right // BUCKET + 1):
            if add:
                link = free[0]
                if link >= 0:
                    free[0] = links[link, 1]
                else:
                    link = free[1]
                    if link == limit:
                        return -1
                    free[1] += 1
                links[link, 0], links[link, 1] = record, buckets[row, column]
                buckets[row, column] = link
            else:
                before, link = -1, buckets[row, column]
                while link >= 0 and links[link, 0] != record:
                    before, link = link, links[link, 1]
                if link < 0:
                    continue
                if before < 0:
                    buckets[row, column] = links[link, 1]
                else:
                    links[before, 1] = links[link, 1]
                links[link, 1] = free[0]
                free[0] = link
    return 0
