"""Integer kernel of the selection: which walls are second sights of walls that stay.

Why int64 suffices: a point is compared only with walls (at most 2^17 along an axis) whose box, grown by ``reach``
<= 2^13, holds it, so cross and dot products stay below 2^36. A distance is compared as
cross^2 <= reach^2 length^2 only where |cross| <= reach * (|dx| + |dy|) <= 2^31, which that implies; both sides are
then at most 2^62.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.merge import place
from fleetmap.merge.tile_kernels import columns_in_row, first_from, tile_key
from fleetmap.merge.tiles import LEVEL_CELL, SHIFT
from fleetmap.model.kernel import kernel

Ints = NDArray[np.int64]

pair_cell = kernel("int64(int64, int64)")(place.pair_cell)


@kernel("boolean(int64, int64, int64, int64, int64, int64, int64)")
def within(py: int, px: int, ay: int, ax: int, by: int, bx: int, reach: int) -> bool:
    """Whether point p is at most ``reach`` from the segment a to b, exactly."""
    if py < min(ay, by) - reach or py > max(ay, by) + reach or px < min(ax, bx) - reach or px > max(ax, bx) + reach:
        return False
    dy, dx, qy, qx = by - ay, bx - ax, py - ay, px - ax
    along, length2 = dx * qx + dy * qy, dx * dx + dy * dy
    if along <= 0:
        return qx * qx + qy * qy <= reach * reach
    if along >= length2:
        qy, qx = py - by, px - bx
        return qx * qx + qy * qy <= reach * reach
    cross = abs(dx * qy - dy * qx)
    return cross <= reach * (abs(dx) + abs(dy)) and cross * cross <= reach * reach * length2


@kernel(
    "int64(int64[:, ::1], int64[::1], int64[::1], int64[::1], boolean[::1], int64[::1], int64[::1], int64[::1],"
    " int64[::1], int64, int64, int64, int64, int64, int64, int64, int64[::1], int64, int64[::1], int64[::1])",
)
def gather(
    ends: Ints,
    faces: Ints,
    rank: Ints,
    cell: Ints,
    gone: NDArray[np.bool_],
    levels: Ints,
    keys: Ints,
    start: Ints,
    items: Ints,
    reach_cells: int,
    i: int,
    bit: int,
    ay: int,
    ax: int,
    by: int,
    bx: int,
    seen: Ints,
    mark: int,
    near: Ints,
    near_reach: Ints,
) -> int:
    """How many walls may explain the part a to b, ay <= by, of edge i on a side; they are put into ``near``.

    ``seen``: by which search each edge was met last; ``mark`` is this one's number.
    """
    dy, dx = ends[i, 2] - ends[i, 0], ends[i, 3] - ends[i, 1]
    x_low, x_high = min(ax, bx), max(ax, bx)
    n = 0
    for level in levels:
        shift = SHIFT + level
        far = max(1, reach_cells * pair_cell(cell[i], LEVEL_CELL << level))
        for row in range((ay - far) >> shift, ((by + far) >> shift) + 1):
            first, last = columns_in_row(ay, ax, by, bx, row, far, shift)
            t, beyond = first_from(keys, tile_key(level, row, first)), tile_key(level, row, last)
            while t < len(keys) and keys[t] <= beyond:
                for k in range(start[t], start[t + 1]):
                    j = items[k]
                    if rank[j] >= rank[i] or gone[j] or seen[j] == mark:
                        continue
                    cy, cx, ey, ex = ends[j, 0], ends[j, 1], ends[j, 2], ends[j, 3]
                    if min(cx, ex) > x_high + far:
                        break
                    reach = reach_cells * pair_cell(cell[i], cell[j])
                    if max(cx, ex) < x_low - reach or min(cx, ex) > x_high + reach:
                        continue
                    if cy > by + reach or ey < ay - reach:
                        continue
                    seen[j] = mark
                    # Along j within 63 degrees (tangent 2) and seen from the same side, or against it with sides
                    # swapped. A wall that ends at another, square to it, is no second sight of that.
                    dot = dy * (ey - cy) + dx * (ex - cx)
                    if abs(dx * (ey - cy) - dy * (ex - cx)) > 2 * abs(dot):
                        continue
                    if (dot > 0 and faces[j] & bit != 0) or (dot < 0 and faces[j] & (3 - bit) != 0):
                        near[n] = j
                        near_reach[n] = reach
                        n += 1
                t += 1
    return n


@kernel(
    "boolean[::1](int64[:, ::1], int64[::1], int64[::1], int64[::1], int64[::1], int64[::1], int64[::1], int64[::1],"
    " int64[::1], int64)",
)
def explained(
    ends: Ints,
    faces: Ints,
    rank: Ints,
    cell: Ints,
    order: Ints,
    levels: Ints,
    keys: Ints,
    start: Ints,
    items: Ints,
    reach_cells: int,
) -> NDArray[np.bool_]:
    """Which walls lie within reach of walls that stay, have a lower rank and face the same way.

    The reach of two walls is ``reach_cells`` cells, see ``pair_cell``. ``faces``: bit 0, the wall is seen from
    its left; bit 1, from its right. A wall seen from both must be explained on both. ``order`` visits the walls
    by ascending rank, so that only what stays explains. ``keys``, ``start``, ``items``: ``Tiles`` of the walls, each
    in its level; ``levels`` are those that there are.

    An edge is tested at points at most ``spacing`` apart, rounded to the lattice; what the spacing and the rounding
    may hide is taken off the reach. A long one is tested part by part, so that each point is held against what lies
    near it, and not against all that lies along the edge.
    """
    gone = np.zeros(len(ends), np.bool_)
    near = np.empty(len(ends), np.int64)
    near_reach = np.empty(len(ends), np.int64)
    seen = np.full(len(ends), -1)
    mark = 0
    for i in order:
        if rank[i] < 0:
            continue
        ay, ax, by, bx = ends[i, 0], ends[i, 1], ends[i, 2], ends[i, 3]
        known = True
        for bit in (1, 2):
            if faces[i] & bit == 0:
                continue
            n = gather(
                ends, faces, rank, cell, gone, levels, keys, start, items, reach_cells, i, bit, ay, ax, by, bx,
                seen, mark, near, near_reach,
            )  # fmt: skip
            mark += 1
            if n == 0:
                known = False
                break
            spacing = max(1, near_reach[:n].min() // 4)
            parts = max(1, (abs(by - ay) + abs(bx - ax) + spacing - 1) // spacing)
            at_once = max(1, (1 << SHIFT) // spacing)
            here = 0
            for k in range(parts + 1):
                py = ay + (2 * (by - ay) * k + parts) // (2 * parts)
                px = ax + (2 * (bx - ax) * k + parts) // (2 * parts)
                if parts > 2 * at_once and k % at_once == 0:
                    to = min(parts, k + at_once)
                    qy = ay + (2 * (by - ay) * to + parts) // (2 * parts)
                    qx = ax + (2 * (bx - ax) * to + parts) // (2 * parts)
                    n = gather(
                        ends, faces, rank, cell, gone, levels, keys, start, items, reach_cells, i, bit, py, px, qy, qx,
                        seen, mark, near, near_reach,
                    )  # fmt: skip
                    mark += 1
                    here = 0
                # Along the edge, what explains one point mostly explains the next.
                found = -1
                for m in range(n):
                    q = here + m if here + m < n else here + m - n
                    j = near[q]
                    if within(py, px, ends[j, 0], ends[j, 1], ends[j, 2], ends[j, 3], near_reach[q] - spacing // 2 - 1):
                        found = q
                        break
                if found < 0:
                    known = False
                    break
                here = found
            if not known:
                break
        gone[i] = known
    return gone
