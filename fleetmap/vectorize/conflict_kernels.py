"""Numba kernels that find edges which meet elsewhere than at a common vertex, or leave it in the wrong order.

Edges as in ``edge_kernels``. Exact: |coordinate| <= 2^21.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.kernel import kernel

BUCKET = 16
"""Edges are looked up in squares of so many cells."""


@kernel("i8(i8, i8, i8, i8, i8, i8)", inline="always")
def turn(ay: int, ax: int, by: int, bx: int, cy: int, cx: int) -> int:
    """Positive if c lies on the left of the line from a to b, 0 on it."""
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


@kernel("b1(i8, i8, i8, i8, i8, i8)", inline="always")
def is_inside(ay: int, ax: int, by: int, bx: int, cy: int, cx: int) -> bool:
    """Whether c, a point on the line of a and b, lies between them and is none of them."""
    if (cy == ay and cx == ax) or (cy == by and cx == bx):
        return False
    return min(ay, by) <= cy <= max(ay, by) and min(ax, bx) <= cx <= max(ax, bx)


@kernel("b1(i8[:,::1], i8, i8)")
def conflict(edges: NDArray[np.int64], e: int, f: int) -> bool:
    """Whether two edges cross, touch, overlap, or share a vertex that stands for two different points."""
    ay, ax, by, bx = edges[e, 0], edges[e, 1], edges[e, 2], edges[e, 3]
    cy, cx, dy, dx = edges[f, 0], edges[f, 1], edges[f, 2], edges[f, 3]
    if max(ay, by) < min(cy, dy) or max(cy, dy) < min(ay, by) or max(ax, bx) < min(cx, dx) or max(cx, dx) < min(ax, bx):
        return False
    c_side, d_side = turn(ay, ax, by, bx, cy, cx), turn(ay, ax, by, bx, dy, dx)
    if (c_side > 0 and d_side > 0) or (c_side < 0 and d_side < 0):
        return False
    a_side, b_side = turn(cy, cx, dy, dx, ay, ax), turn(cy, cx, dy, dx, by, bx)
    if (c_side > 0) != (d_side > 0) and c_side != 0 and d_side != 0:
        if (a_side > 0 and b_side < 0) or (a_side < 0 and b_side > 0):
            return True
    if (
        (c_side == 0 and is_inside(ay, ax, by, bx, cy, cx))
        or (d_side == 0 and is_inside(ay, ax, by, bx, dy, dx))
        or (a_side == 0 and is_inside(cy, cx, dy, dx, ay, ax))
        or (b_side == 0 and is_inside(cy, cx, dy, dx, by, bx))
    ):
        return True
    shared = 0
    for s in range(0, 4, 2):
        for t in range(0, 4, 2):
            if edges[e, s] == edges[f, t] and edges[e, s + 1] == edges[f, t + 1]:
                shared += 1
                if edges[e, s + 4] != edges[f, t + 4] or edges[e, s + 5] != edges[f, t + 5]:
                    return True
    return shared > 1


@kernel(
    "Tuple((i8, i4[:,::1]))(i8[:,::1], i8, u1[::1], u1[::1], i8, i8, i4[:,::1], i8, i4[:,::1], b1, u1[::1])",
)
def link_and_test(
    edges: NDArray[np.int64],
    e: int,
    alive: NDArray[np.uint8],
    rank: NDArray[np.uint8],
    low_y: int,
    low_x: int,
    buckets: NDArray[np.int32],
    used: int,
    links: NDArray[np.int32],
    both: bool,
    bad: NDArray[np.uint8],
) -> tuple[int, NDArray[np.int32]]:
    """Put edge e into the buckets that it may touch; set ``bad`` for one of each pair in conflict with one there.

    ``buckets`` holds the first link of each square of ``BUCKET`` cells, the first square at (low_y, low_x); ``links``
    rows (edge, next link), of which so many are ``used``. Returns the new number and the links, in more room if needed.

    In a pair it is the one of lower ``rank``; of equals the longer one (``both`` if asked for), and of equally long
    ones the one that goes up: the triangle that is left of a single cell then has the cell's centre inside, by the rule
    of ``model.raster``.
    """
    y0, x0, y1, x1 = edges[e, 0] - low_y, edges[e, 1] - low_x, edges[e, 2] - low_y, edges[e, 3] - low_x
    rise, run = edges[e, 2] - edges[e, 0], edges[e, 3] - edges[e, 1]
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
            link = np.int64(buckets[row, column])
            while link >= 0:
                f = np.int64(links[link, 0])
                link = np.int64(links[link, 1])
                if not alive[f] or not conflict(edges, e, f):
                    continue
                if rank[e] != rank[f]:
                    bad[e if rank[e] < rank[f] else f] = 1
                    continue
                longer = rise**2 + run**2 - (edges[f, 2] - edges[f, 0]) ** 2 - (edges[f, 3] - edges[f, 1]) ** 2
                this = longer > 0 or (longer == 0 and (rise > 0 or (rise == 0 and run > 0)))
                if this or both:
                    bad[e] = 1
                if not this or both:
                    bad[f] = 1
            if used == len(links):
                links = np.concatenate((links, np.empty_like(links)))
            links[used, 0], links[used, 1] = e, buckets[row, column]
            buckets[row, column] = used
            used += 1
    return used, links


@kernel("b1(i8, i8, i8, i8)", inline="always")
def is_before(ay: int, ax: int, by: int, bx: int) -> bool:
    """Whether direction a comes before b, counter-clockwise from the x axis; both are no null vectors."""
    a_half, b_half = ay < 0 or (ay == 0 and ax < 0), by < 0 or (by == 0 and bx < 0)
    if a_half != b_half:
        return b_half
    return ax * by - ay * bx > 0


@kernel("b1(i8[::1], i8[:,::1], i8[::1], i8)")
def go_around(crack: NDArray[np.int64], away: NDArray[np.int64], owner: NDArray[np.int64], size: int) -> bool:
    """Sort edges that leave a vertex by their cracks; whether their directions then go around it once.

    ``away`` (size, 2) are the ways (y, x) to their other ends; ``owner`` is sorted with them.
    """
    for q in range(1, size):
        for r in range(q, 0, -1):
            if crack[r] < crack[r - 1]:
                crack[r], crack[r - 1] = crack[r - 1], crack[r]
                owner[r], owner[r - 1] = owner[r - 1], owner[r]
                for axis in range(2):
                    away[r, axis], away[r - 1, axis] = away[r - 1, axis], away[r, axis]
    descents = 0
    for q in range(size):
        r = (q + 1) % size
        descents += not is_before(away[q, 0], away[q, 1], away[r, 0], away[r, 1])
    return size < 3 or descents == 1


@kernel("i4[::1](i4[:,::1], i4[::1], u1[::1], i8)")
def list_crossings(
    points: NDArray[np.int32], offsets: NDArray[np.int32], special: NDArray[np.uint8], arcs: int
) -> NDArray[np.int32]:
    """The corners with more than two cracks, those at one point after the other."""
    found = np.flatnonzero(special[: offsets[arcs]])
    keys = np.empty(len(found), np.int64)
    for q in range(len(found)):
        keys[q] = (np.int64(points[found[q], 0]) << 24) + points[found[q], 1]
    return found[np.argsort(keys, kind="mergesort")].astype(np.int32)


@kernel(
    "void(i8[:,::1], i4[:,::1], i4[::1], i4[::1], i4[::1], u1[::1])",
)
def find_turned(
    edges: NDArray[np.int64],
    points: NDArray[np.int32],
    crossings: NDArray[np.int32],
    edge_from: NDArray[np.int32],
    edge_into: NDArray[np.int32],
    bad: NDArray[np.uint8],
) -> None:
    """Set ``bad`` for one edge of each vertex around which the edges don't have the order of their cracks.

    ``crossings`` are corners as ``list_crossings`` has them, ``edge_from`` and ``edge_into`` the edges that begin and
    end at each corner, or -1.
    """
    owner, side_of = np.empty(8, np.int64), np.empty(8, np.int64)
    crack, away = np.empty(8, np.int64), np.empty((8, 2), np.int64)
    first, ends = 0, len(crossings)
    while first < ends:
        last = first
        size = 0
        y, x = points[crossings[first], 0], points[crossings[first], 1]
        while last < ends and points[crossings[last], 0] == y and points[crossings[last], 1] == x:
            for side in range(2):
                k = edge_into[crossings[last]] if side else edge_from[crossings[last]]
                if k >= 0 and size < 8:
                    owner[size], side_of[size] = k, side
                    size += 1
            last += 1
        first = last
        for q in range(size):
            k, side = owner[q], side_of[q]
            crack[q] = (edges[k, 8] >> 2) + 2 & 3 if side else edges[k, 8] & 3
            away[q, 0] = edges[k, 2 - 2 * side] - edges[k, 2 * side]
            away[q, 1] = edges[k, 3 - 2 * side] - edges[k, 2 * side + 1]
        if not go_around(crack, away, owner, size):
            # The one that has turned farthest from its crack.
            worst, least = 0, 2.0
            for q in range(size):
                y, x, d = away[q, 0], away[q, 1], crack[q]
                along = (x if d == 0 else y if d == 1 else -x if d == 2 else -y) / np.sqrt(float(y * y + x * x))
                if along < least:
                    worst, least = q, along
            bad[owner[worst]] = 1
