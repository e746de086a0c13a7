"""Numba kernels that find loops which another edge has jumped over: no edges meet, but free space is wrong.

An obstacle of a cell or two beside a wall may end up inside of it, when the edge of the wall passes on its
other side. Exact: |coordinate| <= 2^21.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit("void(i8[:,::1], i8[::1], i8[::1], i8[::1], i8[::1], i8, i8[::1])", cache=True, nogil=True)
def find_misplaced(
    edges: NDArray[np.int64],
    bounds: NDArray[np.int64],
    kinds: NDArray[np.int64],
    expected: NDArray[np.int64],
    loop_of: NDArray[np.int64],
    bucket: int,
    misplaced: NDArray[np.int64],
) -> None:
    """Compare how often the other loops wind around each loop with what the boundary has.

    Parameters
    ----------
    edges : (n, 4) int64 (y0, x0, y1, x1), loop after loop; loop i has the edges bounds[i] to bounds[i + 1]
    kinds : (k,) what a winding of each loop counts: 1 for free space, 1024 for hidden obstacles
    expected : (k,) sum of those of all other loops around it
    loop_of : (n,) the loop of each edge
    bucket : rows of this many cells are searched together
    misplaced : (k,) out: an edge whose tail has another sum than expected, or -1. A loop all of whose vertices
        lie on others can't be told, and isn't set.
    """
    count = len(edges)
    if count == 0:
        return
    low = min(edges[:, 0].min(), edges[:, 2].min())
    rows = (max(edges[:, 0].max(), edges[:, 2].max()) - low) // bucket + 1
    starts = np.zeros(rows + 1, np.int64)
    content = np.empty(0, np.int64)
    for filling in range(2):
        for k in range(count):
            first = (min(edges[k, 0], edges[k, 2]) - low) // bucket
            last = (max(edges[k, 0], edges[k, 2]) - low) // bucket
            for row in range(first, last + 1):
                if filling:
                    starts[row] -= 1
                    content[starts[row]] = k
                else:
                    starts[row] += 1
        if not filling:
            starts = np.cumsum(starts)
            content = np.empty(starts[-1], np.int64)
    for loop in range(len(kinds)):
        misplaced[loop] = -1
        for k in range(bounds[loop], bounds[loop + 1]):
            y, x = edges[k, 0], edges[k, 1]
            row = (y - low) // bucket
            winding = 0
            touches = False
            for p in range(starts[row], starts[row + 1]):
                e = content[p]
                if loop_of[e] == loop:
                    continue
                ay, ax, by, bx = edges[e, 0], edges[e, 1], edges[e, 2], edges[e, 3]
                if max(ax, bx) < x or min(ay, by) > y or max(ay, by) < y:
                    continue
                # Positive if the point lies on the left of the edge.
                side = (bx - ax) * (y - ay) - (by - ay) * (x - ax)
                if side == 0 and min(ax, bx) <= x:
                    touches = True
                    break
                # A ray to the right: edges upwards that have the point on their left, and the reverse.
                if ay <= y < by and side > 0:
                    winding += kinds[loop_of[e]]
                elif by <= y < ay and side < 0:
                    winding -= kinds[loop_of[e]]
            if not touches:
                if winding != expected[loop]:
                    misplaced[loop] = k
                break


@njit("i8(i8[:,::1], i8[::1], i8[:,::1], i8[::1], i8[::1], i8[::1], i8, i8, i8, u1[::1])", cache=True, nogil=True)
def find_jumpers(
    points: NDArray[np.int64],
    following: NDArray[np.int64],
    at: NDArray[np.int64],
    tails: NDArray[np.int64],
    heads: NDArray[np.int64],
    loop_of: NDArray[np.int64],
    loop: int,
    where: int,
    reach: int,
    bad: NDArray[np.uint8],
) -> int:
    """Set ``bad`` for the edges of other loops between which and their run of boundary the point ``where`` lies.

    ``reach`` is epsilon, rounded up to cells. Returns how many there are.
    """
    y, x = points[where, 0], points[where, 1]
    found = 0
    for k in range(len(tails)):
        if loop_of[k] == loop:
            continue
        a, b = tails[k], heads[k]
        if (
            min(at[a, 0], at[b, 0]) - 2 * reach > y
            or max(at[a, 0], at[b, 0]) + 2 * reach < y
            or min(at[a, 1], at[b, 1]) - 2 * reach > x
            or max(at[a, 1], at[b, 1]) + 2 * reach < x
        ):
            continue
        # Parity of a ray to the right through: the run, from its end to the head, the edge back, to the start.
        inside = False
        m = a
        cy, cx = at[a, 0], at[a, 1]
        stage = 0
        while stage < 3:
            if stage == 0:
                dy, dx = points[m, 0], points[m, 1]
                if m == b:
                    stage = 1
                else:
                    m = following[m]
            elif stage == 1:
                dy, dx = at[b, 0], at[b, 1]
                stage = 2
            else:
                dy, dx = at[a, 0], at[a, 1]
                stage = 3
            if (cy <= y < dy) or (dy <= y < cy):
                side = (dx - cx) * (y - cy) - (dy - cy) * (x - cx)
                if (side > 0 and dy > cy) or (side < 0 and dy < cy):
                    inside = not inside
            cy, cx = dy, dx
        if inside:
            bad[k] = 1
            found += 1
    return found
