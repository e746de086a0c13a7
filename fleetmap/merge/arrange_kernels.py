"""Integer kernels of the arrangement: crossings, routing through hot pixels, what is free.

Why int64 suffices: |coordinate| < 2^21 (``origin.MAX_REACH``), and an edge spans at most 2^16 along each axis
(``place.MAX_LENGTH``), 2^17 after snapping. Two edges whose boxes meet have |a - c| <= 2^18, so a cross product is at
most 2 * 2^18 * 2^17 = 2^36, and the numerator of a rounded intersection 2 * 2^17 * 2^36 + 2^35 < 2^55. A point against
any edge: doubled differences of at most 2^23 by 2^17, twice: 2^41. Pixel tests compare products of numbers below
2^20.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.merge.tile_kernels import columns_in_row, first_from, tile_key
from fleetmap.merge.tiles import KEY_BITS, SHIFT
from fleetmap.model.kernel import kernel

Ints = NDArray[np.int64]


@kernel("UniTuple(int64, 2)(int64, int64, int64, int64, int64, int64, int64, int64)")
def sides_if_crossing(ay: int, ax: int, by: int, bx: int, cy: int, cx: int, ey: int, ex: int) -> tuple[int, int]:
    """On which sides of edge c to e the points a and b lie (cross products), if the insides of both edges cross.

    Else (0, 0): of two edges that cross properly, no end lies on the other one's line.
    """
    dy, dx = by - ay, bx - ax
    side_c = dx * (cy - ay) - dy * (cx - ax)
    side_e = dx * (ey - ay) - dy * (ex - ax)
    if not ((side_c < 0 and side_e > 0) or (side_c > 0 and side_e < 0)):
        return 0, 0
    fy, fx = ey - cy, ex - cx
    side_a = fx * (ay - cy) - fy * (ax - cx)
    side_b = fx * (by - cy) - fy * (bx - cx)
    if not ((side_a < 0 and side_b > 0) or (side_a > 0 and side_b < 0)):
        return 0, 0
    return side_a, side_b


@kernel("UniTuple(int64, 2)(int64, int64, int64, int64, int64, int64)")
def crossing_point(ay: int, ax: int, by: int, bx: int, side_a: int, side_b: int) -> tuple[int, int]:
    """The point (y, x), rounded half up, at which edge a to b crosses one on whose sides a and b lie like this."""
    # It is a + d * num / den; den != 0, since the sides of a and b differ.
    num, den = side_a, side_a - side_b
    if den < 0:
        num, den = -num, -den
    return ay + (2 * (by - ay) * num + den) // (2 * den), ax + (2 * (bx - ax) * num + den) // (2 * den)


@kernel("boolean(int64[:, ::1], int64, int64, int64)")
def crossing_in_tile(ends: Ints, i: int, j: int, key: int) -> bool:
    """Whether the insides of two edges cross, and in the tile of this key: of the tiles that both pass, in one."""
    ay, ax, by, bx = ends[i, 0], ends[i, 1], ends[i, 2], ends[i, 3]
    cy, cx, ey, ex = ends[j, 0], ends[j, 1], ends[j, 2], ends[j, 3]
    if cy > by or ey < ay or max(cx, ex) < min(ax, bx) or min(cx, ex) > max(ax, bx):
        return False
    side_a, side_b = sides_if_crossing(ay, ax, by, bx, cy, cx, ey, ex)
    if side_a == 0:
        return False
    y, x = crossing_point(ay, ax, by, bx, side_a, side_b)
    return tile_key(0, y >> SHIFT, x >> SHIFT) == key


@kernel("int64[:, ::1](int64[:, ::1], int64[::1], int64[::1], int64[::1])")
def crossings(ends: Ints, keys: Ints, start: Ints, items: Ints) -> Ints:
    """Points (y, x), rounded half up, at which the insides of two edges (y0, x0, y1, x1), y0 <= y1, cross.

    ``keys``, ``start``, ``items``: ``Tiles`` of the edges. Only proper crossings: an end on another edge, and the ends
    of an overlap, are vertices already. Each is found in each tile that both edges are in, and given in its own.
    """
    out = np.empty((64, 2), np.int64)
    n = 0
    for t in range(len(keys)):
        for k in range(start[t], start[t + 1]):
            i = items[k]
            ay, ax, by, bx = ends[i, 0], ends[i, 1], ends[i, 2], ends[i, 3]
            x_low, x_high = min(ax, bx), max(ax, bx)
            for m in range(k + 1, start[t + 1]):
                j = items[m]
                cy, cx, ey, ex = ends[j, 0], ends[j, 1], ends[j, 2], ends[j, 3]
                if min(cx, ex) > x_high:
                    break
                if cy > by or ey < ay or max(cx, ex) < x_low:
                    continue
                side_a, side_b = sides_if_crossing(ay, ax, by, bx, cy, cx, ey, ex)
                if side_a == 0:
                    continue
                y, x = crossing_point(ay, ax, by, bx, side_a, side_b)
                if tile_key(0, y >> SHIFT, x >> SHIFT) != keys[t]:
                    continue
                if n == len(out):
                    more = np.empty((2 * n, 2), np.int64)
                    more[:n] = out
                    out = more
                out[n, 0], out[n, 1] = y, x
                n += 1
    return out[:n].copy()


@kernel("boolean(int64, int64, int64, int64, int64, int64)")
def meets_pixel(ay: int, ax: int, by: int, bx: int, py: int, px: int) -> bool:
    """Whether the edge a to b meets the half-open unit square [p - 1/2, p + 1/2) around lattice point p.

    Half-open, like rounding half up: every point of the plane lies in exactly one pixel.
    """
    # The part of the edge inside, as t in lo .. hi (fractions), each bound with a flag: is it included?
    lo_n, lo_d, lo_in = 0, 1, True
    hi_n, hi_d, hi_in = 1, 1, True
    for axis in range(2):
        a, d, p = (ax, bx - ax, px) if axis == 0 else (ay, by - ay, py)
        if d == 0:
            if a != p:
                return False
            continue
        if d > 0:
            in_n, in_in, out_n, out_in = 2 * (p - a) - 1, True, 2 * (p - a) + 1, False
        else:
            d = -d
            in_n, in_in, out_n, out_in = 2 * (a - p) - 1, False, 2 * (a - p) + 1, True
        d *= 2
        order = in_n * lo_d - lo_n * d
        if order > 0:
            lo_n, lo_d, lo_in = in_n, d, in_in
        elif order == 0:
            lo_in = lo_in and in_in
        order = out_n * hi_d - hi_n * d
        if order < 0:
            hi_n, hi_d, hi_in = out_n, d, out_in
        elif order == 0:
            hi_in = hi_in and out_in
    order = lo_n * hi_d - hi_n * lo_d
    return order < 0 or (order == 0 and lo_in and hi_in)


@kernel("Tuple((int64[:, ::1], int64[::1]))(int64[:, ::1], int64[:, ::1], int64[::1], int64[::1], int64[::1])")
def route(ends: Ints, hot: Ints, keys: Ints, start: Ints, items: Ints) -> tuple[Ints, Ints]:
    """Lead each edge (y0, x0, y1, x1), y0 <= y1, through the hot pixels that it meets, in order.

    ``hot``: (m, 2) lattice points (y, x), ascending, the ends among them; ``keys``, ``start``, ``items``: their
    ``Tiles``. Returns the pieces (k, 4), directed as their edge, and the edge behind each.
    """
    pieces = np.empty((len(ends) + 64, 4), np.int64)
    owner = np.empty(len(ends) + 64, np.int64)
    met = np.empty(64, np.int64)
    n = 0
    for i in range(len(ends)):
        ay, ax, by, bx = ends[i, 0], ends[i, 1], ends[i, 2], ends[i, 3]
        x_low, x_high = min(ax, bx), max(ax, bx)
        n_met = 0
        for row in range((ay - 1) >> SHIFT, ((by + 1) >> SHIFT) + 1):
            first, last = columns_in_row(ay, ax, by, bx, row, 1, SHIFT)
            t, beyond = first_from(keys, tile_key(0, row, first)), tile_key(0, row, last)
            while t < len(keys) and keys[t] <= beyond:
                for k in range(start[t], start[t + 1]):
                    p = items[k]
                    py, px = hot[p, 0], hot[p, 1]
                    if py < ay or py > by or px < x_low or px > x_high or not meets_pixel(ay, ax, by, bx, py, px):
                        continue
                    if n_met == len(met):
                        more_met = np.empty(2 * n_met, np.int64)
                        more_met[:n_met] = met
                        met = more_met
                    met[n_met] = p
                    n_met += 1
                t += 1
        # Rows ascend along the edge; within one row the pixels are met in the direction of x.
        met[:n_met].sort()
        if bx < ax:
            k = 0
            while k < n_met:
                row_end = k
                while row_end < n_met and hot[met[row_end], 0] == hot[met[k], 0]:
                    row_end += 1
                met[k:row_end] = met[k:row_end][::-1].copy()
                k = row_end
        y, x = ay, ax
        for k in range(n_met):
            py, px = hot[met[k], 0], hot[met[k], 1]
            if py == y and px == x:
                continue
            if n == len(pieces):
                more = np.empty((2 * n, 4), np.int64)
                more[:n] = pieces
                pieces = more
                more_owner = np.empty(2 * n, np.int64)
                more_owner[:n] = owner
                owner = more_owner
            pieces[n, 0], pieces[n, 1], pieces[n, 2], pieces[n, 3] = y, x, py, px
            owner[n] = i
            n += 1
            y, x = py, px
    return pieces[:n].copy(), owner[:n].copy()


@kernel("boolean(int64, int64, int64, int64, int64, int64)")
def is_left(py: int, px: int, cy: int, cx: int, ey: int, ex: int) -> bool:
    """Whether the point just above p / 2 lies on the left of edge c to e, on which it does not lie itself."""
    side = (ex - cx) * (py - 2 * cy) - (ey - cy) * (px - 2 * cx)
    return side > 0 or (side == 0 and ex > cx)


@kernel("int64(int64[::1], int64, int64, int64[::1], int64[::1], int64[::1])")
def wind(count: Ints, j: int, sign: int, first: Ints, source: Ints, winding: Ints) -> int:
    """Add the windings of edge j to the counts of its sources; by how many more of these are positive then."""
    more = 0
    for q in range(first[j], first[j + 1]):
        s = source[q]
        if count[s] > 0:
            more -= 1
        count[s] += sign * winding[q]
        if count[s] > 0:
            more += 1
    return more


@kernel(
    "Tuple((boolean[::1], boolean[::1]))"
    "(int64[:, ::1], int64[::1], int64[::1], int64[::1], int64[::1], int64[::1], int64[::1], int64[::1], int64[::1],"
    " int64)",
)
def free_sides(
    ends: Ints,
    first: Ints,
    source: Ints,
    winding: Ints,
    keys: Ints,
    start: Ints,
    items: Ints,
    middles: Ints,
    middle_start: Ints,
    n_sources: int,
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Whether the left and the right side of each edge lies in the free space of any source.

    ``source[first[i]:first[i + 1]]`` and ``winding`` say by how much each source's winding number is higher on the
    left of edge i than on its right. ``keys``, ``start``, ``items``: ``Tiles`` of the edges; the middles of the edges
    ``middles[middle_start[t]:middle_start[t + 1]]`` lie in tile t.

    A way leads along each row of tiles, half a step below them, from far away, where all winding numbers are 0. From
    where it enters a tile, half a step to the left, another way leads up and then right to the middle of each edge in
    it. All ways are traced just above where they are said to be. With coordinates doubled, to make middles integers,
    the long ways and the ways up have odd coordinates, and so meet no vertex; and edges meet only at vertices, so that
    none but the edge itself passes through its middle. The edges that a way within a tile may cross are in that tile.
    """
    left = np.zeros(len(ends), np.bool_)
    right = np.zeros(len(ends), np.bool_)
    count = np.zeros(n_sources, np.int64)
    crossed = np.empty(len(ends), np.int64)
    column_mask = (1 << KEY_BITS) - 1
    half = 1 << (KEY_BITS - 1)
    positive = 0  # as are all counts from the last tile of a row to the first of the next: cycles are closed
    for t in range(len(keys)):
        y0 = (((keys[t] >> KEY_BITS) - half) << (SHIFT + 1)) - 1
        x0 = (((keys[t] & column_mask) - half) << (SHIFT + 1)) - 1
        for m in range(middle_start[t], middle_start[t + 1]):
            i = middles[m]
            my, mx = ends[i, 0] + ends[i, 2], ends[i, 1] + ends[i, 3]
            n, at_middle = 0, positive
            for k in range(start[t], start[t + 1]):
                j = items[k]
                cy, cx, ey, ex = ends[j, 0], ends[j, 1], ends[j, 2], ends[j, 3]
                if 2 * min(cx, ex) > mx:
                    break
                at_foot, at_corner = 2, 2  # neither: the way doesn't pass
                if 2 * cy <= my and my < 2 * ey and j != i:
                    at_corner = int(is_left(my, x0, cy, cx, ey, ex))
                    if at_corner != int(is_left(my, mx, cy, cx, ey, ex)):
                        at_middle += wind(count, j, 1 - 2 * at_corner, first, source, winding)
                        crossed[n] = 2 * j + at_corner
                        n += 1
                if min(cx, ex) * 2 < x0 and x0 < 2 * max(cx, ex) and 2 * ey > y0 and 2 * cy <= my:
                    at_foot = int(is_left(y0, x0, cy, cx, ey, ex))
                    if at_foot != int(is_left(my, x0, cy, cx, ey, ex)):
                        at_middle += wind(count, j, 1 - 2 * at_foot, first, source, winding)
                        crossed[n] = 2 * j + at_foot
                        n += 1
                if n > len(crossed) - 2:
                    more = np.empty(2 * len(crossed) + 2, np.int64)
                    more[:n] = crossed[:n]
                    crossed = more
            left[i] = at_middle > 0
            right[i] = at_middle + wind(count, i, -1, first, source, winding) > 0
            wind(count, i, 1, first, source, winding)
            for k in range(n):
                wind(count, crossed[k] >> 1, 2 * (crossed[k] & 1) - 1, first, source, winding)
        # On to the next tile of the row.
        x1 = x0 + (2 << SHIFT)
        for k in range(start[t], start[t + 1]):
            j = items[k]
            cy, cx, ey, ex = ends[j, 0], ends[j, 1], ends[j, 2], ends[j, 3]
            if 2 * cy <= y0 and y0 < 2 * ey:
                before = int(is_left(y0, x0, cy, cx, ey, ex))
                if before != int(is_left(y0, x1, cy, cx, ey, ex)):
                    positive += wind(count, j, 1 - 2 * before, first, source, winding)
    return left, right
