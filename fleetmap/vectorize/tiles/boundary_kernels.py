"""Kernels that trace the boundary within one tile: arcs between its nodes, and closed ones.

Coordinates are those of the tile: its cells and its points are 0 to size - 1 each way. A unit of boundary, a *crack*
between two cells of different states, belongs to the tile that holds its lower left end; so a tile's cracks end on its
upper and right border, and it knows all four cracks of each of its own points. Where a walk passes from the cracks of
one tile to those of another there is a *node*; where three states meet, too.

Directions: 0 to the right, 1 up, 2 to the left, 3 down. Arcs are walked with the lesser state on the left.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fleetmap.model.kernel import kernel
from fleetmap.model.kernel_types import Bytes, Image, Points, Shorts
from fleetmap.vectorize.cells_kernels import find_corners, find_cracks
from fleetmap.vectorize.obstacle_kernels import NEAR_STEPS, is_behind
from fleetmap.vectorize.walk_kernels import NODE, VISITED, left_of, pass_through, right_of, step_x, step_y


class Tile(NamedTuple):
    """States of a tile's cells and of ``halo`` more around it: cell (y, x) is ``states[y + halo, x + halo]``."""

    states: Image
    size: int
    halo: int


class Boundary(NamedTuple):
    """Arcs: the corners (y, x) of one after the other, of open ones with both ends.

    Arc i has the corners ``offsets[i]`` to ``offsets[i + 1]``; ``labels`` are 3 * left + right. ``cracks`` are those of
    all points from (-1, -1) to (size, size).
    """

    points: Points
    offsets: Shorts
    labels: Bytes
    closed: Bytes
    cracks: Image


@kernel
def continues(states: Image, cracks: Image, own: Image, y: int, x: int, d: int, high: int) -> int:
    """In which direction a walk that enters a point in direction d goes on within the tile, or ``NODE``."""
    if y == high or x == high:
        return np.int64(NODE)
    turned = pass_through(states, cracks, y, x, d)
    return turned if turned != NODE and own[y, x] >> turned & 1 else np.int64(NODE)


@kernel
def first_of_loop(states: Image, cracks: Image, own: Image, y: int, x: int, high: int) -> int:
    """In which direction to walk a closed arc from its lowest left point, which is left to the right and up."""
    turned = continues(states, cracks, own, y, x, 2, high)
    if turned == NODE:
        return turned
    return turned if left_of(states, y, x, 0) > right_of(states, y, x, 0) else np.int64(0)


@kernel
def walk(
    states: Image,
    cracks: Image,
    own: Image,
    marks: Image,
    y0: int,
    x0: int,
    d: int,
    high: int,
    close: bool,
    points: Points,
    used: int,
) -> int:
    """Write the corners of the arc that leaves a point in direction d behind those that are ``used``; the new count."""
    y, x, first = y0, x0, d
    points[used, 0], points[used, 1] = y, x
    used += 1
    if close:
        own[y, x] |= np.uint8(VISITED)
    elif d == 0:
        own[y, x] |= np.uint8(VISITED)
    while True:
        ay, ax = step_y(d), step_x(d)
        y += ay
        x += ax
        straight = 5 if d & 1 == 0 else 10
        while marks[y, x] == straight:
            y += ay
            x += ax
        turned = continues(states, cracks, own, y, x, d, high)
        if close and y == y0 and x == x0 and turned == first:
            return used
        points[used, 0], points[used, 1] = y, x
        used += 1
        if turned == NODE:
            return used
        if turned == 0 or d == 2:
            own[y, x] |= np.uint8(VISITED)
        d = turned


