"""A numba kernel that finds edges which meet elsewhere than at a common vertex. Exact: |coordinate| <= 2^21."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


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


@njit("void(i8[:,::1], i8[:,::1], u1[:,::1], u1[::1], u1[::1], i8, b1, u1[::1])", cache=True, nogil=True)
def find_crossings(
    edges: NDArray[np.int64],
    ends: NDArray[np.int64],
    raw: NDArray[np.uint8],
    final: NDArray[np.uint8],
    fresh: NDArray[np.uint8],
    bucket: int,
    both: bool,
    bad: NDArray[np.uint8],
) -> None:
    """Set ``bad`` for one edge of each pair that cross, touch, overlap or share a vertex by chance.

    It is the longer one, or ``both``; of equals the one that goes up: the triangle that is left of a single cell
    then has the cell's centre inside, by the rule of ``model.raster``. ``final`` edges cannot be changed: the
    other one is set.

    ``edges`` are (y0, x0, y1, x1); ``ends`` says which boundary point each end stands for, ``raw`` whether it
    lies on it. Two ends in one place are fine if they stand for one point, or if the boundary itself passes
    there twice. Only pairs with a ``fresh`` edge are tested, and only those that share a square of ``bucket``
    cells.
    """
    count = len(edges)
    if count == 0:
        return
    low_y, low_x = min(edges[:, 0].min(), edges[:, 2].min()), min(edges[:, 1].min(), edges[:, 3].min())
    rows = (max(edges[:, 0].max(), edges[:, 2].max()) - low_y) // bucket + 1
    columns = (max(edges[:, 1].max(), edges[:, 3].max()) - low_x) // bucket + 1
    starts = np.zeros(rows * columns + 1, np.int64)
    content = np.empty(0, np.int64)
    for filling in range(2):
        for k in range(count):
            y0, x0, y1, x1 = edges[k, 0] - low_y, edges[k, 1] - low_x, edges[k, 2] - low_y, edges[k, 3] - low_x
            if y0 > y1:
                y0, x0, y1, x1 = y1, x1, y0, x0
            for row in range(y0 // bucket, y1 // bucket + 1):
                xa, xb = x0, x1
                if y1 > y0:
                    # Rounded outwards by one cell: a bucket too many does no harm.
                    xa = x0 + (max(y0, row * bucket) - y0) * (x1 - x0) // (y1 - y0)
                    xb = x0 + (min(y1, row * bucket + bucket) - y0) * (x1 - x0) // (y1 - y0)
                left, right = max(min(xa, xb) - 1, 0), max(xa, xb) + 1
                for column in range(left // bucket, min(right // bucket, columns - 1) + 1):
                    place = row * columns + column
                    if filling:
                        starts[place] -= 1
                        content[starts[place]] = k
                    else:
                        starts[place] += 1
        if not filling:
            starts = np.cumsum(starts)
            content = np.empty(starts[-1], np.int64)
    for place in range(rows * columns):
        for p in range(starts[place], starts[place + 1]):
            e = content[p]
            ay, ax, by, bx = edges[e, 0], edges[e, 1], edges[e, 2], edges[e, 3]
            for q in range(p + 1, starts[place + 1]):
                f = content[q]
                if not fresh[e] and not fresh[f]:
                    continue
                cy, cx, dy, dx = edges[f, 0], edges[f, 1], edges[f, 2], edges[f, 3]
                if (
                    max(ay, by) < min(cy, dy)
                    or max(cy, dy) < min(ay, by)
                    or max(ax, bx) < min(cx, dx)
                    or max(cx, dx) < min(ax, bx)
                ):
                    continue
                c_side, d_side = turn(ay, ax, by, bx, cy, cx), turn(ay, ax, by, bx, dy, dx)
                a_side, b_side = turn(cy, cx, dy, dx, ay, ax), turn(cy, cx, dy, dx, by, bx)
                meet = ((c_side > 0 and d_side < 0) or (c_side < 0 and d_side > 0)) and (
                    (a_side > 0 and b_side < 0) or (a_side < 0 and b_side > 0)
                )
                meet = meet or (c_side == 0 and is_inside(ay, ax, by, bx, cy, cx))
                meet = meet or (d_side == 0 and is_inside(ay, ax, by, bx, dy, dx))
                meet = meet or (a_side == 0 and is_inside(cy, cx, dy, dx, ay, ax))
                meet = meet or (b_side == 0 and is_inside(cy, cx, dy, dx, by, bx))
                shared = 0
                for s in range(2):
                    for t in range(2):
                        if edges[e, 2 * s] == edges[f, 2 * t] and edges[e, 2 * s + 1] == edges[f, 2 * t + 1]:
                            shared += 1
                            if ends[e, s] != ends[f, t] and not (raw[e, s] and raw[f, t]):
                                meet = True
                if meet or shared > 1:
                    longer = (by - ay) ** 2 + (bx - ax) ** 2 - (dy - cy) ** 2 - (dx - cx) ** 2
                    upward = by > ay or (by == ay and bx > ax)
                    this = final[f] or (not final[e] and (longer > 0 or (longer == 0 and upward)))
                    if this or both:
                        bad[e] = 1
                    if not this or both:
                        bad[f] = 1
