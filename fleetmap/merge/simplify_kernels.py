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
from fleetmap.merge.tile_kernels import columns_in_row, first_from, tile_key
from fleetmap.merge.tiles import SHIFT
from fleetmap.model.kernel import kernel

Ints = NDArray[np.int64]

MOST_PASSED = 32
"""Edges that one chord may stand for: of a straight wall of n pieces every chord is looked at from all its pieces."""


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


@kernel(
    "boolean(int64[:, ::1], int64[::1], int64, int64, int64, int64[::1], int64[::1], int64[::1], int64[::1],"
    " int64[::1], int64)",
)
def chord_fits(
    at: Ints,
    chain: Ints,
    i: int,
    j: int,
    slack: int,
    keys: Ints,
    start: Ints,
    items: Ints,
    chain_of: Ints,
    place: Ints,
    c: int,
) -> bool:
    """Whether the chord from vertex i to j of chain c may stand for the edges between them.

    All vertices passed lie within ``slack`` of it, and no other vertex of the map lies on it or between it and
    the chain. The second makes all chords of a map compatible, in whatever order they are chosen: an edge that
    crossed the chord would have to end between chord and chain, so nothing is there; two chords cross at most
    once, yet the closed curves that they make with their chains, which don't cross, cross evenly often.

    What lies between them lies within ``slack`` of the chord, for that is a convex set. ``keys``, ``start``, ``items``:
    ``Tiles`` of the vertices; ``chain_of``, ``place``: to which chain a vertex inside of one belongs, and where in
    ``chain`` it is.
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

    low_y, low_x, high_y, high_x = (ay, ax, by, bx) if ay <= by else (by, bx, ay, ax)
    for row in range((low_y - slack - 1) >> SHIFT, ((high_y + slack + 1) >> SHIFT) + 1):
        left, right = columns_in_row(low_y, low_x, high_y, high_x, row, slack + 1, SHIFT)
        t, beyond = first_from(keys, tile_key(0, row, left)), tile_key(0, row, right)
        while t < len(keys) and keys[t] <= beyond:
            for w in range(start[t], start[t + 1]):
                v = items[w]
                py, px = at[v, 0], at[v, 1]
                if py < y_low or py > y_high or px < x_low or px > x_high:
                    continue
                if v == chain[i] or v == chain[j] or (chain_of[v] == c and i < place[v] and place[v] < j):
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
            t += 1
    return True


@kernel(
    "int64[::1](int64[:, ::1], int64[::1], int64[::1], int64[::1], boolean[::1], int64, int64, int64[::1], int64[::1],"
    " int64[::1])",
)
def simplify_chains(
    at: Ints,
    points: Ints,
    offsets: Ints,
    depth: Ints,
    anchor: NDArray[np.bool_],
    slack: int,
    depth_slack: int,
    keys: Ints,
    start: Ints,
    items: Ints,
) -> Ints:
    """Positions in ``points`` that stay: the ends of each chain, its anchors, and greedily the farthest between.

    ``depth``: thickness of each step, at the position where the step starts; a chord doesn't span thicknesses
    more than ``depth_slack`` apart, nor more than ``MOST_PASSED`` steps. ``keys``, ``start``, ``items``: ``Tiles`` of
    the vertices.
    """
    keep = np.empty(len(points), np.int64)
    chain_of = np.full(len(at), -1)
    place = np.empty(len(at), np.int64)
    n = 0
    for c in range(len(offsets) - 1):
        i, last = offsets[c], offsets[c + 1] - 1
        for k in range(i + 1, last):
            chain_of[points[k]], place[points[k]] = c, k
        keep[n] = i
        n += 1
        while i < last:
            best = i + 1
            thin, thick = depth[i], depth[i]
            for j in range(i + 2, min(last, i + MOST_PASSED) + 1):
                if anchor[j - 1]:
                    break
                thin, thick = min(thin, depth[j - 1]), max(thick, depth[j - 1])
                if thick - thin > depth_slack:
                    break
                if not chord_fits(at, points, i, j, slack, keys, start, items, chain_of, place, c):
                    break
                best = j
            i = best
            keep[n] = i
            n += 1
    return keep[:n].copy()


@kernel("int64[::1](int64[:, ::1], int64[::1], int64[:, ::1])")
def farthest(at: Ints, points: Ints, spans: Ints) -> Ints:
    """Of each span (i, j) of a chain, j - i >= 2, the first position between that is farthest from i and j.

    From the line through both; where they are one vertex, from that.
    """
    out = np.empty(len(spans), np.int64)
    for s in range(len(spans)):
        i, j = spans[s, 0], spans[s, 1]
        ay, ax = at[points[i], 0], at[points[i], 1]
        dy, dx = at[points[j], 0] - ay, at[points[j], 1] - ax
        best, out[s] = -1, i + 1
        for k in range(i + 1, j):
            qy, qx = at[points[k], 0] - ay, at[points[k], 1] - ax
            distance = qy * qy + qx * qx if points[i] == points[j] else abs(dx * qy - dy * qx)
            if distance > best:
                best, out[s] = distance, k
    return out
