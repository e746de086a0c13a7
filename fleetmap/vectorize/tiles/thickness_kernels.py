"""Kernels that say how thick the wall behind an edge is."""

from __future__ import annotations

import numpy as np

from fleetmap.model.kernel import kernel
from fleetmap.model.kernel_types import Ints, Points, Rows, Shorts
from fleetmap.vectorize.tiles.boundary_kernels import Boundary, Tile
from fleetmap.vectorize.tiles.keep_kernels import HEAD_X, HEAD_Y, LABEL, TAIL_X, TAIL_Y, THICK, Chain

DEEPEST = 48
"""Walls are measured so many cells deep."""

QUANTILE = 0.4
"""This share of the cracks of an edge has less wall behind it than its thickness says."""

CLUTTER, QUANTILE_OF_SOLID = 12, 0.05
"""What is deeper behind free space is clutter more often than wall: unless hardly a crack has less behind it."""

KNOWN_CHANGE, KNOWN_RATIO = 4, 0.3
"""A wall keeps the thickness that it is known to have until it is off by a cell (4 quarters) or 30 %."""

LEAST_CRACKS = 8
"""Edges of fewer cracks are too short to tell how thick the wall is; they have what is around them."""

OBSTACLE, HIDDEN = 1, 5


OTHER_CHANGE, OTHER_RATIO = 8, 0.5
"""And an edge the thickness of what is before it on the arc, until it is off by so much: each value costs bytes."""


@kernel
def is_alike(known: int, measured: int, least: int, ratio: float) -> bool:
    """Whether a wall is as thick as it is taken for."""
    return abs(known - measured) < max(float(least), ratio * known)


@kernel
def list_by_tail(old: Rows, size: int) -> tuple[Points, Shorts]:
    """One of the edges that leave each point (y, x), or -1, and for each edge another one that leaves the same."""
    first, following = np.full((size + 1, size + 1), -1, np.int32), np.full(len(old), -1, np.int32)
    for e in range(len(old)):
        following[e] = first[old[e, TAIL_Y], old[e, TAIL_X]]
        first[old[e, TAIL_Y], old[e, TAIL_X]] = e
    return first, following


@kernel
def known_thickness(old: Rows, first: Points, following: Shorts, edge: Ints) -> int:
    """The thickness of an edge that was there before, or -1."""
    e = np.int64(first[edge[TAIL_Y], edge[TAIL_X]])
    while e >= 0:
        if old[e, HEAD_Y] == edge[HEAD_Y] and old[e, HEAD_X] == edge[HEAD_X] and old[e, LABEL] == edge[LABEL]:
            return old[e, THICK]
        e = np.int64(following[e])
    return np.int64(-1)


@kernel
def add_depths(tile: Tile, built: Chain, m: int, n: int, left: bool, depths: Ints) -> None:
    """Count how deep the wall is straight behind each crack between two corners, to the left or to the right."""
    y, x = np.int64(built.points[m, 0]), np.int64(built.points[m, 1])
    dy, dx = np.sign(built.points[n, 0] - y), np.sign(built.points[n, 1] - x)
    while y != built.points[n, 0] or x != built.points[n, 1]:
        # The cell on the right of the step, or on its left, and those behind it.
        right_y, right_x = y - (dx > 0) - (dy < 0), x - (dx < 0) - (dy < 0)
        cy, cx = right_y + tile.halo, right_x + tile.halo
        sy, sx = -dx, dy
        if left:
            cy, cx = cy + dx, cx - dy
            sy, sx = dx, -dy
        depth = 0
        while depth < DEEPEST and tile.states[cy, cx] == 1:
            depth += 1
            cy += sy
            cx += sx
        depths[depth] += 1
        y += dy
        x += dx


@kernel
def quantile(depths: Ints, share: float) -> float:
    """The depth in cells that a share of the cracks doesn't reach, between whole cells by how far into its class."""
    total, below = depths.sum(), 0
    for depth in range(1, DEEPEST + 1):
        if below + depths[depth] >= share * total:
            return depth + (share * total - below) / max(depths[depth], 1) - share
        below += depths[depth]
    return 1.0


@kernel
def quarters(depths: Ints) -> int:
    """How thick the wall is, in quarters of a cell."""
    cells = min(quantile(depths, QUANTILE), float(CLUTTER))
    cells = max(cells, quantile(depths, QUANTILE_OF_SOLID))
    return max(int(np.floor(4.0 * cells + 0.5)), 4)


@kernel
def settle_thickness(tile: Tile, boundary: Boundary, built: Chain, old: Rows, share: bool) -> Rows:
    """(n, 6) the edges of a chain: tail, head, label, thickness in quarters of a cell.

    Thickness is what an old edge is known to have, if that is near what was measured; else that of the edge before it,
    at first of the whole arc, if that is; else what was measured.
    """
    edges = np.empty((int(built.stops.sum()) + 1, 6), np.int64)
    count = 0
    leaving, following_old = list_by_tail(old, tile.size)
    depths = np.zeros(DEEPEST + 1, np.int64)
    for arc in range(len(boundary.labels)):
        start, end = np.int64(built.offsets[arc]), np.int64(built.offsets[arc + 1])
        first = start
        while first < end and not built.stops[first]:
            first += 1
        if first == end:
            continue
        hidden = boundary.labels[arc] == HIDDEN
        thick = share and (hidden or boundary.labels[arc] == OBSTACLE)
        around = np.int64(4)
        if thick:
            depths[:] = 0
            for m in range(start, end if boundary.closed[arc] else end - 1):
                add_depths(tile, built, m, m + 1 if m + 1 < end else start, hidden, depths)
            around = quarters(depths)
        tail = first
        while True:
            depths[:] = 0
            head = tail
            while True:
                following = head + 1 if head + 1 < end else start
                if following == start and not boundary.closed[arc]:
                    break
                if thick:
                    add_depths(tile, built, head, following, hidden, depths)
                head = following
                if built.stops[head]:
                    break
            if head == tail and not boundary.closed[arc]:
                break
            edges[count, TAIL_Y], edges[count, TAIL_X] = built.at[tail, 0], built.at[tail, 1]
            edges[count, HEAD_Y], edges[count, HEAD_X] = built.at[head, 0], built.at[head, 1]
            edges[count, LABEL], edges[count, THICK] = boundary.labels[arc], 0
            if thick:
                own = known_thickness(old, leaving, following_old, edges[count])
                measured = quarters(depths) if depths.sum() >= LEAST_CRACKS else around
                if own >= 0 and is_alike(own, measured, KNOWN_CHANGE, KNOWN_RATIO):
                    around = own
                elif not is_alike(around, measured, OTHER_CHANGE, OTHER_RATIO):
                    around = measured
                edges[count, THICK] = around
            count += 1
            tail = head
            if tail == first:
                break
            if not boundary.closed[arc] and tail == end - 1:
                break
    return edges[:count]
