"""Integer kernels of the arrangement: bands, crossings, routing through hot pixels.

Why int64 suffices: |coordinate| < 2^21 (``origin.MAX_REACH``), and an edge spans at most 2^16 along each axis
(``place.MAX_LENGTH``), 2^17 after snapping. Two edges whose boxes meet have |a - c| <= 2^18, so a cross product is at
most 2 * 2^18 * 2^17 = 2^36, and the numerator of a rounded intersection 2 * 2^17 * 2^36 + 2^35 < 2^55. A point against
any edge: doubled differences of at most 2^23 by 2^17, twice: 2^41. Pixel tests compare products of numbers below
2^20.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.kernel import kernel

Ints = NDArray[np.int64]


@kernel("Tuple((int64[::1], int64[::1]))(int64[::1], int64[::1], int64, int64, int64)")
def band_index(y0: Ints, y1: Ints, low: int, shift: int, n_bands: int) -> tuple[Ints, Ints]:
    """Edges by band of y: those of band b are ``items[start[b]:start[b + 1]]``, in the order given.

    Band 0 starts at ``low``; bands are 2^shift high.
    """
    start = np.zeros(n_bands + 1, np.int64)
    for i in range(len(y0)):
        for b in range((y0[i] - low) >> shift, ((y1[i] - low) >> shift) + 1):
            start[b + 1] += 1
    for b in range(n_bands):
        start[b + 1] += start[b]
    items = np.empty(start[n_bands], np.int64)
    fill = start[:n_bands].copy()
    for i in range(len(y0)):
        for b in range((y0[i] - low) >> shift, ((y1[i] - low) >> shift) + 1):
            items[fill[b]] = i
            fill[b] += 1
    return start, items


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


@kernel("int64[::1](int64[:, ::1], int64[::1], int64[::1], int64[::1], int64, int64)")
def count_crossings(ends: Ints, owner: Ints, start: Ints, items: Ints, n_sources: int, most: int) -> Ints:
    """In how many crossings each source has a part; stops soon after ``most`` of them.

    A crossing counts for the owners of both edges, and once for each band that both edges are in: the count
    bounds the work of ``crossings``, too.
    """
    counts = np.zeros(n_sources, np.int64)
    n = 0
    for b in range(len(start) - 1):
        for k in range(start[b], start[b + 1]):
            i = items[k]
            ay, ax, by, bx = ends[i, 0], ends[i, 1], ends[i, 2], ends[i, 3]
            x_low, x_high = min(ax, bx), max(ax, bx)
            for m in range(k + 1, start[b + 1]):
                j = items[m]
                cy, cx, ey, ex = ends[j, 0], ends[j, 1], ends[j, 2], ends[j, 3]
                if min(cx, ex) > x_high:
                    break
                if cy > by or ey < ay or max(cx, ex) < x_low:
                    continue
                if sides_if_crossing(ay, ax, by, bx, cy, cx, ey, ex)[0] != 0:
                    counts[owner[i]] += 1
                    counts[owner[j]] += 1
                    n += 1
            if n > most:  # in each turn: one band may hold all of them
                return counts
    return counts


@kernel("int64[:, ::1](int64[:, ::1], int64[::1], int64[::1])")
def crossings(ends: Ints, start: Ints, items: Ints) -> Ints:
    """Points (y, x), rounded half up, at which the insides of two edges (y0, x0, y1, x1), y0 <= y1, cross.

    ``start``, ``items``: bands, by least x. Only proper crossings: an end on another edge, and the ends of an
    overlap, are vertices already.
    """
    out = np.empty((64, 2), np.int64)
    n = 0
    for b in range(len(start) - 1):
        for k in range(start[b], start[b + 1]):
            i = items[k]
            ay, ax, by, bx = ends[i, 0], ends[i, 1], ends[i, 2], ends[i, 3]
            x_low, x_high = min(ax, bx), max(ax, bx)
            dy, dx = by - ay, bx - ax
            for m in range(k + 1, start[b + 1]):
                j = items[m]
                cy, cx, ey, ex = ends[j, 0], ends[j, 1], ends[j, 2], ends[j, 3]
                if min(cx, ex) > x_high:
                    break
                if cy > by or ey < ay or max(cx, ex) < x_low:
                    continue
                side_a, side_b = sides_if_crossing(ay, ax, by, bx, cy, cx, ey, ex)
                if side_a == 0:
                    continue
                # The crossing is a + d * num / den; den != 0, since the sides of a and b differ.
                num, den = side_a, side_a - side_b
                if den < 0:
                    num, den = -num, -den
                if n == len(out):
                    more = np.empty((2 * n, 2), np.int64)
                    more[:n] = out
                    out = more
                out[n, 0] = ay + (2 * dy * num + den) // (2 * den)
                out[n, 1] = ax + (2 * dx * num + den) // (2 * den)
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


@kernel("Tuple((int64[:, ::1], int64[::1]))(int64[:, ::1], int64[:, ::1])")
def route(ends: Ints, hot: Ints) -> tuple[Ints, Ints]:
    """Lead each edge (y0, x0, y1, x1), y0 <= y1, through the hot pixels that it meets, in order.

    ``hot``: (m, 2) lattice points (y, x), ascending, the ends among them. Returns the pieces (k, 4), directed
    as their edge, and the edge behind each.
    """
    pieces = np.empty((len(ends) + 64, 4), np.int64)
    owner = np.empty(len(ends) + 64, np.int64)
    n = 0
    for i in range(len(ends)):
        ay, ax, by, bx = ends[i, 0], ends[i, 1], ends[i, 2], ends[i, 3]
        x_low, x_high = min(ax, bx), max(ax, bx)
        step = 1 if bx >= ax else -1
        low, high = 0, len(hot)
        while low < high:  # the first hot pixel of row ay
            middle = (low + high) // 2
            if hot[middle, 0] < ay:
                low = middle + 1
            else:
                high = middle
        # Rows ascend along the edge; within one row the pixels are met in the direction of x.
        y, x = ay, ax
        k = low
        while k < len(hot) and hot[k, 0] <= by:
            row_end = k
            while row_end < len(hot) and hot[row_end, 0] == hot[k, 0]:
                row_end += 1
            for m in range(k, row_end):
                q = m if step > 0 else row_end - 1 - (m - k)
                py, px = hot[q, 0], hot[q, 1]
                if px < x_low or px > x_high or (py == y and px == x):
                    continue
                if not meets_pixel(ay, ax, by, bx, py, px):
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
            k = row_end
    return pieces[:n].copy(), owner[:n].copy()


@kernel(
    "Tuple((boolean[::1], boolean[::1]))"
    "(int64[:, ::1], int64[::1], int64[::1], int64[::1], int64[::1], int64[::1], int64, int64, int64)",
)
def free_sides(
    ends: Ints, first: Ints, source: Ints, winding: Ints, start: Ints, items: Ints, low: int, shift: int, n_sources: int
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Whether the left and the right side of each edge lies in the free space of any source.

    A ray goes from just above the middle of the edge towards -x. Edges meet only at vertices, so none but
    the edge itself passes through its middle, and every comparison is strict; heights are doubled to make
    the middle an integer. ``source[first[i]:first[i + 1]]`` and ``winding`` say by how much each source's
    winding number is higher on the left of edge i than on its right.
    """
    left = np.zeros(len(ends), np.bool_)
    right = np.zeros(len(ends), np.bool_)
    count = np.zeros(n_sources, np.int64)
    for i in range(len(ends)):
        my, mx = ends[i, 0] + ends[i, 2], ends[i, 1] + ends[i, 3]
        b = ((my >> 1) - low) >> shift
        count[:] = 0
        for k in range(start[b], start[b + 1]):
            j = items[k]
            cy, cx, ey, ex = ends[j, 0], ends[j, 1], ends[j, 2], ends[j, 3]
            if 2 * min(cx, ex) > mx:
                break
            if 2 * cy > my or 2 * ey <= my or j == i:
                continue
            if (ex - cx) * (my - 2 * cy) - (ey - cy) * (mx - 2 * cx) < 0:
                for q in range(first[j], first[j + 1]):
                    count[source[q]] -= winding[q]
        for s in range(n_sources):
            if count[s] > 0:
                left[i] = True
        for q in range(first[i], first[i + 1]):
            count[source[q]] -= winding[q]
        for s in range(n_sources):
            if count[s] > 0:
                right[i] = True
    return left, right
