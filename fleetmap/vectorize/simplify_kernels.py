"""Numba kernels that simplify arcs: between the vertices that must stay, the fewest and best edges."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.kernel import kernel
from fleetmap.vectorize.fewest_kernels import (
    AT_X,
    AT_Y,
    CORNER,
    GAP_ROWS,
    PLACE_X,
    PLACE_Y,
    SOURCES,
    TRUE_X,
    TRUE_Y,
    choose_fewest,
)
from fleetmap.vectorize.refine_kernels import merge_vertices, refit_vertices, sum_moments

TRY_ALL_STARTS = 10
"""Closed arcs of at most so many corners are simplified from each of them."""

REFITS = 2
"""Passes over the vertices of a chain: the third moves next to none."""


@kernel("void(i4[:,::1], i8, i8, i8, i8, i8, i8[:,::1])")
def turn_loop(
    points: NDArray[np.int32], start: int, size: int, begin: int, fy: int, fx: int, gap: NDArray[np.int64]
) -> None:
    """Fill a gap with the corners of a closed arc from ``begin`` on, and that one again."""
    for q in range(size + 1):
        c = start + (begin + q if begin + q < size else begin + q - size)
        gap[AT_Y, q], gap[AT_X, q] = points[c, 0], points[c, 1]
        gap[TRUE_Y, q], gap[TRUE_X, q] = 16 * points[c, 0] + fy, 16 * points[c, 1] + fx


@kernel("i8(i8[:,::1], i8)")
def make_three(gap: NDArray[np.int64], count: int) -> int:
    """Add the corners that are farthest from a closed chain until it has three edges; returns how many vertices."""
    ty, tx, corner = gap[TRUE_Y], gap[TRUE_X], gap[CORNER]
    while count < 4:
        best, where, place = np.int64(-1), np.int64(-1), 0
        for t in range(count - 1):
            a, b = corner[t], corner[t + 1]
            dy, dx = ty[b] - ty[a], tx[b] - tx[a]
            for m in range(a + 1, b):
                ry, rx = ty[m] - ty[a], tx[m] - tx[a]
                off = abs(dx * ry - dy * rx) if (dy != 0 or dx != 0) else ry * ry + rx * rx
                if off > best:
                    best, where, place = off, m, t + 1
        for q in range(count, place, -1):
            corner[q], gap[PLACE_Y, q], gap[PLACE_X, q] = corner[q - 1], gap[PLACE_Y, q - 1], gap[PLACE_X, q - 1]
        corner[place], gap[PLACE_Y, place], gap[PLACE_X, place] = where, gap[AT_Y, where], gap[AT_X, where]
        count += 1
    return count


@kernel("i8(u1[:,::1], i8, i8, i8[:,::1], i8, i8, f8, i8, i8, f8[:,::1], f8[:,::1])")
def refine(
    cracks: NDArray[np.uint8],
    oy: int,
    ox: int,
    gap: NDArray[np.int64],
    n: int,
    epsilon2: int,
    epsilon: float,
    count: int,
    least: int,
    moments: NDArray[np.float64],
    wedges: NDArray[np.float64],
) -> int:
    """Merge and refit a chosen chain; returns its number of vertices."""
    if count > 2:
        sum_moments(gap, n, moments)
        count = merge_vertices(cracks, oy, ox, gap, n, moments, epsilon2, epsilon, count, least, wedges)
        for _ in range(REFITS):
            if refit_vertices(cracks, oy, ox, gap, n, moments, epsilon2, count) == 0:
                break
    return count


@kernel(
    "void(u1[:,::1], i8, i8, i4[:,::1], i8, i8, i8, i8, i8, f8, i4[:,::1], u1[::1], i8[:,::1], f8[::1], f8[:,::1],"
    " f8[:,::1])",
)
def simplify_loop(
    cracks: NDArray[np.uint8],
    oy: int,
    ox: int,
    points: NDArray[np.int32],
    start: int,
    size: int,
    fy: int,
    fx: int,
    epsilon2: int,
    epsilon: float,
    at: NDArray[np.int32],
    is_vertex: NDArray[np.uint8],
    gap: NDArray[np.int64],
    error: NDArray[np.float64],
    moments: NDArray[np.float64],
    wedges: NDArray[np.float64],
) -> None:
    """Simplify a closed arc without stops: at least three edges, from a start that is then moved too."""
    n = size + 1
    begin = 0
    if size <= TRY_ALL_STARTS:
        fewest, least = np.int64(1) << 60, 1e300
        for attempt in range(size):
            turn_loop(points, start, size, attempt, fy, fx, gap)
            edges = choose_fewest(gap, n, epsilon, error, SOURCES) - 1
            off = error[n - 1] if edges >= 3 else 1e299
            if max(edges, 3) < fewest or (max(edges, 3) == fewest and off < least):
                fewest, least, begin = max(edges, 3), off, attempt
    else:
        far = np.int64(-1) << 60
        for c in range(size):
            value = 5 * np.int64(points[start + c, 0]) + 3 * np.int64(points[start + c, 1])
            if value > far:
                far, begin = value, c
    turn_loop(points, start, size, begin, fy, fx, gap)
    count = make_three(gap, choose_fewest(gap, n, epsilon, error, SOURCES))
    count = refine(cracks, oy, ox, gap, n, epsilon2, epsilon, count, 4, moments, wedges)
    # Once more from the vertex in the middle, so that the first one may move, too.
    middle = count // 2
    shift = gap[CORNER, middle]
    chain = gap[CORNER:, :count].copy()
    begin = (begin + shift) % size
    turn_loop(points, start, size, begin, fy, fx, gap)
    for q in range(count):
        p = middle + q if middle + q < count - 1 else middle + q - (count - 1)
        gap[CORNER, q] = chain[0, p] - shift if middle + q < count - 1 else chain[0, p] - shift + size
        gap[PLACE_Y, q], gap[PLACE_X, q] = chain[1, p], chain[2, p]
    sum_moments(gap, n, moments)
    count = merge_vertices(cracks, oy, ox, gap, n, moments, epsilon2, epsilon, count, 4, wedges)
    refit_vertices(cracks, oy, ox, gap, n, moments, epsilon2, count)
    for q in range(count - 1):
        c = start + (begin + gap[CORNER, q]) % size
        is_vertex[c] = 1
        at[c, 0], at[c, 1] = gap[PLACE_Y, q], gap[PLACE_X, q]


@kernel(
    "void(u1[:,::1], i8, i8, i4[:,::1], i8, i8, i8, i8, i8, i8, i8, f8, i4[:,::1], u1[::1], i8[:,::1], f8[::1],"
    " f8[:,::1], f8[:,::1])",
)
def simplify_gap(
    cracks: NDArray[np.uint8],
    oy: int,
    ox: int,
    points: NDArray[np.int32],
    start: int,
    end: int,
    first: int,
    last: int,
    fy: int,
    fx: int,
    epsilon2: int,
    epsilon: float,
    at: NDArray[np.int32],
    is_vertex: NDArray[np.uint8],
    gap: NDArray[np.int64],
    error: NDArray[np.float64],
    moments: NDArray[np.float64],
    wedges: NDArray[np.float64],
) -> None:
    """Choose the vertices between two that stay, corners ``first`` and ``last`` of the arc from ``start`` to ``end``.

    Once around it, if they are the same.
    """
    n = 0
    m = first
    while True:
        gap[TRUE_Y, n], gap[TRUE_X, n] = 16 * points[m, 0] + fy, 16 * points[m, 1] + fx
        gap[AT_Y, n], gap[AT_X, n] = points[m, 0], points[m, 1]
        n += 1
        if n > 1 and m == last:
            break
        m = m + 1 if m + 1 < end else start
    for q, m in ((0, first), (n - 1, last)):
        gap[AT_Y, q], gap[AT_X, q] = at[m, 0], at[m, 1]
    count = choose_fewest(gap, n, epsilon, error, SOURCES)
    count = refine(cracks, oy, ox, gap, n, epsilon2, epsilon, count, 2, moments, wedges)
    for q in range(1, count - 1):
        c = first + gap[CORNER, q]
        if c >= end:
            c -= end - start
        is_vertex[c] = 1
        at[c, 0], at[c, 1] = gap[PLACE_Y, q], gap[PLACE_X, q]


@kernel(
    "void(u1[:,::1], i8, i8, i4[:,::1], i4[::1], u1[::1], i8, i8, i8, i8, u1[::1], u1[::1], i4[:,::1], u1[::1])",
)
def simplify_arcs(
    cracks: NDArray[np.uint8],
    oy: int,
    ox: int,
    points: NDArray[np.int32],
    offsets: NDArray[np.int32],
    closed: NDArray[np.uint8],
    arcs: int,
    fy: int,
    fx: int,
    epsilon2: int,
    stops: NDArray[np.uint8],
    kept: NDArray[np.uint8],
    at: NDArray[np.int32],
    is_vertex: NDArray[np.uint8],
) -> None:
    """Choose the vertices of all arcs.

    Parameters
    ----------
    cracks, oy, ox : as in ``cells_kernels``; point (y, x) is found at (y - oy, x - ox)
    points, offsets, closed : corners (y, x) of one arc after the other
    fy, fx : the true place of the boundary minus its points, in sixteenths of a cell
    epsilon2 : epsilon squared, in sixteenths of a cell squared
    stops : (n,) corners that must be vertices, where ``at`` says; the ends of open arcs always are
    kept : (n,) stops from which an edge leads to the next one that is to stay as it is
    at : (n, 2) out: lattice place of the vertices
    is_vertex : (n,) out
    """
    longest = 0
    for arc in range(arcs):
        longest = max(longest, offsets[arc + 1] - offsets[arc])
    room = longest + 2
    gap, error = np.empty((GAP_ROWS, room), np.int64), np.empty(room, np.float64)
    moments, wedges = np.empty((room, 6), np.float64), np.empty((room, 6), np.float64)
    epsilon = np.sqrt(float(epsilon2)) / 16.0
    for arc in range(arcs):
        start, end = np.int64(offsets[arc]), np.int64(offsets[arc + 1])
        size = end - start
        if size < 2:
            continue
        first = start
        if closed[arc]:
            while first < end and not stops[first]:
                first += 1
            if first == end:
                simplify_loop(
                    cracks, oy, ox, points, start, size, fy, fx, epsilon2, epsilon, at, is_vertex, gap, error, moments,
                    wedges,
                )  # fmt: skip
                continue
        walked, total = 0, size if closed[arc] else size - 1
        m = first
        while walked < total:
            # On to the next stop.
            k = m
            while k == m or (walked < total and not stops[k]):
                k = k + 1 if k + 1 < end else start
                walked += 1
                if walked == total:
                    break
            for c in (m, k):
                is_vertex[c] = 1
                if not stops[c]:
                    at[c, 0], at[c, 1] = points[c, 0], points[c, 1]
            if not kept[m]:
                simplify_gap(
                    cracks, oy, ox, points, start, end, m, k, fy, fx, epsilon2, epsilon, at, is_vertex, gap, error,
                    moments, wedges,
                )  # fmt: skip
            m = k
