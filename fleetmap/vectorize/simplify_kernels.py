"""Numba kernels that choose vertices along the boundary, within epsilon, by exact integers.

A boundary is the points of its loops, one a unit step, in cells of the epoch's lattice; its true place is off
by (fy, fx) sixteenths of a cell, since a grid may have another phase than the lattice. Vertices lie on the
lattice. Point m stands for vertex (at_y[m], at_x[m]) where is_vertex[m] is set; an edge from vertex a to the
next one, b, owns the run of boundary from point a to point b. Its certificate:

* both its ends are within epsilon of the points they stand for, and
* all turns of the run between are within epsilon of the edge.

Then every point of the run is within epsilon of the edge (the set of points that are is convex), and every
point of the edge within epsilon of the run (the nearest point of the edge moves continuously along it).

Bits: |coordinates| <= 2^24 sixteenths and edges of at most 2^12 cells, so products stay below 2^43, and what
is squared below 2^31; epsilon2 (in sixteenths, squared) <= 2^20.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

LONGEST_EDGE_CELLS = 4096
"""No edge is longer along x or y, so that the products of the certificate fit 64 bits."""


@njit("b1(i8, i8, i8, i8, i8, i8, i8)", cache=True, nogil=True, inline="always")
def is_near(py: int, px: int, ay: int, ax: int, by: int, bx: int, epsilon2: int) -> bool:
    """Whether point p is within epsilon of the segment from a to b, all in sixteenths."""
    dy, dx = by - ay, bx - ax
    ry, rx = py - ay, px - ax
    along = dy * ry + dx * rx
    length2 = dy * dy + dx * dx
    if along <= 0:
        if abs(ry) > 1024 or abs(rx) > 1024:
            return False
        return ry * ry + rx * rx <= epsilon2
    if along >= length2:
        ry, rx = py - by, px - bx
        if abs(ry) > 1024 or abs(rx) > 1024:
            return False
        return ry * ry + rx * rx <= epsilon2
    cross = dx * ry - dy * rx
    if abs(cross) > 1 << 31:
        return False
    return cross * cross <= epsilon2 * length2


@njit("void(i8[:,::1], u1[::1], i8[::1], i8, i8, i8, u1[::1], u1[::1], i8[:,::1], u1[::1])", cache=True, nogil=True)
def choose_vertices(
    points: NDArray[np.int64],
    turns: NDArray[np.uint8],
    offsets: NDArray[np.int64],
    fy: int,
    fx: int,
    epsilon2: int,
    stops: NDArray[np.uint8],
    linked: NDArray[np.uint8],
    at: NDArray[np.int64],
    is_vertex: NDArray[np.uint8],
) -> None:
    """Fill ``is_vertex``: the fewest edges between stops, and among those the ones nearest to the boundary.

    ``stops`` marks the points that must be vertices (at ``at``); from one with ``linked`` set, an edge that is
    kept leads to the next stop. A loop without a stop gets one, at an extreme turn. All other vertices are
    turns of the boundary.
    """
    longest = 0
    for loop in range(len(offsets) - 1):
        longest = max(longest, offsets[loop + 1] - offsets[loop])
    where = np.empty(longest + 2, np.int64)  # candidates of the gap: stop, turns between, stop
    py = np.empty(longest + 2, np.int64)  # the boundary there, in sixteenths
    px = np.empty(longest + 2, np.int64)
    vy = np.empty(longest + 2, np.int64)  # the vertex that would stand there
    vx = np.empty(longest + 2, np.int64)
    cost = np.empty(longest + 2, np.int64)
    error = np.empty(longest + 2, np.float64)
    previous = np.empty(longest + 2, np.int64)
    epsilon = np.sqrt(float(epsilon2))
    for loop in range(len(offsets) - 1):
        start, end = offsets[loop], offsets[loop + 1]
        size = end - start
        first = -1
        for m in range(start, end):
            if stops[m]:
                first = m
                break
        if first < 0:
            best = -(1 << 62)
            for m in range(start, end):
                value = 5 * points[m, 0] + 3 * points[m, 1]
                if turns[m] and value > best:
                    best, first = value, m
        m = first
        walked = 0
        while walked < size:
            # Collect the gap from this stop to the next one.
            is_vertex[m] = 1
            count = 0
            k = m
            while True:
                if k == m or turns[k] or stops[k]:
                    where[count] = k
                    py[count] = 16 * points[k, 0] + fy
                    px[count] = 16 * points[k, 1] + fx
                    vy[count] = 16 * points[k, 0]
                    vx[count] = 16 * points[k, 1]
                    count += 1
                k += 1
                walked += 1
                if k == end:
                    k = start
                if stops[k] or k == first:
                    break
            where[count] = k
            py[count] = 16 * points[k, 0] + fy
            px[count] = 16 * points[k, 1] + fx
            vy[count], vx[count] = 16 * at[k, 0], 16 * at[k, 1]
            vy[0], vx[0] = 16 * at[m, 0], 16 * at[m, 1]
            last = count
            origin = m
            m = k
            if linked[origin]:
                continue
            # The fewest edges, by dynamic programming over the candidates.
            for q in range(last + 1):
                cost[q] = 1 << 60
                error[q] = 0.0
                previous[q] = -1
            cost[0] = 0
            for i in range(last):
                if cost[i] == 1 << 60:
                    continue
                ay, ax = vy[i], vx[i]
                # The wedge, seen from a, of directions that pass all points so far within epsilon, and how far
                # the farthest of them is: an edge must reach that far, but for epsilon. In floats, since what
                # is chosen is tested exactly later (``find_uncertified``).
                wedge = False
                uy, ux, wy, wx = 0.0, 0.0, 0.0, 0.0
                syy, sxx, sxy = 0.0, 0.0, 0.0
                farthest = 0.0
                for j in range(i + 1, last + 1):
                    by, bx = float(vy[j] - ay), float(vx[j] - ax)
                    if abs(by) > 16 * 4096 or abs(bx) > 16 * 4096:
                        break
                    length2 = by * by + bx * bx
                    inside = length2 > 0 and np.sqrt(length2) + epsilon >= farthest
                    if inside and wedge and j > i + 1:
                        slack = 1e-9 * length2
                        inside = ux * by - uy * bx <= slack and wx * by - wy * bx >= -slack
                    if inside and cost[i] + 1 <= cost[j]:
                        off = (sxx * by * by - 2.0 * sxy * bx * by + syy * bx * bx) / length2
                        total = error[i] + max(off, 0.0)
                        if cost[i] + 1 < cost[j] or total < error[j]:
                            cost[j] = cost[i] + 1
                            error[j] = total
                            previous[j] = i
                    ry, rx = float(py[j] - ay), float(px[j] - ax)
                    syy += ry * ry
                    sxx += rx * rx
                    sxy += ry * rx
                    distance = np.sqrt(ry * ry + rx * rx)
                    farthest = max(farthest, distance)
                    if distance > epsilon:
                        sine = epsilon / distance
                        cosine = np.sqrt(1.0 - sine * sine)
                        hx, hy = rx * cosine - ry * sine, rx * sine + ry * cosine
                        lx, ly = rx * cosine + ry * sine, ry * cosine - rx * sine
                        if not wedge:
                            wedge = True
                            uy, ux, wy, wx = hy, hx, ly, lx
                        else:
                            if ux * hy - uy * hx < 0:
                                uy, ux = hy, hx
                            if wx * ly - wy * lx > 0:
                                wy, wx = ly, lx
                            if wx * uy - wy * ux < 0:
                                break
            q = previous[last]
            while q > 0:
                is_vertex[where[q]] = 1
                q = previous[q]


@njit("void(i8[:,::1], u1[::1], i8[::1], i8[::1], i8[::1], i8, i8, i8, i8[:,::1], u1[::1])", cache=True, nogil=True)
def find_uncertified(
    points: NDArray[np.int64],
    turns: NDArray[np.uint8],
    following: NDArray[np.int64],
    tails: NDArray[np.int64],
    heads: NDArray[np.int64],
    fy: int,
    fx: int,
    epsilon2: int,
    at: NDArray[np.int64],
    bad: NDArray[np.uint8],
) -> None:
    """Set ``bad`` for edges (from point tail to point head) whose certificate does not hold."""
    for k in range(len(tails)):
        m, end = tails[k], heads[k]
        ay, ax, by, bx = 16 * at[m, 0], 16 * at[m, 1], 16 * at[end, 0], 16 * at[end, 1]
        fits = (
            (ay != by or ax != bx)
            and is_near(16 * points[m, 0] + fy, 16 * points[m, 1] + fx, ay, ax, ay, ax, epsilon2)
            and is_near(16 * points[end, 0] + fy, 16 * points[end, 1] + fx, by, bx, by, bx, epsilon2)
        )
        while fits:
            m = following[m]
            if m == end:
                break
            if turns[m]:
                fits = is_near(16 * points[m, 0] + fy, 16 * points[m, 1] + fx, ay, ax, by, bx, epsilon2)
        if not fits:
            bad[k] = 1


@njit("i8(i8[:,::1], u1[::1], i8[::1], i8[::1], i8[::1], u1[::1], i8[:,::1], u1[::1])", cache=True, nogil=True)
def split_edges(
    points: NDArray[np.int64],
    turns: NDArray[np.uint8],
    following: NDArray[np.int64],
    tails: NDArray[np.int64],
    heads: NDArray[np.int64],
    bad: NDArray[np.uint8],
    at: NDArray[np.int64],
    is_vertex: NDArray[np.uint8],
) -> int:
    """Split each bad edge at the turn of its run that is farthest from it.

    Where the run has no turn left, the ends of the edge are put onto the boundary itself; returns how many
    ends were moved so.
    """
    moved = 0
    for k in range(len(tails)):
        if not bad[k]:
            continue
        a, b = tails[k], heads[k]
        dy, dx = at[b, 0] - at[a, 0], at[b, 1] - at[a, 1]
        best, where = -1, -1
        m = following[a]
        while m != b:
            if turns[m]:
                ry, rx = points[m, 0] - at[a, 0], points[m, 1] - at[a, 1]
                off = abs(dx * ry - dy * rx)
                if dy == 0 and dx == 0:
                    off = ry * ry + rx * rx
                if off > best:
                    best, where = off, m
            m = following[m]
        if where >= 0:
            is_vertex[where] = 1
            at[where, 0], at[where, 1] = points[where, 0], points[where, 1]
        else:
            for end in (a, b):
                if at[end, 0] != points[end, 0] or at[end, 1] != points[end, 1]:
                    at[end, 0], at[end, 1] = points[end, 0], points[end, 1]
                    moved += 1
    return moved
