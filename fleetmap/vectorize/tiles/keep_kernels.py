"""Kernels that find which old edges of a tile hold: where on the new boundary, and between which points.

A run is certified for an edge if its ends are within epsilon of those of the edge, and all corners between of the edge.
An old vertex has a *stand* on each stretch of boundary of its label that is within epsilon of it: the nearest point,
the first of equals. Any other point of the stretch would do as well, so that nobody need remember which one it was.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fleetmap.model.kernel import kernel
from fleetmap.model.kernel_types import Bytes, Ints, Points, Rows, Shorts
from fleetmap.vectorize.fewest_kernels import is_near
from fleetmap.vectorize.tiles.boundary_kernels import Boundary
from fleetmap.vectorize.tiles.nodes_kernels import Rules, distance2, is_at_border

TAIL_Y, TAIL_X, HEAD_Y, HEAD_X, LABEL, THICK = range(6)
"""Columns of edges; they are walked with the lesser state on their left."""

MOST_STANDS = 6
"""So many stretches are looked at for an old vertex, the nearest ones: a thin wall has two sides."""


class Steps(NamedTuple):
    """The boundary point by point, a unit apart.

    ``arc_of`` says which arc a point is of, ``turns`` whether it is a corner. ``first`` (size + 3, size + 3) is one of
    the points at each place of the lattice, from (-1, -1) on, ``next`` another one there, or -1.
    """

    points: Points
    offsets: Shorts
    arc_of: Shorts
    turns: Bytes
    first: Points
    next: Shorts


class Chain(NamedTuple):
    """Corners of arcs and the vertices among them, as ``simplify_arcs`` takes them.

    ``old`` is the edge that is kept from a corner on, or -1.
    """

    points: Points
    offsets: Shorts
    at: Points
    stops: Bytes
    kept: Bytes
    old: Shorts


@kernel
def spell_out(boundary: Boundary, size: int) -> Steps:
    """The boundary point by point."""
    count = 0
    arcs = len(boundary.labels)
    for arc in range(arcs):
        start, end = np.int64(boundary.offsets[arc]), np.int64(boundary.offsets[arc + 1])
        for m in range(start, end if boundary.closed[arc] else end - 1):
            n = m + 1 if m + 1 < end else start
            count += abs(boundary.points[n, 0] - boundary.points[m, 0])
            count += abs(boundary.points[n, 1] - boundary.points[m, 1])
        count += not boundary.closed[arc]
    points, offsets = np.empty((count, 2), np.int32), np.zeros(arcs + 1, np.int32)
    arc_of, turns = np.empty(count, np.int32), np.zeros(count, np.uint8)
    first, following = np.full((size + 3, size + 3), -1, np.int32), np.full(count, -1, np.int32)
    used = 0
    for arc in range(arcs):
        start, end = np.int64(boundary.offsets[arc]), np.int64(boundary.offsets[arc + 1])
        for m in range(start, end):
            y, x = np.int64(boundary.points[m, 0]), np.int64(boundary.points[m, 1])
            n = m + 1 if m + 1 < end else start
            turns[used] = 1
            last = m + 1 == end and not boundary.closed[arc]
            steps = 1 if last else max(abs(boundary.points[n, 0] - y), abs(boundary.points[n, 1] - x))
            dy, dx = np.sign(boundary.points[n, 0] - y), np.sign(boundary.points[n, 1] - x)
            for _ in range(steps):
                points[used, 0], points[used, 1], arc_of[used] = y, x, arc
                following[used] = first[y + 1, x + 1]
                first[y + 1, x + 1] = used
                used += 1
                y, x = y + dy, x + dx
        offsets[arc + 1] = used
    return Steps(points, offsets, arc_of, turns, first, following)


@kernel(inline="always")
def onward(boundary: Boundary, steps: Steps, m: int, by: int) -> int:
    """The next (by 1) or the last (-1) point of the arc; -1 beyond the ends of an open one."""
    arc = steps.arc_of[m]
    start, end = np.int64(steps.offsets[arc]), np.int64(steps.offsets[arc + 1])
    if start <= m + by < end:
        return m + by
    if not boundary.closed[arc]:
        return np.int64(-1)
    return start if by > 0 else end - 1


@kernel
def nearest_of_stretch(boundary: Boundary, steps: Steps, rules: Rules, m: int, y: int, x: int) -> int:
    """Of the points around m that are within epsilon of (y, x), one after the other: the nearest, the first of equals.

    The ends of an open arc are none of them.
    """
    start = m
    while True:
        before = onward(boundary, steps, start, -1)
        if before < 0 or before == m:
            break
        if onward(boundary, steps, before, -1) < 0:
            break
        if distance2(rules, steps.points[before, 0], steps.points[before, 1], y, x) > rules.epsilon2:
            break
        start = before
    if onward(boundary, steps, start, -1) == m:  # all of a loop: from its first point on
        start = np.int64(steps.offsets[steps.arc_of[m]])
    best, nearest = np.int64(1) << 60, m
    n = start
    while True:
        py, px = np.int64(steps.points[n, 0]), np.int64(steps.points[n, 1])
        if distance2(rules, py, px, y, x) > rules.epsilon2:
            break
        d = (py - y) * (py - y) + (px - x) * (px - x)
        if d < best:
            best, nearest = d, n
        n = onward(boundary, steps, n, 1)
        if n < 0 or n == start or onward(boundary, steps, n, 1) < 0:
            break
    return nearest


@kernel
def find_stands(
    boundary: Boundary, steps: Steps, places: Points, rules: Rules, end: Ints, is_head: bool, stands: Ints
) -> int:
    """Fill ``stands`` with points that an old vertex may stand for, the nearest first; returns how many.

    ``end``: its (y, x), and the label of its edge. Where it is the vertex of a node it stands for that alone.
    """
    y, x, label = end[0], end[1], end[2]
    size = len(steps.first) - 3
    found = 0
    reach = int(np.sqrt(float(rules.epsilon2))) // 16 + 1
    distances = np.empty(MOST_STANDS, np.int64)
    side = 2 if is_head else 0
    for py in range(max(y - reach, -1), min(y + reach, size + 1) + 1):
        for px in range(max(x - reach, -1), min(x + reach, size + 1) + 1):
            m = np.int64(steps.first[py + 1, px + 1])
            while m >= 0:
                arc = steps.arc_of[m]
                near = np.int64(-1)
                if boundary.labels[arc] == label:
                    last = onward(boundary, steps, m, 1) < 0
                    if last or onward(boundary, steps, m, -1) < 0:
                        own = last if is_head else not last
                        if own and places[arc, side] == y and places[arc, side + 1] == x:
                            near = m
                    elif distance2(rules, py, px, y, x) <= rules.epsilon2:
                        near = nearest_of_stretch(boundary, steps, rules, m, y, x)
                        if is_at_border(y, x, size) and (steps.points[near, 0] != y or steps.points[near, 1] != x):
                            near = np.int64(-1)
                if near == m:
                    d = (py - y) * (py - y) + (px - x) * (px - x)
                    k = min(found, MOST_STANDS - 1)
                    if found < MOST_STANDS or d < distances[k] or (d == distances[k] and m < stands[k]):
                        while k > 0 and (distances[k - 1] > d or (distances[k - 1] == d and stands[k - 1] > m)):
                            distances[k], stands[k] = distances[k - 1], stands[k - 1]
                            k -= 1
                        distances[k], stands[k] = d, m
                        found = min(found + 1, MOST_STANDS)
                m = np.int64(steps.next[m])
    return found


@kernel
def holds_between(boundary: Boundary, steps: Steps, rules: Rules, edge: Ints, a: int, b: int) -> bool:
    """Whether an edge is certified for the run from point a to point b of one arc."""
    ay, ax, by, bx = 16 * edge[0], 16 * edge[1], 16 * edge[2], 16 * edge[3]
    fy, fx = rules.phase_y, rules.phase_x
    points = steps.points
    if not is_near(16 * points[a, 0] + fy, 16 * points[a, 1] + fx, ay, ax, ay, ax, rules.epsilon2):
        return False
    if not is_near(16 * points[b, 0] + fy, 16 * points[b, 1] + fx, by, bx, by, bx, rules.epsilon2):
        return False
    m = a
    while True:
        m = onward(boundary, steps, m, 1)
        if m < 0:
            return False
        if m == b:
            return True
        if m == a:
            return False
        if steps.turns[m] and not is_near(
            16 * points[m, 0] + fy, 16 * points[m, 1] + fx, ay, ax, by, bx, rules.epsilon2
        ):
            return False


@kernel
def list_runs(boundary: Boundary, steps: Steps, places: Points, rules: Rules, old: Rows) -> Rows:
    """(k, 4) runs of boundary for which old edges hold: edge, first and last point, and how far the stands are off."""
    size = len(steps.first) - 3
    runs = np.empty((len(old) + 16, 4), np.int64)
    count = 0
    tails, heads = np.empty(MOST_STANDS, np.int64), np.empty(MOST_STANDS, np.int64)
    end = np.empty(3, np.int64)
    for e in range(len(old)):
        edge = old[e]
        # On a border that is another tile's no edge may lie.
        if (edge[TAIL_Y] == size and edge[HEAD_Y] == size) or (edge[TAIL_X] == size and edge[HEAD_X] == size):
            continue
        end[0], end[1], end[2] = edge[TAIL_Y], edge[TAIL_X], edge[LABEL]
        n_tails = find_stands(boundary, steps, places, rules, end, False, tails)
        end[0], end[1] = edge[HEAD_Y], edge[HEAD_X]
        n_heads = find_stands(boundary, steps, places, rules, end, True, heads)
        for i in range(n_tails):
            for j in range(n_heads):
                a, b = tails[i], heads[j]
                if steps.arc_of[a] != steps.arc_of[b] or not holds_between(boundary, steps, rules, edge, a, b):
                    continue
                if count == len(runs):
                    runs = np.concatenate((runs, runs))
                off = (steps.points[a, 0] - edge[TAIL_Y]) ** 2 + (steps.points[a, 1] - edge[TAIL_X]) ** 2
                off += (steps.points[b, 0] - edge[HEAD_Y]) ** 2 + (steps.points[b, 1] - edge[HEAD_X]) ** 2
                runs[count, 0], runs[count, 1], runs[count, 2], runs[count, 3] = e, a, b, off
                count += 1
    return runs[:count]


@kernel
def choose_runs(boundary: Boundary, steps: Steps, places: Points, old: Rows, runs: Rows) -> Chain:
    """Of the runs, those that are kept: no two of them overlap, and no vertex stands for two points of boundary.

    Those that other runs go on from at both ends come first, then those whose vertices lie nearest to their points.
    Gives the corners of the arcs with what is kept.
    """
    size = len(steps.first) - 3
    total = len(steps.points)
    arcs = len(boundary.labels)
    taken, old_of = np.zeros(total, np.uint8), np.full(total, -1, np.int32)
    stop, at = np.zeros(total, np.uint8), steps.points.copy()
    for arc in range(arcs):
        if not boundary.closed[arc]:
            for side in range(2):
                m = steps.offsets[arc + 1] - 1 if side else steps.offsets[arc]
                stop[m] = 1
                at[m, 0], at[m, 1] = places[arc, 2 * side], places[arc, 2 * side + 1]
    stands_at = np.full((size + 3, size + 3), -1, np.int32)  # the point, by its number in a row, of an old vertex
    is_kept = np.zeros(len(old), np.uint8)
    begins, ends = np.zeros(total, np.uint8), np.zeros(total, np.uint8)
    for arc in range(arcs):
        if not boundary.closed[arc]:
            ends[steps.offsets[arc]] = begins[steps.offsets[arc + 1] - 1] = 1
    for k in range(len(runs)):
        begins[runs[k, 1]] = ends[runs[k, 2]] = 1
    keys = np.empty(len(runs), np.int64)
    for k in range(len(runs)):
        loose = 2 - ends[runs[k, 1]] - begins[runs[k, 2]]
        keys[k] = ((np.int64(loose) << 20) + runs[k, 3]) * (len(runs) + 1) + k
    for k in np.argsort(keys):
        e, a, b = runs[k, 0], runs[k, 1], runs[k, 2]
        fits = not is_kept[e]
        for side in range(2):
            m = b if side else a
            y, x = old[e, 2 * side], old[e, 2 * side + 1]
            if stop[m] and (at[m, 0] != y or at[m, 1] != x):
                fits = False
            stand = stands_at[y + 1, x + 1]
            here = steps.points[m, 0] * (size + 3) + steps.points[m, 1]
            fits = fits and (stand < 0 or stand == here)
        m = a
        while fits and m != b:
            fits = not taken[m] and (m == a or not stop[m])
            m = onward(boundary, steps, m, 1)
        if not fits:
            continue
        is_kept[e] = 1
        for side in range(2):
            m = b if side else a
            y, x = old[e, 2 * side], old[e, 2 * side + 1]
            stop[m] = 1
            at[m, 0], at[m, 1] = y, x
            stands_at[y + 1, x + 1] = steps.points[m, 0] * (size + 3) + steps.points[m, 1]
        old_of[a] = e
        m = a
        while m != b:
            taken[m] = 1
            m = onward(boundary, steps, m, 1)
    # A point beside a node that lies off its own is one more corner: from there on the boundary itself will do.
    for arc in range(arcs):
        if boundary.closed[arc]:
            continue
        for side in range(2):
            m = np.int64(steps.offsets[arc + 1] - 1 if side else steps.offsets[arc])
            if at[m, 0] != steps.points[m, 0] or at[m, 1] != steps.points[m, 1]:
                n = onward(boundary, steps, m, -1 if side else 1)
                steps.turns[n] = 1
    room = 0
    for m in range(total):
        room += steps.turns[m] or stop[m]
    chain = Chain(
        np.empty((room, 2), np.int32),
        np.zeros(arcs + 1, np.int32),
        np.empty((room, 2), np.int32),
        np.empty(room, np.uint8),
        np.empty(room, np.uint8),
        np.empty(room, np.int32),
    )
    used = 0
    for arc in range(arcs):
        for m in range(steps.offsets[arc], steps.offsets[arc + 1]):
            if not (steps.turns[m] or stop[m]):
                continue
            chain.points[used] = steps.points[m]
            chain.at[used] = at[m]
            chain.stops[used] = stop[m]
            chain.kept[used] = old_of[m] >= 0
            chain.old[used] = old_of[m]
            used += 1
        chain.offsets[arc + 1] = used
    return chain


@kernel
def keep(boundary: Boundary, places: Points, rules: Rules, old: Rows, size: int) -> Chain:
    """The corners of a tile's boundary, with the old edges that still hold.

    Parameters
    ----------
    places : where the ends of the arcs lie, see ``place_nodes``
    old : (n, 6) the tile's old edges
    """
    steps = spell_out(boundary, size)
    runs = list_runs(boundary, steps, places, rules, old)
    return choose_runs(boundary, steps, places, old, runs)
