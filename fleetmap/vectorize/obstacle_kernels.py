"""Numba kernels that look behind the boundary of free space: obstacles that touch none, and how thick walls are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.kernel import kernel

NEAR_STEPS = 8
"""An outline of occupied cells is that of a known wall if free space is so few steps through occupied cells away."""

DEEPEST = 12
"""Walls are measured so many cells deep: what is farther behind free space is clutter more often than wall."""

QUANTILE = 0.4
"""This share of the cracks of an arc has less wall behind it than its thickness says. (Measured on 21 real maps and
nine generated ones: more paints what lies between the crumbs behind a ragged wall, less loses wall.)"""


@kernel("b1(u1[:,::1], u1[:,::1], i4[:,::1], i8, i8)")
def is_behind(states: NDArray[np.uint8], seen: NDArray[np.uint8], queue: NDArray[np.int32], y: int, x: int) -> bool:
    """Whether an occupied cell that touches free space is within ``NEAR_STEPS`` of occupied cell (y, x).

    Steps are 8-connected, through occupied cells. ``seen`` is zero before and after; ``queue`` has room for
    (2 ``NEAR_STEPS`` + 1)^2 cells.
    """
    height, width = states.shape
    queue[0, 0], queue[0, 1] = y, x
    seen[y, x] = 1
    count, head, last, steps = 1, 0, 1, 0
    found = False
    while head < count and not found:
        if head == last:
            steps += 1
            last = count
            if steps > NEAR_STEPS:
                break
        y, x = queue[head, 0], queue[head, 1]
        head += 1
        if y < 1 or x < 1 or y >= height - 1 or x >= width - 1:
            continue
        found = states[y, x + 1] == 0 or states[y, x - 1] == 0 or states[y + 1, x] == 0 or states[y - 1, x] == 0
        if steps == NEAR_STEPS:
            continue
        for ny in range(y - 1, y + 2):
            for nx in range(x - 1, x + 2):
                if states[ny, nx] == 1 and not seen[ny, nx]:
                    seen[ny, nx] = 1
                    queue[count, 0], queue[count, 1] = ny, nx
                    count += 1
    for k in range(count):
        seen[queue[k, 0], queue[k, 1]] = 0
    return found


@kernel("void(u1[:,::1], u1[:,::1], i4[:,::1], i4[::1], u1[::1], u1[::1], i8, u1[::1])")
def find_explained(
    states: NDArray[np.uint8],
    seen: NDArray[np.uint8],
    points: NDArray[np.int32],
    offsets: NDArray[np.int32],
    closed: NDArray[np.uint8],
    labels: NDArray[np.uint8],
    arcs: int,
    drop: NDArray[np.uint8],
) -> None:
    """Set ``drop`` for arcs between occupied and unknown that the profile ``share`` leaves out.

    What stays is the outline of occupied cells far from free space, lest they be lost: closed, with the cells inside.
    """
    queue = np.empty(((2 * NEAR_STEPS + 1) ** 2, 2), np.int32)
    for arc in range(arcs):
        if labels[arc] != 5:
            continue
        drop[arc] = 1
        if not closed[arc]:
            continue
        start, end = offsets[arc], offsets[arc + 1]
        area = np.int64(0)
        for m in range(start, end):
            n = m + 1 if m + 1 < end else start
            area += np.int64(points[m, 1]) * points[n, 0] - np.int64(points[m, 0]) * points[n, 1]
        if area < 0:
            continue
        alone = True
        for m in range(start, end):
            n = m + 1 if m + 1 < end else start
            y, x = points[m, 0], points[m, 1]
            # The occupied cell on the left of the crack that leaves the corner.
            up, left = points[n, 0] < y, points[n, 1] < x
            cy = y - 1 if left or up else y
            cx = x - 1 if left or points[n, 0] > y else x
            if is_behind(states, seen, queue, cy, cx):
                alone = False
                break
        if alone:
            drop[arc] = 0


@kernel("void(u1[:,::1], i4[:,::1], i4[::1], u1[::1], u1[::1], i8, u1[::1])")
def measure_depth(
    states: NDArray[np.uint8],
    points: NDArray[np.int32],
    offsets: NDArray[np.int32],
    closed: NDArray[np.uint8],
    labels: NDArray[np.uint8],
    arcs: int,
    thickness: NDArray[np.uint8],
) -> None:
    """Fill the thickness of each arc, in quarters of a cell: a quantile of the depth of the wall behind its cracks.

    At least a cell; 0 for arcs that are no obstacles. The depth behind a crack is that of the occupied cells straight
    behind it, up to ``DEEPEST``.
    """
    histogram = np.empty(DEEPEST + 1, np.int64)
    for arc in range(arcs):
        thickness[arc] = 0
        if labels[arc] != 1:
            continue
        histogram[:] = 0
        total = 0
        start, end = offsets[arc], offsets[arc + 1]
        for m in range(start, end):
            n = m + 1
            if n == end:
                if not closed[arc]:
                    break
                n = start
            y, x = points[m, 0], points[m, 1]
            dy, dx = np.sign(points[n, 0] - y), np.sign(points[n, 1] - x)
            while y != points[n, 0] or x != points[n, 1]:
                # The occupied cell on the right of the step, and those behind it.
                cy, cx = y - (dx > 0) - (dy < 0), x - (dx < 0) - (dy < 0)
                depth = 0
                while depth < DEEPEST and states[cy, cx] == 1:
                    depth += 1
                    cy -= dx
                    cx += dy
                histogram[depth] += 1
                total += 1
                y += dy
                x += dx
        below = 0
        quarters = 4
        for depth in range(1, DEEPEST + 1):
            if below + histogram[depth] >= QUANTILE * total:
                # Between whole cells by how far into its class the quantile lies.
                share = (QUANTILE * total - below) / max(histogram[depth], 1)
                quarters = int(np.floor(4.0 * (depth + share - QUANTILE) + 0.5))
                break
            below += histogram[depth]
        thickness[arc] = max(quarters, 4)
