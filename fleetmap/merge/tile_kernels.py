"""Integer kernels of the tiles.

Why int64 suffices: |coordinate| < 2^23 with all margins, and an edge spans at most 2^18 along each axis, so products
stay below 2^36; a key has at most 43 bits.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.merge import tiles
from fleetmap.model.kernel import kernel

Ints = NDArray[np.int64]

SHIFT = tiles.SHIFT
KEY_BITS = tiles.KEY_BITS


@kernel("int64(int64, int64, int64)")
def tile_key(level: int, row: int, column: int) -> int:
    """The key of a tile."""
    half = 1 << (KEY_BITS - 1)
    return (((level << KEY_BITS) + row + half) << KEY_BITS) + column + half


@kernel("int64(int64[::1], int64)")
def first_from(keys: Ints, key: int) -> int:
    """The place of the first of ascending keys that is not below ``key``."""
    low, high = 0, len(keys)
    while low < high:
        middle = (low + high) // 2
        if keys[middle] < key:
            low = middle + 1
        else:
            high = middle
    return low


@kernel("UniTuple(int64, 2)(int64, int64, int64, int64, int64, int64, int64)")
def columns_in_row(ay: int, ax: int, by: int, bx: int, row: int, margin: int, shift: int) -> tuple[int, int]:
    """First and last column of the tiles of a row that edge a to b, ay <= by, passes within ``margin`` of.

    The row is one of (ay - margin) >> shift to (by + margin) >> shift. At a margin of 1, half a step and what rounding
    the edge to the lattice may hide is within.
    """
    x_low, x_high = min(ax, bx), max(ax, bx)
    dy, dx = by - ay, bx - ax
    if dy > 0:
        from_low = dx * (max(ay, (row << shift) - margin) - ay)
        from_high = dx * (min(by, ((row + 1) << shift) - 1 + margin) - ay)
        x_low = ax + min(from_low, from_high) // dy
        x_high = ax - (-max(from_low, from_high)) // dy
    return (x_low - margin) >> shift, (x_high + margin) >> shift


@kernel("Tuple((int64[::1], int64[::1]))(int64[:, ::1], int64[::1], int64[::1], int64)")
def enter_tiles(ends: Ints, order: Ints, level: Ints, most: int) -> tuple[Ints, Ints]:
    """Keys and items: each edge, in this order, with each tile of its level that it passes at most one step from.

    Nothing is written down if that would be more than ``most``: then both are empty.
    """
    n = 0
    for i in order:
        shift = SHIFT + level[i]
        for row in range((ends[i, 0] - 1) >> shift, ((ends[i, 2] + 1) >> shift) + 1):
            first, last = columns_in_row(ends[i, 0], ends[i, 1], ends[i, 2], ends[i, 3], row, 1, shift)
            n += last - first + 1
        if n > most:
            return np.empty(0, np.int64), np.empty(0, np.int64)
    keys, items = np.empty(n, np.int64), np.empty(n, np.int64)
    n = 0
    for i in order:
        shift = SHIFT + level[i]
        for row in range((ends[i, 0] - 1) >> shift, ((ends[i, 2] + 1) >> shift) + 1):
            first, last = columns_in_row(ends[i, 0], ends[i, 1], ends[i, 2], ends[i, 3], row, 1, shift)
            for column in range(first, last + 1):
                keys[n], items[n] = tile_key(level[i], row, column), i
                n += 1
    return keys, items
