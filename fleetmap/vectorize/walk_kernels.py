"""Numba kernels that walk along cracks: arcs between nodes, and closed ones.

Directions: 0 to the right, 1 up, 2 to the left, 3 down. Whoever leaves a lattice point has a cell to the left and
one to the right, and arcs are walked with the lesser state on the left (FREE = 0, OCCUPIED = 1, UNKNOWN = 2).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.kernel import kernel

VISITED = 16
"""Bit of ``cracks``: the passage through the point's right crack was walked."""

NODE = -1
"""Instead of a direction: three states meet, and all walks end."""


@kernel("i8(i8)", inline="always")
def step_y(d: int) -> int:
    """By how much a step in direction d goes up; a table would be built anew for each step."""
    return np.int64(d == 1) - np.int64(d == 3)


@kernel("i8(i8)", inline="always")
def step_x(d: int) -> int:
    """By how much a step in direction d goes to the right."""
    return np.int64(d == 0) - np.int64(d == 2)


@kernel("i8(u1[:,::1], i8, i8, i8)", inline="always")
def left_of(states: NDArray[np.uint8], y: int, x: int, d: int) -> int:
    """State on the left of the crack that leaves point (y, x) in direction d."""
    return states[y - (d >= 2), x - (d == 1 or d == 2)]


@kernel("i8(u1[:,::1], i8, i8, i8)", inline="always")
def right_of(states: NDArray[np.uint8], y: int, x: int, d: int) -> int:
    """State on the right of the crack that leaves point (y, x) in direction d."""
    return states[y - (d == 0 or d == 3), x - (d >= 2)]


@kernel("i8(u1[:,::1], u1[:,::1], i8, i8, i8)", inline="always")
def pass_through(states: NDArray[np.uint8], cracks: NDArray[np.uint8], y: int, x: int, d: int) -> int:
    """In which direction a walk that enters point (y, x) in direction d leaves it, or ``NODE``.

    Where two states meet four times, occupied cells join at the corner before free ones, and these before unknown
    ones. Where the cells around are X, Y, X, Z: it is a node if X is free, else the X join.
    """
    bits = cracks[y, x] & 15
    if bits != 15:
        if bits == 7 or bits == 11 or bits == 13 or bits == 14:
            return NODE
        if (bits >> d) & 1:
            return d
        return (d + 1) & 3 if (bits >> ((d + 1) & 3)) & 1 else (d + 3) & 3
    left, right = left_of(states, y, x, (d + 2) & 3), right_of(states, y, x, (d + 2) & 3)
    left, right = right, left  # seen in the direction of the walk, behind the point
    ahead_left, ahead_right = left_of(states, y, x, d), right_of(states, y, x, d)
    if left == ahead_right and right == ahead_left:
        joined = 1 if (left == 1 or right == 1) else 0
        return (d + 3) & 3 if left == joined else (d + 1) & 3
    if left == ahead_right:
        return NODE if left == 0 else (d + 3) & 3
    return NODE if right == 0 else (d + 1) & 3


@kernel(
    "Tuple((i8, i8))(u1[:,::1], u1[:,::1], i4[:,::1], i8, i4[:,::1], i4[::1], u1[::1], u1[::1])",
)
def trace_arcs(
    states: NDArray[np.uint8],
    cracks: NDArray[np.uint8],
    corners: NDArray[np.int32],
    count: int,
    points: NDArray[np.int32],
    offsets: NDArray[np.int32],
    labels: NDArray[np.uint8],
    closed: NDArray[np.uint8],
) -> tuple[int, int]:
    """Walk all arcs once; ``corners`` are the points to start from, in raster order.

    Fills ``points`` (y, x), the corners of one arc after the other, with both nodes for an open one; ``offsets``;
    ``labels`` (3 * left + right, left < right); ``closed``. Returns the number of arcs and of points. With
    p corners ``points`` must hold 4 p rows, the others 2 p + 1.
    """
    arcs = 0
    size = 0
    offsets[0] = 0
    for close in (False, True):
        for c in range(count):
            y0, x0 = corners[c, 0], corners[c, 1]
            bits = cracks[y0, x0]
            if close:
                if bits & 19 != 3:
                    continue
            elif bits & 15 != 15 and (bits & 15 not in (7, 11, 13, 14)):
                continue
            for d0 in range(4):
                if not (bits >> d0) & 1:
                    continue
                d = d0
                if close:
                    if left_of(states, y0, x0, 0) > right_of(states, y0, x0, 0):
                        d = pass_through(states, cracks, y0, x0, 2)
                    elif pass_through(states, cracks, y0, x0, 2) == NODE:
                        d = NODE
                    if d == NODE:
                        break
                else:
                    if pass_through(states, cracks, y0, x0, (d0 + 2) & 3) != NODE:
                        break
                    if left_of(states, y0, x0, d) > right_of(states, y0, x0, d):
                        continue
                first = d
                y, x = y0, x0
                labels[arcs] = 3 * left_of(states, y, x, d) + right_of(states, y, x, d)
                closed[arcs] = close
                points[size, 0], points[size, 1] = y, x
                size += 1
                if close:
                    cracks[y, x] |= VISITED
                while True:
                    # Straight on to the next corner.
                    ay, ax = step_y(d), step_x(d)
                    y += ay
                    x += ax
                    straight = 5 if d & 1 == 0 else 10
                    while cracks[y, x] == straight:
                        y += ay
                        x += ax
                    turned = pass_through(states, cracks, y, x, d)
                    if close and y == y0 and x == x0 and turned == first:
                        break
                    points[size, 0], points[size, 1] = y, x
                    size += 1
                    if turned == NODE:
                        break
                    if turned == 0 or d == 2:
                        cracks[y, x] |= VISITED
                    d = turned
                arcs += 1
                offsets[arcs] = size
                if close:
                    break
    return arcs, size


@kernel("void(u1[:,::1], i8, i8, i4[:,::1], u1[::1])")
def finish_points(
    cracks: NDArray[np.uint8], oy: int, ox: int, points: NDArray[np.int32], special: NDArray[np.uint8]
) -> None:
    """Tell at which points more than two cracks meet, then count points from the lattice's origin, not the array's."""
    for m in range(len(points)):
        bits = cracks[points[m, 0], points[m, 1]] & 15
        special[m] = bits == 15 or bits == 7 or bits == 11 or bits == 13 or bits == 14
        points[m, 0] += oy
        points[m, 1] += ox
