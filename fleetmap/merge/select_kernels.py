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


@kernel("boolean(int64[:, ::1], int64[::1], int64[::1], int64, int64)")
def covered(ends: Ints, near: Ints, reach: Ints, n_near: int, i: int) -> bool:
    """Whether edge i lies within ``reach[k]`` of the edges ``near[k]``, k < n_near.

    Tested at points at most ``spacing`` apart, rounded to the lattice; what the spacing and the rounding may
    hide is taken off the reach.
    """
    spacing = max(1, reach[:n_near].min() // 4) if n_near else 1
    ay, ax, by, bx = ends[i, 0], ends[i, 1], ends[i, 2], ends[i, 3]
    parts = max(1, (abs(by - ay) + abs(bx - ax) + spacing - 1) // spacing)
    for k in range(parts + 1):
        py = ay + (2 * (by - ay) * k + parts) // (2 * parts)
        px = ax + (2 * (bx - ax) * k + parts) // (2 * parts)
        found = False
        for m in range(n_near):
            j = near[m]
            if within(py, px, ends[j, 0], ends[j, 1], ends[j, 2], ends[j, 3], reach[m] - spacing // 2 - 1):
                found = True
                break
        if not found:
            return False
    return True


@kernel(
    "boolean[::1](int64[:, ::1], int64[::1], int64[::1], int64[::1], int64[::1], int64[::1], int64[::1], int64,"
    " int64, int64)",
)
def explained(
    ends: Ints,
    faces: Ints,
    rank: Ints,
    cell: Ints,
    order: Ints,
    start: Ints,
    items: Ints,
    low: int,
    shift: int,
    reach_cells: int,
) -> NDArray[np.bool_]:
    """Which walls lie within reach of walls that stay, have a lower rank and face the same way.

    The reach of two walls is ``reach_cells`` cells, see ``pair_cell``. ``faces``: bit 0, the wall is seen from
    its left; bit 1, from its right. A wall seen from both must be explained on both. ``order`` visits the walls
    by ascending rank, so that only what stays explains.
    """
    gone = np.zeros(len(ends), np.bool_)
    near = np.empty(len(ends), np.int64)
    near_reach = np.empty(len(ends), np.int64)
    for i in order:
        if rank[i] < 0:
            continue
        ay, ax, by, bx = ends[i, 0], ends[i, 1], ends[i, 2], ends[i, 3]
        reach = 2 * reach_cells * cell[i]
        x_low, x_high = min(ax, bx) - reach, max(ax, bx) + reach
        first = max(0, (ay - reach - low) >> shift)
        last = min(len(start) - 2, (by + reach - low) >> shift)
        known = True
        for bit in (1, 2):
            if faces[i] & bit == 0:
                continue
            n = 0
            for b in range(first, last + 1):
                for k in range(start[b], start[b + 1]):
                    j = items[k]
                    cy, cx, ey, ex = ends[j, 0], ends[j, 1], ends[j, 2], ends[j, 3]
                    if min(cx, ex) > x_high:
                        break
                    if max(cx, ex) < x_low or cy > by + reach or ey < ay - reach:
                        continue
                    if rank[j] >= rank[i] or gone[j] or (b > first and (cy - low) >> shift < b):
                        continue  # the last: met in the band before
                    # Along j within 63 degrees (tangent 2) and seen from the same side, or against it with sides
                    # swapped. A wall that ends at another, square to it, is no second sight of that.
                    dot = (by - ay) * (ey - cy) + (bx - ax) * (ex - cx)
                    if abs((bx - ax) * (ey - cy) - (by - ay) * (ex - cx)) > 2 * abs(dot):
                        continue
                    if (dot > 0 and faces[j] & bit != 0) or (dot < 0 and faces[j] & (3 - bit) != 0):
                        near[n] = j
                        near_reach[n] = reach_cells * pair_cell(cell[i], cell[j])
                        n += 1
            if not covered(ends, near, near_reach, n, i):
                known = False
                break
        gone[i] = known
    return gone
