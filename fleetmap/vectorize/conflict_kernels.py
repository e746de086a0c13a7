"""Numba kernels that find edges which meet elsewhere than at a common vertex, or leave it in the wrong order.

Edges are rows of nine int64: the tail's and the head's place (y0, x0, y1, x1), the boundary points that they stand
for (the next four), and the direction of the crack that leaves the tail's point plus 4 times that of the one which
enters the head's. Exact: |coordinate| <= 2^21.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

BUCKET_CELLS = 16
"""Edges are looked up in squares of this size."""


@njit("i8(i8, i8, i8, i8, i8, i8)", cache=True, nogil=True, inline="always")
def turn(ay: int, ax: int, by: int, bx: int, cy: int, cx: int) -> int:
    """Positive if c lies on the left of the line from a to b, 0 on it."""
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


@njit("b1(i8, i8, i8, i8, i8, i8)", cache=True, nogil=True, inline="always")
def is_inside(ay: int, ax: int, by: int, bx: int, cy: int, cx: int) -> bool:
    """Whether c, a point on the line of a and b, lies between them and is none of them."""
    if (cy == ay and cx == ax) or (cy == by and cx == bx):
        return False
    return min(ay, by) <= cy <= max(ay, by) and min(ax, bx) <= cx <= max(ax, bx)


@njit("b1(i8[:,::1], i8, i8)", cache=True, nogil=True)
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


@njit("Tuple((i4[::1], i4[::1], i8, i8, i8, i8))(i8[:,::1], i8)", cache=True, nogil=True)
def fill_buckets(
    edges: NDArray[np.int64], bucket: int
) -> tuple[NDArray[np.int32], NDArray[np.int32], int, int, int, int]:
    """Sort edges into squares that they may touch: (starts, content, low_y, low_x, rows, columns)."""
    count = len(edges)
    low_y, low_x, high_y, high_x = 1 << 40, 1 << 40, -(1 << 40), -(1 << 40)
    for k in range(count):
        low_y, high_y = min(low_y, min(edges[k, 0], edges[k, 2])), max(high_y, max(edges[k, 0], edges[k, 2]))
        low_x, high_x = min(low_x, min(edges[k, 1], edges[k, 3])), max(high_x, max(edges[k, 1], edges[k, 3]))
    if count == 0:
        low_y = low_x = high_y = high_x = 0
    rows, columns = (high_y - low_y) // bucket + 1, (high_x - low_x) // bucket + 1
    starts = np.zeros(rows * columns + 1, np.int32)
    content = np.empty(0, np.int32)
    for filling in range(2):
        for k in range(count):
            y0, x0, y1, x1 = edges[k, 0] - low_y, edges[k, 1] - low_x, edges[k, 2] - low_y, edges[k, 3] - low_x
            if y0 > y1:
                y0, x0, y1, x1 = y1, x1, y0, x0
            for row in range(y0 // bucket, y1 // bucket + 1):
                xa, xb = x0, x1
                if y1 // bucket > y0 // bucket:
                    # Rounded outwards by one cell: a bucket too many does no harm.
                    xa = x0 + (max(y0, row * bucket) - y0) * (x1 - x0) // (y1 - y0)
                    xb = x0 + (min(y1, row * bucket + bucket) - y0) * (x1 - x0) // (y1 - y0)
                    xa, xb = min(xa, xb) - 1, max(xa, xb) + 1
                left, right = max(min(xa, xb), 0), min(max(xa, xb), high_x - low_x)
                for column in range(left // bucket, right // bucket + 1):
                    place = row * columns + column
                    if filling:
                        starts[place] -= 1
                        content[starts[place]] = k
                    else:
                        starts[place] += 1
        if not filling:
            for place in range(1, len(starts)):
                starts[place] += starts[place - 1]
            content = np.empty(starts[-1], np.int32)
    return starts, content, low_y, low_x, rows, columns


@njit("void(i8[:,::1], i4[::1], i4[::1], u1[::1], u1[::1], b1, u1[::1])", cache=True, nogil=True)
def find_conflicts(
    edges: NDArray[np.int64],
    starts: NDArray[np.int32],
    content: NDArray[np.int32],
    rank: NDArray[np.uint8],
    fresh: NDArray[np.uint8],
    both: bool,
    bad: NDArray[np.uint8],
) -> None:
    """Set ``bad`` for one edge of each pair in conflict that has a ``fresh`` one; ``both`` for both of one rank.

    It is the one of lower ``rank``; of equals the longer one, and of equally long ones the one that goes up: the
    triangle that is left of a single cell then has the cell's centre inside, by the rule of ``model.raster``.
    """
    for place in range(len(starts) - 1):
        for p in range(starts[place], starts[place + 1]):
            e = content[p]
            for q in range(p + 1, starts[place + 1]):
                f = content[q]
                if (not fresh[e] and not fresh[f]) or not conflict(edges, e, f):
                    continue
                if rank[e] != rank[f]:
                    bad[e if rank[e] < rank[f] else f] = 1
                    continue
                ay, ax, by, bx = edges[e, 0], edges[e, 1], edges[e, 2], edges[e, 3]
                longer = (by - ay) ** 2 + (bx - ax) ** 2
                longer -= (edges[f, 2] - edges[f, 0]) ** 2 + (edges[f, 3] - edges[f, 1]) ** 2
                this = longer > 0 or (longer == 0 and (by > ay or (by == ay and bx > ax)))
                if this or both:
                    bad[e] = 1
                if not this or both:
                    bad[f] = 1


@njit("b1(i8, i8, i8, i8)", cache=True, nogil=True, inline="always")
def is_before(ay: int, ax: int, by: int, bx: int) -> bool:
    """Whether direction a comes before b, counter-clockwise from the x axis; both are no null vectors."""
    a_half, b_half = ay < 0 or (ay == 0 and ax < 0), by < 0 or (by == 0 and bx < 0)
    if a_half != b_half:
        return b_half
    return ax * by - ay * bx > 0


@njit("void(i8[:,::1], u1[::1], u1[::1])", cache=True, nogil=True)
def find_turned(edges: NDArray[np.int64], special: NDArray[np.uint8], bad: NDArray[np.uint8]) -> None:
    """Set ``bad`` for one edge of each vertex around which the edges don't have the order of their cracks.

    ``special`` has bit 1 set for edges whose tail, bit 2 whose head, stands for a point with more than two cracks.
    """
    ends = 0
    for k in range(len(edges)):
        ends += (special[k] & 1) + (special[k] >> 1)
    keys, owner = np.empty(ends, np.int64), np.empty(ends, np.int64)
    ends = 0
    for k in range(len(edges)):
        for side in range(2):
            if (special[k] >> side) & 1:
                keys[ends] = (edges[k, 4 + 2 * side] << 24) + edges[k, 5 + 2 * side]
                owner[ends] = 2 * k + side
                ends += 1
    order = np.argsort(keys, kind="mergesort")
    crack, away = np.empty(8, np.int64), np.empty((8, 2), np.int64)
    first = 0
    while first < ends:
        last = first
        while last < ends and keys[order[last]] == keys[order[first]] and last - first < 8:
            last += 1
        size = last - first
        for q in range(size):
            k, side = owner[order[first + q]] >> 1, owner[order[first + q]] & 1
            crack[q] = (edges[k, 8] >> 2) + 2 & 3 if side else edges[k, 8] & 3
            away[q, 0] = edges[k, 2 - 2 * side] - edges[k, 2 * side]
            away[q, 1] = edges[k, 3 - 2 * side] - edges[k, 2 * side + 1]
        # Sorted by cracks, the directions must go around once.
        for q in range(1, size):
            for r in range(q, 0, -1):
                if crack[r] < crack[r - 1]:
                    crack[r], crack[r - 1] = crack[r - 1], crack[r]
                    ay, ax = away[r, 0], away[r, 1]
                    away[r, 0], away[r, 1] = away[r - 1, 0], away[r - 1, 1]
                    away[r - 1, 0], away[r - 1, 1] = ay, ax
        descents = 0
        for q in range(size):
            r = (q + 1) % size
            descents += not is_before(away[q, 0], away[q, 1], away[r, 0], away[r, 1])
        if size > 2 and descents != 1:
            # The one that has turned farthest from its crack.
            worst, least = first, 2.0
            for q in range(first, last):
                k, side = owner[order[q]] >> 1, owner[order[q]] & 1
                d = (edges[k, 8] >> 2) + 2 & 3 if side else edges[k, 8] & 3
                y, x = edges[k, 2 - 2 * side] - edges[k, 2 * side], edges[k, 3 - 2 * side] - edges[k, 2 * side + 1]
                along = (x if d == 0 else y if d == 1 else -x if d == 2 else -y) / np.sqrt(float(y * y + x * x))
                if along < least:
                    worst, least = q, along
            bad[owner[order[worst]] >> 1] = 1
        first = last
