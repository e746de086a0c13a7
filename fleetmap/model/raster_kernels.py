"""Numba kernels of ``model.raster``. Integers only; each states why 64 bits suffice."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.kernel import kernel


@kernel("void(i8[:,::1], i8[::1], i8, i8, i8, i4[:,::1])")
def add_crossings(
    edges: NDArray[np.int64],
    weights: NDArray[np.int64],
    cell: int,
    low_y: int,
    low_x: int,
    sums: NDArray[np.int32],
) -> None:
    """Add each edge's weight to the first cell centre at or right of it, in every row that it crosses.

    ``edges`` are (y0, x0, y1, x1) with y0 <= y1 in half units, so that a cell (``cell`` half units wide,
    even) has an integer centre. A running sum over a row then gives the winding sum at each centre.
    |coordinate| <= 2^27 (a vector map's in 1/32 of a cell, a merged map's in 0.25 mm): products of two differences
    stay below 2^56.
    """
    height, width = sums.shape
    half = cell // 2
    for k in range(len(edges)):
        if weights[k] == 0:
            continue
        y0, x0, y1, x1 = edges[k, 0], edges[k, 1], edges[k, 2], edges[k, 3]
        # Centres in [y0, y1): half open, so that a vertex is crossed once.
        first = -((half - y0) // cell) - low_y
        end = -((half - y1) // cell) - low_y
        for row in range(max(first, 0), min(end, height)):
            y = (low_y + row) * cell + half
            across = (x0 - half - low_x * cell) * (y1 - y0) + (y - y0) * (x1 - x0)
            column = max(-(-across // (cell * (y1 - y0))), 0)
            if column < width:
                sums[row, column] += weights[k]


SQUARE = 4


@kernel("void(i8[:,::1], i8[::1], i8[:,::1], i8[:,::1], i8, i8, i8, u1[:,::1], u1[:,::1])")
def paint_walls(
    edges: NDArray[np.int64],
    sides: NDArray[np.int64],
    reach: NDArray[np.int64],
    cross_reach: NDArray[np.int64],
    cell: int,
    low_y: int,
    low_x: int,
    free: NDArray[np.uint8],
    blocked: NDArray[np.uint8],
) -> None:
    """Set ``blocked`` where a cell's centre lies within reach of a wall, on one of its blocking sides.

    ``sides`` holds bits 1 (left blocks), 2 (right blocks) and 4 (nothing blocks beyond the ends). Column 0 of ``reach``
    holds for cells that are not free, column 1 for free ones; ``cross_reach`` = floor(reach * length) bounds the cross
    product, which is the distance times the length. |coordinate| <= 2^27, so cross products stay below 2^57.
    """
    height, width = free.shape
    half = cell // 2
    for k in range(len(edges)):
        y0, x0, y1, x1 = edges[k, 0], edges[k, 1], edges[k, 2], edges[k, 3]
        dy, dx = y1 - y0, x1 - x0
        length2 = dy * dy + dx * dx
        far = max(reach[k, 0], reach[k, 1])
        first = (y0 - far - half) // cell - low_y
        end = (y1 + far - half) // cell - low_y + 1
        for row in range(max(first, 0), min(end, height)):
            y = (low_y + row) * cell + half
            # The part of the edge that is near enough in y bounds the columns to look at.
            low, high = max(y0, y - far), min(y1, y + far)
            if low > high:
                continue
            xa, xb = x0, x1
            if dy > 0:
                xa = x0 + (low - y0) * dx // dy
                xb = x0 + (high - y0) * dx // dy
            left = (min(xa, xb) - far - half) // cell - low_x
            right = (max(xa, xb) + 1 + far - half) // cell - low_x + 1
            for column in range(max(left, 0), min(right, width)):
                x = (low_x + column) * cell + half
                # Positive on the left of the edge, 0 on its line: that is on both sides.
                cross = dx * (y - y0) - dy * (x - x0)
                if (cross > 0 and sides[k] & 1 == 0) or (cross < 0 and sides[k] & 2 == 0):
                    continue
                which = 1 if free[row, column] else 0
                along = dx * (x - x0) + dy * (y - y0)
                if sides[k] & SQUARE and (along < 0 or along > length2):
                    near = False
                elif along < 0:
                    near = (x - x0) * (x - x0) + (y - y0) * (y - y0) <= reach[k, which] * reach[k, which]
                elif along > length2:
                    near = (x - x1) * (x - x1) + (y - y1) * (y - y1) <= reach[k, which] * reach[k, which]
                else:
                    near = abs(cross) <= cross_reach[k, which]
                if near:
                    blocked[row, column] = 1