@kernel
def is_explained(tile: Tile, points: Points, start: int, end: int, close: bool, seen: Image) -> bool:
    """Whether an arc between occupied and unknown cells is the back of a wall, or the rim of a hole in an obstacle.

    Else no free space is near: what it is the outline of is known by it alone. ``points`` are two more than the tile's.
    """
    queue = np.empty(((2 * NEAR_STEPS + 1) ** 2, 2), np.int32)
    shift = tile.halo - 2
    area = np.int64(0)
    for m in range(start, end if close else end - 1):
        n = m + 1 if m + 1 < end else start
        y, x = np.int64(points[m, 0]), np.int64(points[m, 1])
        area += x * points[n, 0] - y * points[n, 1]
        # The occupied cell on the left of the crack that leaves the corner.
        up, left = points[n, 0] < y, points[n, 1] < x
        cy = y - 1 if left or up else y
        cx = x - 1 if left or points[n, 0] > y else x
        if is_behind(tile.states, seen, queue, cy + shift, cx + shift):
            return True
    return close and area < 0


@kernel
def trace(tile: Tile, share: bool) -> Boundary:
    """All arcs of a tile; with ``share``, of those between occupied and unknown cells, only what tells of more."""
    size, halo = tile.size, tile.halo
    # Points are counted from one outside of the tile, cells as well.
    states = tile.states[halo - 2 : halo + size + 2, halo - 2 : halo + size + 2].copy()
    width = (size + 4 + 7) // 8 * 8
    cracks = np.zeros((size + 4, width), np.uint8)
    find_cracks(states, cracks, 1, 1, size + 4, size + 4)
    own = np.zeros((size + 4, width), np.uint8)
    low, high = 2, size + 2
    own[low:high, low:high] = cracks[low:high, low:high]
    for k in range(low, high):
        own[low, k] &= 7  # not down
        own[high, k] = cracks[high, k] & 8
    for k in range(low, high):
        own[k, low] &= 11  # not to the left
        own[k, high] = cracks[k, high] & 4
    # Where a crack of another tile ends on two of this one, that look like a straight line, there is a corner, too.
    marks = own.copy()
    for k in range(low, high):
        for y, x in ((low, k), (k, low)):
            if own[y, x] in (5, 10) and own[y, x] != cracks[y, x]:
                marks[y, x] = 15
    corners = np.empty((1 << 12, 2), np.int32)
    while True:
        count = find_corners(marks.view(np.uint64), marks, low, low, high + 1, high + 1, corners)
        if count >= 0:
            break
        corners = np.empty((4 * len(corners), 2), np.int32)
    points, offsets = np.empty((4 * count + 4, 2), np.int32), np.empty(2 * count + 4, np.int32)
    labels, closed = np.empty(2 * count + 4, np.uint8), np.empty(2 * count + 4, np.uint8)
    seen = np.zeros(tile.states.shape, np.uint8)
    arcs, used = 0, 0
    offsets[0] = 0
    for close in (False, True):
        for c in range(count):
            y0, x0 = np.int64(corners[c, 0]), np.int64(corners[c, 1])
            for d0 in range(4):
                if not own[y0, x0] >> d0 & 1:
                    continue
                if close:
                    if own[y0, x0] & (VISITED | 3) != 3:
                        break
                    d = first_of_loop(states, cracks, own, y0, x0, high)
                    if d == NODE:
                        break
                else:
                    d = d0
                    if continues(states, cracks, own, y0, x0, (d + 2) & 3, high) != NODE:
                        continue
                    if left_of(states, y0, x0, d) > right_of(states, y0, x0, d):
                        continue
                label = 3 * left_of(states, y0, x0, d) + right_of(states, y0, x0, d)
                end = walk(states, cracks, own, marks, y0, x0, d, high, close, points, used)
                if not (share and label == 5 and is_explained(tile, points, used, end, close, seen)):
                    labels[arcs], closed[arcs] = label, close
                    used = end
                    arcs += 1
                    offsets[arcs] = used
                if close:
                    break
    return Boundary(
        points[:used].copy() - np.int32(2),
        offsets[: arcs + 1].copy(),
        labels[:arcs].copy(),
        closed[:arcs].copy(),
        cracks[1 : size + 3, 1 : size + 3].copy(),
    )
