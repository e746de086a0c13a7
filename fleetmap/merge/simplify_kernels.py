"""Integer kernels of the simplification: chains, and how far a chord may reach along one.

Why int64 suffices: a chord spans at most 2^16 along each axis (2^17 if it is a piece as it was), ``slack`` is at
most 2^13, and points are only compared with chords whose box, grown by the slack, holds them: products stay below
2^36, and ``within`` states its own bounds.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.merge.place import MAX_LENGTH
from fleetmap.merge.select_kernels import within
from fleetmap.model.kernel import kernel

Ints = NDArray[np.int64]


@kernel(
    "Tuple((int64[::1], int64[::1], int64[::1]))(int64[::1], int64[::1], int64[::1], int64[::1], int64)",
)
def chains(v0: Ints, v1: Ints, kind: Ints, turned: Ints, n_vertices: int) -> tuple[Ints, Ints, Ints]:
    """Maximal chains of edges of one kind through vertices of degree 2.

    ``kind``: what edge v0 -> v1 is as seen along it; ``turned``: as seen against it. Returns the vertices of
    all chains, their offsets, and the edge behind each step (one fewer per chain than vertices). Open chains
    come first, in the order of their least end; closed ones follow, from their least vertex.
    """
    n = len(v0)
    first = np.zeros(n_vertices + 1, np.int64)
    for i in range(n):
        first[v0[i] + 1] += 1
        first[v1[i] + 1] += 1
    for v in range(n_vertices):
        first[v + 1] += first[v]
    incident = np.empty(2 * n, np.int64)
    fill = first[:n_vertices].copy()
    for i in range(n):
        incident[fill[v0[i]]] = i
        fill[v0[i]] += 1
        incident[fill[v1[i]]] = i
        fill[v1[i]] += 1
    ends_chain = np.ones(n_vertices, np.bool_)
    for v in range(n_vertices):
        if first[v + 1] - first[v] == 2:
            i, j = incident[first[v]], incident[first[v] + 1]
            # Arriving by one edge must look like leaving by the other.
            arriving = turned[i] if v0[i] == v else kind[i]
            leaving = kind[j] if v0[j] == v else turned[j]
            ends_chain[v] = arriving != leaving

    used = np.zeros(n, np.bool_)
    points = np.empty(2 * n, np.int64)
    steps = np.empty(n, np.int64)
    offsets = np.zeros(n + 1, np.int64)
    n_points, n_steps, n_chains = 0, 0, 0
    for closed in range(2):
        for s in range(n_vertices):
            if (not ends_chain[s]) != (closed == 1):
                continue
            for k in range(first[s], first[s + 1]):
                i = incident[k]
                if used[i]:
                    continue
                points[n_points] = s
                n_points += 1
                v = s
                while True:
                    used[i] = True
                    steps[n_steps] = i
                    n_steps += 1
                    v = v1[i] if v0[i] == v else v0[i]
                    points[n_points] = v
                    n_points += 1
                    if v == s or ends_chain[v]:
                        break
                    a, b = incident[first[v]], incident[first[v] + 1]
                    i = b if a == i else a
                n_chains += 1
                offsets[n_chains] = n_points
    return points[:n_points].copy(), offsets[: n_chains + 1].copy(), steps[:n_steps].copy()


@kernel("boolean(int64[:, ::1], int64[::1], int64, int64, int64)")
def chord_fits(at: Ints, chain: Ints, i: int, j: int, slack: int) -> bool:
    """Whether the chord from vertex i to j of a chain may stand for the edges between them.

    All vertices passed lie within ``slack`` of it, and no other vertex of the map lies on it or between it and
    the chain. The second makes all chords of a map compatible, in whatever order they are chosen: an edge that
    crossed the chord would have to end between chord and chain, so nothing is there; two chords cross at most
    once, yet the closed curves that they make with their chains, which don't cross, cross evenly often.
    """
    ay, ax, by, bx = at[chain[i], 0], at[chain[i], 1], at[chain[j], 0], at[chain[j], 1]
    if abs(by - ay) > MAX_LENGTH or abs(bx - ax) > MAX_LENGTH:
        return False
    y_low, y_high, x_low, x_high = min(ay, by), max(ay, by), min(ax, bx), max(ax, bx)
    for k in range(i + 1, j):
        py, px = at[chain[k], 0], at[chain[k], 1]
        if not within(py, px, ay, ax, by, bx, slack):
            return False
        y_low, y_high, x_low, x_high = min(y_low, py), max(y_high, py), min(x_low, px), max(x_high, px)

    low, high = 0, len(at)
    while low < high:  # the first vertex of row y_low; vertices ascend
        middle = (low + high) // 2
        if at[middle, 0] < y_low:
            low = middle + 1
        else:
            high = middle
    for v in range(low, len(at)):
        py, px = at[v, 0], at[v, 1]
        if py > y_high:
            break
        if px < x_low or px > x_high:
            continue
        own = False
        for k in range(i, j + 1):
            if chain[k] == v:
                own = True
                break
        if own:
            continue
        if (bx - ax) * (py - ay) == (by - ay) * (px - ax) and within(py, px, ay, ax, by, bx, 0):
            return False
        inside = False
        cy, cx = by, bx
        for k in range(i, j + 1):
            ey, ex = at[chain[k], 0], at[chain[k], 1]
            if (cy <= py) != (ey <= py):
                side = (ex - cx) * (py - cy) - (ey - cy) * (px - cx)
                if (side > 0) == (ey > cy):
                    inside = not inside
            cy, cx = ey, ex
        if inside:
            return False
    return True


@kernel(
    "int64[::1](int64[:, ::1], int64[::1], int64[::1], int64[::1], boolean[::1], int64, int64)",
)
def simplify_chains(
    at: Ints, points: Ints, offsets: Ints, depth: Ints, anchor: NDArray[np.bool_], slack: int, depth_slack: int
) -> Ints:
    """Positions in ``points`` that stay: the ends of each chain, its anchors, and greedily the farthest between.

    ``depth``: thickness of each step, at the position where the step starts; a chord doesn't span thicknesses
    more than ``depth_slack`` apart.
    """
    keep = np.empty(len(points), np.int64)
    n = 0
    for c in range(len(offsets) - 1):
        i, last = offsets[c], offsets[c + 1] - 1
        keep[n] = i
        n += 1
        while i < last:
            best = i + 1
            thin, thick = depth[i], depth[i]
            for j in range(i + 2, last + 1):
                if anchor[j - 1]:
                    break
                thin, thick = min(thin, depth[j - 1]), max(thick, depth[j - 1])
                if thick - thin > depth_slack or not chord_fits(at, points, i, j, slack):
                    break
                best = j
            i = best
            keep[n] = i
            n += 1
    return keep[:n].copy()
