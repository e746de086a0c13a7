"""Numba kernels of the verifier about cells: where states meet, which cells are deep, which face each is in.

Cells are (height, width) with a rim of what lies outside; lattice point (y, x) is the lower left corner of cell (y, x).
Bits: coordinates of edges are at most 2^25 units, so that differences are at most 2^26, cross products 2^53.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.kernel import kernel


@kernel("i8[:,::1](u1[:,::1], u1[:,::1], i4[:,::1], b1, i8)")
def list_runs(
    is_a: NDArray[np.uint8], is_b: NDArray[np.uint8], labels: NDArray[np.int32], apart: bool, unit: int
) -> NDArray[np.int64]:
    """(n, 4) maximal straight runs of boundary between cells that may be a and cells that may be b.

    With ``apart`` there is none between cells of one label.
    """
    height, width = is_a.shape
    runs = np.empty((64, 4), np.int64)
    count = 0
    for axis in range(2):
        dy, dx = (1, 0) if axis == 0 else (0, 1)
        for line in range((height if axis == 0 else width) - 1):
            start = -1
            for k in range((width if axis == 0 else height) + 1):
                meets = False
                if k < (width if axis == 0 else height):
                    y, x = (line, k) if axis == 0 else (k, line)
                    p, q = is_a[y, x] & is_b[y + dy, x + dx], is_b[y, x] & is_a[y + dy, x + dx]
                    meets = (p | q) != 0 and not (apart and labels[y, x] == labels[y + dy, x + dx])
                if meets and start < 0:
                    start = k
                if not meets and start >= 0:
                    if count == len(runs):
                        longer = np.empty((2 * count, 4), np.int64)
                        longer[:count] = runs
                        runs = longer
                    across = (line + 1) * unit
                    if axis == 0:
                        runs[count] = (across, start * unit, across, k * unit)
                    else:
                        runs[count] = (start * unit, across, k * unit, across)
                    count += 1
                    start = -1
    return runs[:count].copy()


@kernel("Tuple((i8[:,::1], i8[::1]))(u1[:,::1], i8, i8, i4[:,::1], u1[:,::1], i8)")
def list_cracks(
    states: NDArray[np.uint8], a: int, b: int, labels: NDArray[np.int32], mine: NDArray[np.uint8], unit: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(n, 4) units of boundary between two states of which one side is ``mine``, and (n,) the label of that side."""
    height, width = states.shape
    cracks, owners = np.empty((64, 4), np.int64), np.empty(64, np.int64)
    count = 0
    for y in range(height):
        for x in range(width):
            if mine[y, x] == 0 or (states[y, x] != a and states[y, x] != b):
                continue
            other = b if states[y, x] == a else a
            for d in range(4):
                ny, nx = y + (d == 1) - (d == 3), x + (d == 0) - (d == 2)
                if ny < 0 or nx < 0 or ny >= height or nx >= width or states[ny, nx] != other:
                    continue
                if count == len(owners):
                    longer, more = np.empty((2 * count, 4), np.int64), np.empty(2 * count, np.int64)
                    longer[:count], more[:count] = cracks, owners
                    cracks, owners = longer, more
                y0, x0 = (y + (d == 1), x + (d == 0))
                cracks[count] = (y0 * unit, x0 * unit, (y0 + (d & 1 == 0)) * unit, (x0 + (d & 1)) * unit)
                owners[count] = labels[y, x]
                count += 1
    return cracks[:count].copy(), owners[:count].copy()


@kernel("void(i8[:,::1], i8[::1], i8, i8, i8, i8, i4[:,::1])")
def fill_cells(
    edges: NDArray[np.int64],
    right: NDArray[np.int64],
    outside: int,
    first_y: int,
    first_x: int,
    unit: int,
    faces: NDArray[np.int32],
) -> None:
    """Write the face that each cell's centre lies in; on an edge, either one's.

    The centre of cell (i, j) is at (first_y + i unit, first_x + j unit); ``right`` is the face right of each edge.
    """
    height, width = faces.shape
    # 1. Every edge crosses the rows of centres with y0 <= y < y1. The last one before each centre counts.
    faces[:] = -1
    for e in range(len(edges)):
        y0, x0, y1, x1 = edges[e]
        dy, dx = y1 - y0, x1 - x0
        for i in range(max(-((first_y - y0) // unit), 0), min(-((first_y - y1) // unit), height)):
            y = first_y + i * unit
            column = -(((first_x - x0) * dy - (y - y0) * dx) // (unit * dy))
            if column >= width:
                continue
            j = max(column, 0)
            other = faces[i, j]
            if other >= 0:
                # Both cross between the same two centres: by place and, from a common vertex, by slope.
                oy0, ox0, oy1, ox1 = edges[other]
                ody, odx = oy1 - oy0, ox1 - ox0
                place, other_place = (x0 - first_x) * dy + (y - y0) * dx, (ox0 - first_x) * ody + (y - oy0) * odx
                order = place // dy - other_place // ody
                if order == 0:
                    order = place % dy * ody - other_place % ody * dy
                if order == 0:
                    order = dx * ody - odx * dy
                if order < 0:
                    continue
            faces[i, j] = e
    # 2. East of it is its right face.
    for i in range(height):
        face = outside
        for j in range(width):
            if faces[i, j] >= 0:
                face = right[faces[i, j]]
            faces[i, j] = face


@kernel("u1[:,::1](u1[:,::1], i8[::1])")
def find_deep(kinds: NDArray[np.uint8], reach: NDArray[np.int64]) -> NDArray[np.uint8]:
    """(height, width) cells all of whose neighbours, up to ``reach[k]`` columns in the k-th row away, are alike.

    What lies beyond the array is as cell (0, 0), which holds for all of its rim.
    """
    height, width = kinds.shape
    # Cells alike to the left and to the right, without end at the rim.
    left, right = np.empty((height, width), np.int32), np.empty((height, width), np.int32)
    for i in range(height):
        run = width
        for j in range(width):
            run = run + 1 if j == 0 or kinds[i, j] == kinds[i, j - 1] else 0
            left[i, j] = run
        run = width
        for j in range(width - 1, -1, -1):
            run = run + 1 if j == width - 1 or kinds[i, j] == kinds[i, j + 1] else 0
            right[i, j] = run
    deep = np.ones((height, width), np.uint8)
    for i in range(height):
        for k in range(1 - len(reach), len(reach)):
            y, most = i + k, reach[abs(k)]
            for j in range(width):
                if y < 0 or y >= height:
                    if kinds[i, j] != kinds[0, 0]:
                        deep[i, j] = 0
                elif kinds[y, j] != kinds[i, j] or left[y, j] < most or right[y, j] < most:
                    deep[i, j] = 0
    return deep
