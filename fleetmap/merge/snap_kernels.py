"""Integer kernels of the snapping.

Why int64 suffices: points compared lie within 2^13 of each other or of an edge's box (at most 2^16 along an
axis), so their products stay below 2^35. A tangent is the sum of the edges at a vertex of one source: times a
direction it is below 2^34 per edge, so 2^28 edges at one vertex fit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.merge.select_kernels import pair_cell, within
from fleetmap.merge.tile_kernels import columns_in_row, first_from, tile_key
from fleetmap.merge.tiles import LEVEL_CELL, SHIFT
from fleetmap.model.kernel import kernel

Ints = NDArray[np.int64]


@kernel(
    "int64[:, ::1](int64[:, ::1], int64[::1], int64[:, ::1], int64[::1], int64[::1], int64[::1], int64[::1],"
    " int64[::1], int64)",
)
def close_pairs(
    at: Ints,
    source: Ints,
    tangent: Ints,
    cell: Ints,
    levels: Ints,
    keys: Ints,
    start: Ints,
    items: Ints,
    reach_cells: int,
) -> Ints:
    """Rows (distance^2, i, j), i < j, of vertices of different sources within reach whose boundaries run alike.

    ``at``: (n, 2) points (y, x), ascending; ``cell``: the cell size of each source. The reach of a pair is
    ``reach_cells`` cells, see ``pair_cell``. ``keys``, ``start``, ``items``: ``Tiles`` of the
    points, each in its level; ``levels`` are those that there are.
    """
    out = np.empty((64, 3), np.int64)
    n = 0
    for i in range(len(at)):
        y, x = at[i, 0], at[i, 1]
        for level in levels:
            shift = SHIFT + level
            far = reach_cells * pair_cell(cell[source[i]], LEVEL_CELL << level)
            for row in range(y >> shift, ((y + far) >> shift) + 1):  # of a pair, the higher one is looked for
                t = first_from(keys, tile_key(level, row, (x - far) >> shift))
                beyond = tile_key(level, row, (x + far) >> shift)
                while t < len(keys) and keys[t] <= beyond:
                    for k in range(start[t], start[t + 1]):
                        j = items[k]
                        dy, dx = at[j, 0] - y, at[j, 1] - x
                        if j <= i or dy > far or abs(dx) > far or source[i] == source[j]:
                            continue
                        reach = reach_cells * pair_cell(cell[source[i]], cell[source[j]])
                        if dy * dy + dx * dx > reach * reach:
                            continue
                        if tangent[i, 0] * tangent[j, 0] + tangent[i, 1] * tangent[j, 1] <= 0:
                            continue
                        if n == len(out):
                            more = np.empty((2 * n, 3), np.int64)
                            more[:n] = out
                            out = more
                        out[n, 0], out[n, 1], out[n, 2] = dy * dy + dx * dx, i, j
                        n += 1
                    t += 1
    return out[:n].copy()


@kernel("int64[::1](int64[:, ::1], int64[::1])")
def stars(pairs: Ints, source: Ints) -> Ints:
    """Which vertex each vertex moves to: pairs in order, each vertex at most once, one per source at a star.

    A vertex that others move to stays where it is, so nothing moves farther than its pair's distance.
    """
    centre = np.full(len(source), -1, np.int64)
    following = np.full(len(source), -1, np.int64)  # the members of a star, as a list from its centre
    for k in range(len(pairs)):
        i, j = pairs[k, 1], pairs[k, 2]
        if centre[i] < 0 and centre[j] < 0:
            centre[i] = i
        elif centre[j] == j and centre[i] < 0:
            i, j = j, i
        if centre[i] != i or centre[j] >= 0:
            continue
        taken = False
        m = i
        while m >= 0:
            if source[m] == source[j]:
                taken = True
                break
            m = following[m]
        if not taken:
            centre[j] = i
            following[j] = following[i]
            following[i] = j
    for i in range(len(centre)):
        if centre[i] < 0:
            centre[i] = i
    return centre


@kernel(
    "Tuple((int64[:, ::1], int64[::1]))"
    "(int64[:, ::1], int64[:, ::1], int64[::1], int64[:, ::1], int64[::1], int64[::1], int64[:, ::1], int64[::1],"
    " int64[::1], int64[::1], int64[::1], int64[::1], int64)",
)
def through_vertices(
    before: Ints,
    after: Ints,
    owner: Ints,
    at: Ints,
    first: Ints,
    source: Ints,
    tangent: Ints,
    cell: Ints,
    levels: Ints,
    keys: Ints,
    start: Ints,
    items: Ints,
    reach_cells: int,
) -> tuple[Ints, Ints]:
    """Lead directed edges through the vertices of other sources that they pass within reach.

    ``before`` and ``after``: (n, 4) the edges before and after their ends were snapped; ``owner`` their
    sources. ``at``: (m, 2) ascending positions of vertices; those of position k are the entries
    ``first[k]:first[k + 1]`` of ``source`` and ``tangent``. ``keys``, ``start``, ``items``: ``Tiles`` of the positions,
    each in its level; ``levels`` are those that there are. Returns pieces (k, 4) and the edge behind each.
    """
    pieces = np.empty((len(before) + 64, 4), np.int64)
    behind = np.empty(len(before) + 64, np.int64)
    n = 0
    along = np.empty(len(at), np.int64)
    found = np.empty(len(at), np.int64)
    for i in range(len(before)):
        ay, ax, by, bx = before[i, 0], before[i, 1], before[i, 2], before[i, 3]
        dy, dx = by - ay, bx - ax
        low_y, low_x, high_y, high_x = (ay, ax, by, bx) if ay <= by else (by, bx, ay, ax)
        m = 0
        for level in levels:
            shift = SHIFT + level
            far = max(1, reach_cells * pair_cell(cell[owner[i]], LEVEL_CELL << level))
            for row in range((low_y - far) >> shift, ((high_y + far) >> shift) + 1):
                left, right = columns_in_row(low_y, low_x, high_y, high_x, row, far, shift)
                t, beyond = first_from(keys, tile_key(level, row, left)), tile_key(level, row, right)
                while t < len(keys) and keys[t] <= beyond:
                    for w in range(start[t], start[t + 1]):
                        k = items[w]
                        py, px = at[k, 0], at[k, 1]
                        if py < low_y - far or py > high_y + far:
                            continue
                        own, passed = False, False
                        for q in range(first[k], first[k + 1]):
                            if source[q] == owner[i]:
                                own = True
                                break
                            if dy * tangent[q, 0] + dx * tangent[q, 1] <= 0:
                                continue
                            reach = reach_cells * pair_cell(cell[owner[i]], cell[source[q]])
                            near_a = (py - ay) ** 2 + (px - ax) ** 2 <= reach * reach
                            near_b = (py - by) ** 2 + (px - bx) ** 2 <= reach * reach
                            if not near_a and not near_b and within(py, px, ay, ax, by, bx, reach):
                                passed = True
                        if own or not passed:
                            continue
                        along[m], found[m] = dy * (py - ay) + dx * (px - ax), k
                        m += 1
                    t += 1
        if m > 1:  # along the edge; ties by place
            by_place = np.argsort(found[:m])
            found[:m], along[:m] = found[:m][by_place], along[:m][by_place]
            order = np.argsort(along[:m], kind="mergesort")
            found[:m] = found[:m][order]
        y, x = after[i, 0], after[i, 1]
        for q in range(m + 1):
            if q < m:
                py, px = at[found[q], 0], at[found[q], 1]
            else:
                py, px = after[i, 2], after[i, 3]
            if py == y and px == x:
                continue
            if n == len(pieces):
                more = np.empty((2 * n, 4), np.int64)
                more[:n] = pieces
                pieces = more
                more_behind = np.empty(2 * n, np.int64)
                more_behind[:n] = behind
                behind = more_behind
            pieces[n, 0], pieces[n, 1], pieces[n, 2], pieces[n, 3] = y, x, py, px
            behind[n] = i
            n += 1
            y, x = py, px
    return pieces[:n].copy(), behind[:n].copy()
