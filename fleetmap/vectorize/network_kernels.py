"""Numba kernels that turn traced arcs into a network of edges that holds everywhere."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.kernel import kernel
from fleetmap.vectorize.conflict_kernels import BUCKET, find_turned, link_and_test, list_crossings
from fleetmap.vectorize.edge_kernels import EDGE_COLUMNS, list_edges, list_run
from fleetmap.vectorize.fewest_kernels import GAP_ROWS, LONGEST_EDGE_CELLS, is_near
from fleetmap.vectorize.jump_kernels import find_jumps
from fleetmap.vectorize.simplify_kernels import simplify_arcs, simplify_gap

ROUNDS_OF_ONE = 4
"""So often only the longer edge of two that meet is split, which takes 10 % fewer edges; then both are, which ends
sooner."""


@kernel("i4[::1](i4[:,::1], i4[::1], u1[::1], i8, i4[:,::1])")
def find_parts(
    points: NDArray[np.int32],
    offsets: NDArray[np.int32],
    closed: NDArray[np.uint8],
    arcs: int,
    at: NDArray[np.int32],
) -> NDArray[np.int32]:
    """For each arc the number of an arc that stands for all those connected to it through common ends.

    Where boundaries only touch, at a corner, each has a vertex of its own for that point, in a place of its own.
    """
    part = np.arange(arcs).astype(np.int32)
    ends = 0
    keys, owner, corner = np.empty(2 * arcs, np.int64), np.empty(2 * arcs, np.int64), np.empty(2 * arcs, np.int64)
    for arc in range(arcs):
        if closed[arc] or offsets[arc + 1] - offsets[arc] < 2:
            continue
        for m in (np.int64(offsets[arc]), np.int64(offsets[arc + 1] - 1)):
            keys[ends] = (np.int64(points[m, 0]) << 24) + points[m, 1]
            owner[ends], corner[ends] = arc, m
            ends += 1
    order = np.argsort(keys[:ends], kind="mergesort")
    for q in range(1, ends):
        r = q - 1
        while r >= 0 and keys[order[r]] == keys[order[q]]:
            m, n = corner[order[q]], corner[order[r]]
            if at[m, 0] == at[n, 0] and at[m, 1] == at[n, 1]:
                a, b = owner[order[r]], owner[order[q]]
                while part[a] != a:
                    a = part[a]
                while part[b] != b:
                    b = part[b]
                if a != b:
                    part[max(a, b)] = min(a, b)
            r -= 1
    for arc in range(arcs):
        a = part[arc]
        while part[a] != a:
            a = part[a]
        part[arc] = a
    return part


@kernel("i8(i4[:,::1], i8, i8, i8)")
def twice_area(points: NDArray[np.int32], start: int, end: int, closed: int) -> int:
    """Twice the area left of the corners of an arc, seen from the origin; if closed, that inside."""
    area = np.int64(0)
    for m in range(start, end if closed else end - 1):
        n = m + 1 if m + 1 < end else start
        area += np.int64(points[m, 1]) * points[n, 0] - np.int64(points[m, 0]) * points[n, 1]
    return area


@kernel("b1(i4[:,::1], i8, i8, i8, i8, i8[:,::1], i8, i8, i8, i8)")
def is_certified(
    points: NDArray[np.int32],
    start: int,
    end: int,
    tail: int,
    head: int,
    edges: NDArray[np.int64],
    k: int,
    fy: int,
    fx: int,
    epsilon2: int,
) -> bool:
    """Whether edge k holds for its run of an arc that has the corners ``start`` to ``end``; see ``fewest_kernels``."""
    ay, ax, by, bx = 16 * edges[k, 0], 16 * edges[k, 1], 16 * edges[k, 2], 16 * edges[k, 3]
    if (
        (ay == by and ax == bx)
        or max(abs(by - ay), abs(bx - ax)) > 16 * LONGEST_EDGE_CELLS
        or not is_near(16 * edges[k, 4] + fy, 16 * edges[k, 5] + fx, ay, ax, ay, ax, epsilon2)
        or not is_near(16 * edges[k, 6] + fy, 16 * edges[k, 7] + fx, by, bx, by, bx, epsilon2)
    ):
        return False
    m = tail
    while True:
        m = m + 1 if m + 1 < end else start
        if m == head:
            return True
        if not is_near(16 * points[m, 0] + fy, 16 * points[m, 1] + fx, ay, ax, by, bx, epsilon2):
            return False


@kernel("i8(i4[:,::1], i8, i8, i8, i8, i8[:,::1], i8)")
def farthest_corner(
    points: NDArray[np.int32], start: int, end: int, tail: int, head: int, edges: NDArray[np.int64], k: int
) -> int:
    """The corner between the ends of edge k that is farthest from its line, or -1 if there is none."""
    ay, ax, by, bx = edges[k, 0], edges[k, 1], edges[k, 2], edges[k, 3]
    best, where = np.int64(-1), np.int64(-1)
    m = tail
    while True:
        m = m + 1 if m + 1 < end else start
        if m == head:
            return where
        ry, rx = points[m, 0] - ay, points[m, 1] - ax
        off = abs((bx - ax) * ry - (by - ay) * rx) if (ay != by or ax != bx) else ry * ry + rx * rx
        if off > best:
            best, where = off, m


@kernel(
    "void(i4[:,::1], i4[::1], u1[::1], u1[::1], i8, i8, i4[::1], i8[:,::1], u1[::1], u1[::1], i4[::1], u1[::1],"
    " u1[::1])",
)
def find_overturned(
    points: NDArray[np.int32],
    offsets: NDArray[np.int32],
    closed: NDArray[np.uint8],
    labels: NDArray[np.uint8],
    arcs: int,
    count: int,
    arc_of: NDArray[np.int32],
    edges: NDArray[np.int64],
    alive: NDArray[np.uint8],
    fixed: NDArray[np.uint8],
    part: NDArray[np.int32],
    anchored: NDArray[np.uint8],
    bad: NDArray[np.uint8],
) -> None:
    """Set ``bad`` for all edges of a part that was turned over, or inside out: a state's area has the other sign.

    Parts ``anchored`` to vertices that don't move can't be, but for loops through a single one.
    """
    true_areas, areas = np.zeros((arcs, 3), np.int64), np.zeros((arcs, 3), np.int64)
    own = np.zeros(arcs, np.int64)
    complete, over = np.zeros(arcs, np.uint8), np.zeros(arcs, np.uint8)
    for k in range(count):
        if alive[k]:
            own[arc_of[k]] += edges[k, 1] * edges[k, 2] - edges[k, 0] * edges[k, 3]
    for arc in range(arcs):
        p, left, right = part[arc], labels[arc] // 3, labels[arc] % 3
        # Where backs of walls are left out, only free space has all of its boundary.
        complete[p] |= closed[arc] or labels[arc] == 5
        true_area, area = twice_area(points, offsets[arc], offsets[arc + 1], closed[arc]), own[arc]
        true_areas[p, left] += true_area
        true_areas[p, right] -= true_area
        areas[p, left] += area
        areas[p, right] -= area
        a, b = offsets[arc], offsets[arc + 1] - 1
        is_loop = fixed[a] and points[a, 0] == points[b, 0] and points[a, 1] == points[b, 1]
        over[arc] = is_loop and ((true_area > 0) != (area > 0) or (true_area < 0) != (area < 0))
    for p in range(arcs):
        for state in range(0 if anchored[p] or part[p] != p else 3 if complete[p] else 1):
            over[p] |= (areas[p, state] > 0) != (true_areas[p, state] > 0) or (areas[p, state] < 0) != (
                true_areas[p, state] < 0
            )
    for k in range(count):
        arc = arc_of[k]
        if alive[k] and (over[arc] or (over[part[arc]] and not anchored[part[arc]])):
            bad[k] = 1


@kernel(
    "Tuple((i8, i8))(u1[:,::1], i8, i8, i4[:,::1], i4[::1], u1[::1], u1[::1], u1[::1], i8, i8, i8, i8, i8, u1[::1],"
    " u1[::1], u1[::1], i4[:,::1], u1[::1])",
)
def build_network(
    cracks: NDArray[np.uint8],
    oy: int,
    ox: int,
    points: NDArray[np.int32],
    offsets: NDArray[np.int32],
    closed: NDArray[np.uint8],
    labels: NDArray[np.uint8],
    special: NDArray[np.uint8],
    arcs: int,
    fy: int,
    fx: int,
    epsilon2: int,
    choose2: int,
    fixed: NDArray[np.uint8],
    stops: NDArray[np.uint8],
    kept: NDArray[np.uint8],
    at: NDArray[np.int32],
    is_vertex: NDArray[np.uint8],
) -> tuple[int, int]:
    """Simplify arcs, then split edges until all hold, meet only at vertices and enclose what the boundary encloses.

    New edges are chosen within ``choose2``, at most ``epsilon2``, which all must hold. ``special`` marks corners with
    more than two cracks, the others are as in ``simplify_arcs``; ``at`` and ``is_vertex`` change. ``fixed`` marks ends
    of open arcs at vertices that are not to move, since other edges end there. Returns how many edges were split, or -1
    if those vertices are in the way; and how many edges there were before.

    It ends: each round splits an edge or puts a vertex onto the boundary for good, and the boundary itself is as it
    should be. A round looks only at the edges that are new.
    """
    size = offsets[arcs]
    simplify_arcs(cracks, oy, ox, points, offsets, closed, arcs, fy, fx, choose2, stops, kept, at, is_vertex)
    part = find_parts(points, offsets, closed, arcs, at)
    crossings = list_crossings(points, offsets, special, arcs)
    # What is connected to vertices that don't move can't be turned over as a whole.
    anchored = np.zeros(arcs, np.uint8)
    longest = 0
    for arc in range(arcs):
        longest = max(longest, offsets[arc + 1] - offsets[arc])
        if not closed[arc] and (fixed[offsets[arc]] or fixed[offsets[arc + 1] - 1]):
            anchored[part[arc]] = 1
    reach = int(np.sqrt(float(epsilon2))) // 16 + 1
    low_y, low_x, high_y, high_x = 1 << 40, 1 << 40, -(1 << 40), -(1 << 40)
    for m in range(size):
        y, x = min(points[m, 0], at[m, 0]), min(points[m, 1], at[m, 1])
        low_y, low_x = min(low_y, y), min(low_x, x)
        y, x = max(points[m, 0], at[m, 0]), max(points[m, 1], at[m, 1])
        high_y, high_x = max(high_y, y), max(high_x, x)
    if size == 0:
        return 0, 0
    low_y, low_x = low_y - reach, low_x - reach
    shape = ((high_y + reach - low_y) // BUCKET + 1, (high_x + reach - low_x) // BUCKET + 1)

    # Edges are added at the end; those that were split stay, no more alive.
    room = 3 * size + 16
    tails, heads, arc_of = np.empty(room, np.int32), np.empty(room, np.int32), np.empty(room, np.int32)
    edges = np.empty((room, EDGE_COLUMNS), np.int64)
    alive, rank, bad = np.zeros(room, np.uint8), np.zeros(room, np.uint8), np.zeros(room, np.uint8)
    final = np.zeros(room, np.uint8)
    edge_from, edge_into = np.full(size, -1, np.int32), np.full(size, -1, np.int32)
    was_kept = kept.copy()
    gap, error = np.empty((GAP_ROWS, longest + 2), np.int64), np.empty(longest + 2, np.float64)
    moments, wedges = np.empty((longest + 2, 6), np.float64), np.empty((longest + 2, 6), np.float64)
    epsilon = np.sqrt(float(choose2)) / 16.0
    count, new, splits, before = 0, 0, 0, -1
    buckets, links, used = np.empty(shape, np.int32), np.empty((2 * size + 16, 2), np.int32), 0
    for attempt in range(1 << 30):
        if before < 0 or count > 2 * size:
            # All anew: the first time, and, hardly ever, when room runs out.
            count = list_edges(points, offsets, closed, arcs, at, is_vertex, tails, heads, arc_of, edges)
            before = count if before < 0 else before
            new, used = 0, 0
            buckets[:] = -1
        for k in range(new, count):
            a, b, arc = tails[k], heads[k], arc_of[k]
            start, end = offsets[arc], offsets[arc + 1]
            alive[k], bad[k] = 1, 0
            edge_from[a], edge_into[b] = k, k
            raw = (
                edges[k, 0] == edges[k, 4]
                and edges[k, 1] == edges[k, 5]
                and edges[k, 2] == edges[k, 6]
                and edges[k, 3] == edges[k, 7]
            )
            final[k] = raw and (b == a + 1 or (b == start and a == end - 1))
            # Of two in conflict what must stay stays, and else what was there before.
            rank[k] = 2 if final[k] else was_kept[a]
        clean = True
        for k in range(new, count):
            if not final[k] and not is_certified(
                points, offsets[arc_of[k]], offsets[arc_of[k] + 1], tails[k], heads[k], edges, k, fy, fx, epsilon2
            ):
                bad[k] = 1
            used, links = link_and_test(
                edges, k, alive, rank, low_y, low_x, buckets, used, links, attempt >= ROUNDS_OF_ONE, bad
            )
        for k in range(count):
            clean = clean and not (bad[k] and alive[k] and not final[k])
        if clean:
            find_turned(edges, points, crossings, edge_from, edge_into, bad)
            find_overturned(
                points, offsets, closed, labels, arcs, count, arc_of, edges, alive, fixed, part, anchored, bad
            )
            witnesses = np.empty(arcs, np.int32)
            found = 0
            for arc in range(arcs):
                m = offsets[arc]
                while part[arc] == arc and m < offsets[arc + 1]:
                    if edge_from[m] >= 0:
                        witnesses[found] = edge_from[m]
                        found += 1
                        break
                    m += 1
            find_jumps(
                points, offsets, tails, heads, arc_of, edges, alive, low_y, low_x, buckets, links, part,
                witnesses[:found], reach, bad,
            )  # fmt: skip
        # Each bad edge gets a vertex where it is farthest, or, without a corner left, its ends go onto the boundary.
        last = count
        runs = np.empty((last + 16, 3), np.int32)
        gone = 0
        for k in range(last):
            if not bad[k] or not alive[k] or final[k]:
                bad[k] = 0
                continue
            splits += 1
            a, b, arc = np.int64(tails[k]), np.int64(heads[k]), np.int64(arc_of[k])
            was_kept[a] = 0
            if farthest_corner(points, offsets[arc], offsets[arc + 1], a, b, edges, k) >= 0:
                continue
            bad[k] = 0
            for m in (a, b):
                y, x = points[m, 0], points[m, 1]
                if at[m, 0] == y and at[m, 1] == x:
                    continue
                if fixed[m]:
                    return -1, before
                is_end = not closed[arc] and (m == offsets[arc] or m == offsets[arc + 1] - 1)
                # A node moves for all arcs that meet there.
                for other in range(arcs if is_end else 1):
                    for side in range(2 if is_end else 1):
                        n = m
                        if is_end:
                            if closed[other] or offsets[other + 1] - offsets[other] < 2:
                                continue
                            n = np.int64(offsets[other + 1] - 1 if side else offsets[other])
                            if points[n, 0] != y or points[n, 1] != x or fixed[n]:
                                continue
                        at[n, 0], at[n, 1] = y, x
                        for e in (edge_from[n], edge_into[n]):
                            if e >= 0 and alive[e]:
                                alive[e] = 0
                                if gone == len(runs):
                                    runs = np.concatenate((runs, runs))
                                runs[gone, 0], runs[gone, 1], runs[gone, 2] = arc_of[e], tails[e], heads[e]
                                gone += 1
        for k in range(last):
            if not bad[k]:
                continue
            bad[k] = 0
            a, b, arc = np.int64(tails[k]), np.int64(heads[k]), np.int64(arc_of[k])
            start, end = np.int64(offsets[arc]), np.int64(offsets[arc + 1])
            m = farthest_corner(points, start, end, a, b, edges, k)
            is_vertex[m] = 1
            at[m, 0], at[m, 1] = points[m, 0], points[m, 1]
            for first, second in ((a, m), (m, b)):
                simplify_gap(
                    cracks, oy, ox, points, start, end, first, second, fy, fx, choose2, epsilon, at, is_vertex, gap,
                    error, moments, wedges,
                )  # fmt: skip
            if alive[k]:
                alive[k] = 0
                if gone == len(runs):
                    runs = np.concatenate((runs, runs))
                runs[gone, 0], runs[gone, 1], runs[gone, 2] = arc, a, b
                gone += 1
        if gone == 0:
            return splits, before
        new = count
        for q in range(gone):
            count = list_run(
                points, offsets, at, is_vertex, runs[q, 0], runs[q, 1], runs[q, 2], count, tails, heads, arc_of, edges
            )
    return splits, before
