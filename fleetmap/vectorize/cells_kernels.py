"""Numba kernels that look at cells: their states, and the cracks between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.kernel import kernel

# Literals, since numba compiles globals in: FREE = 0, OCCUPIED = 1, UNKNOWN = 2.


# The cells of a grid are read-only, which numba has no short notation for.
@kernel("void(Array(i1, 2, 'C', readonly=True), u1[:,::1], i8, i8, i8, i8)")
def read_states(
    cells: NDArray[np.int8], states: NDArray[np.uint8], low_y: int, low_x: int, free: int, occupied: int
) -> None:
    """Write the states of cells (-1, or 0 to 100 per cent) into ``states``, cell (0, 0) at (low_y, low_x).

    Up to ``free`` per cent a cell is free, from ``occupied`` on it is occupied, else unknown.
    """
    height, width = cells.shape
    least, most = np.int8(free), np.int8(occupied)
    for i in range(height):
        # Slices, and no index with an offset: only so does the compiler see that it may use vector instructions.
        source, target = cells[i], states[low_y + i, low_x : low_x + width]
        for j in range(width):
            cell = source[j]
            known = np.uint8(0) if cell <= least else np.uint8(2)
            known = np.uint8(1) if cell >= most else known
            target[j] = known if cell >= 0 else np.uint8(2)


@kernel("void(u1[:,::1], u1[:,::1], i8, i8, i8, i8)")
def find_cracks(states: NDArray[np.uint8], cracks: NDArray[np.uint8], y0: int, x0: int, y1: int, x1: int) -> None:
    """Set ``cracks`` for the lattice points y0 <= y < y1, x0 <= x < x1, all at least 1.

    Point (y, x) is the lower left corner of cell (y, x). Bits: a crack, that is cells of different states on both
    its sides, leaves the point to the right (1), up (2), to the left (4), down (8).
    """
    one, two, three = np.uint8(1), np.uint8(2), np.uint8(3)
    for y in range(y0, y1):
        above, above_left = states[y, x0:x1], states[y, x0 - 1 : x1 - 1]
        below, below_left = states[y - 1, x0:x1], states[y - 1, x0 - 1 : x1 - 1]
        out = cracks[y, x0:x1]
        for j in range(x1 - x0):
            here, left, under, corner = above[j], above_left[j], below[j], below_left[j]
            out[j] = (
                np.uint8(here != under)
                | (np.uint8(here != left) << one)
                | (np.uint8(left != corner) << two)
                | (np.uint8(under != corner) << three)
            )


@kernel("i8(u8[:,::1], u1[:,::1], i8, i8, i8, i8, i4[:,::1])")
def find_corners(
    words: NDArray[np.uint64],
    cracks: NDArray[np.uint8],
    y0: int,
    x0: int,
    y1: int,
    x1: int,
    corners: NDArray[np.int32],
) -> int:
    """List the points (y, x) of a window where cracks meet other than straight on; returns how many.

    ``words`` are the rows of ``cracks``, eight points a number. If ``corners`` is too short, -1 is returned.
    """
    count = 0
    most = len(corners)
    one, two, three = np.uint64(1), np.uint64(2), np.uint64(3)
    lowest, every = np.uint64(0x0101010101010101), np.uint64(0xFFFFFFFFFFFFFFFF)
    first, last = x0 >> 3, (x1 + 7) >> 3
    before, beyond = np.uint64(8 * (x0 & 7)), np.uint64(8 * (8 * last - x1))
    for y in range(y0, y1):
        row = words[y]
        for w in range(first, last):
            word = row[w]
            # Left and right, or up and down, are not alike; or all four are there.
            odd = word ^ (word >> two)
            corner = (odd | (odd >> one) | (word & (word >> one) & (word >> two) & (word >> three))) & lowest
            if corner == 0:
                continue
            corner &= every << before if w == first else every
            corner &= every >> beyond if w == last - 1 else every
            if count + 8 > most:
                return -1
            # All eight are written, and those that are none overwritten: that takes no guess which way a branch goes.
            for k in range(8):
                corners[count, 0], corners[count, 1] = y, 8 * w + k
                count += np.int64(corner & one)
                corner >>= np.uint64(8)
    return count
