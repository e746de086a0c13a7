"""Numba kernels that turn traced arcs into a network of edges that holds everywhere."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fleetmap.vectorize.conflict_kernels import fill_buckets, find_conflicts, find_turned
from fleetmap.vectorize.fewest_kernels import is_near
from fleetmap.vectorize.jump_kernels import find_jumps
from fleetmap.vectorize.simplify_kernels import simplify_arcs

ROUNDS_OF_ONE = 4
"""So often only the longer edge of two that meet is split, which takes 10 % fewer edges; then both are, which ends
sooner."""


@njit("i8(i8, i8, i8, i8)", cache=True, nogil=True, inline="always")
def direction(ay: int, ax: int, by: int, bx: int) -> int:
    """The direction of an axis-parallel step from a to b."""
    return 0 if bx > ax else 2 if bx < ax else 1 if by > ay else 3


@njit(
    "i8(i4[:,::1], i4[::1], u1[::1], i8, i4[:,::1], u1[::1], i4[::1], i4[::1], i4[::1], i8[:,::1])",
    cache=True,
    nogil=True,
)
def list_edges(
    points: NDArray[np.int32],
    offsets: NDArray[np.int32],
    closed: NDArray[np.uint8],
    arcs: int,
    at: NDArray[np.int32],
    is_vertex: NDArray[np.uint8],
    tails: NDArray[np.int32],
    heads: NDArray[np.int32],
    arc_of: NDArray[np.int32],
    edges: NDArray[np.int64],
) -> int:
    """Fill the edges between consecutive vertices, as ``conflict_kernels`` has them; returns how many."""
    count = 0
    for arc in range(arcs):
        start, end = offsets[arc], offsets[arc + 1]
        first, last = -1, -1
        for m in range(start, end):
            if not is_vertex[m]:
                continue
            if first < 0:
                first = m
            else:
                tails[count], heads[count], arc_of[count] = last, m, arc
                count += 1
            last = m
        if closed[arc] and first >= 0:
            tails[count], heads[count], arc_of[count] = last, first, arc
            count += 1
    for k in range(count):
        a, b, arc = tails[k], heads[k], arc_of[k]
        edges[k, 0], edges[k, 1], edges[k, 2], edges[k, 3] = at[a, 0], at[a, 1], at[b, 0], at[b, 1]
        edges[k, 4], edges[k, 5], edges[k, 6], edges[k, 7] = points[a, 0], points[a, 1], points[b, 0], points[b, 1]
        after = a + 1 if a + 1 < offsets[arc + 1] else offsets[arc]
        before = b - 1 if b > offsets[arc] else offsets[arc + 1] - 1
        edges[k, 8] = direction(points[a, 0], points[a, 1], points[after, 0], points[after, 1]) + 4 * direction(
            points[before, 0], points[before, 1], points[b, 0], points[b, 1]
        )
    return count


@njit("i4[::1](i4[:,::1], i4[::1], u1[::1], i8)", cache=True, nogil=True)
def find_parts(
    points: NDArray[np.int32], offsets: NDArray[np.int32], closed: NDArray[np.uint8], arcs: int
) -> NDArray[np.int32]:
    """For each arc the number of an arc that stands for all those connected to it through nodes."""
    part = np.arange(arcs).astype(np.int32)
    ends = 0
    keys, owner = np.empty(2 * arcs, np.int64), np.empty(2 * arcs, np.int64)
    for arc in range(arcs):
        if closed[arc] or offsets[arc + 1] - offsets[arc] < 2:
            continue
        for m in (np.int64(offsets[arc]), np.int64(offsets[arc + 1] - 1)):
            keys[ends] = (np.int64(points[m, 0]) << 24) + points[m, 1]
            owner[ends] = arc
            ends += 1
    order = np.argsort(keys[:ends], kind="mergesort")
    for q in range(1, ends):
        if keys[order[q]] != keys[order[q - 1]]:
            continue
        a, b = owner[order[q - 1]], owner[order[q]]
        while part[a] != a:
            a = part[a]
        while part[b] != b:
            b = part[b]
        if a != b:
            part[max(a, b)] = min(a, b)
    for arc in range(arcs):
        a = part[arc]
        while part[a] != a:
            a = part[a]
        part[arc] = a
    return part


@njit("i8(i4[:,::1], i8, i8, i8)", cache=True, nogil=True)
def twice_area(points: NDArray[np.int32], start: int, end: int, closed: int) -> int:
    """Twice the area left of the corners of an arc, seen from the origin; if closed, that inside."""
    area = np.int64(0)
    for m in range(start, end if closed else end - 1):
        n = m + 1 if m + 1 < end else start
        area += np.int64(points[m, 1]) * points[n, 0] - np.int64(points[m, 0]) * points[n, 1]
    return area


@njit(
    "i8(i4[:,::1], i4[::1], u1[::1], i8, i8, i4[::1], i4[::1], i4[::1], i8[:,::1], u1[::1], u1[::1], u1[::1], u1[::1],"
    " u1[::1], i4[:,::1], u1[::1], i4[::1], u1[::1])",
    cache=True,
    nogil=True,
)
def split_edges(
    points: NDArray[np.int32],
    offsets: NDArray[np.int32],
    closed: NDArray[np.uint8],
    arcs: int,
    count: int,
    tails: NDArray[np.int32],
    heads: NDArray[np.int32],
    arc_of: NDArray[np.int32],
    edges: NDArray[np.int64],
    bad: NDArray[np.uint8],
    final: NDArray[np.uint8],
    fixed: NDArray[np.uint8],
    stops: NDArray[np.uint8],
    kept: NDArray[np.uint8],
    at: NDArray[np.int32],
    is_vertex: NDArray[np.uint8],
    tested: NDArray[np.int32],
    skip: NDArray[np.uint8],
) -> int:
    """Prepare another simplification: edges that aren't bad are kept, each bad one gets a stop where it is farthest.

    Where its run has no corner left, its ends are put onto the boundary. ``tested`` gets the heads of what stays,
    ``skip`` the arcs without a bad edge. Returns how many edges were bad, or -1 if one can't be helped: its ends are
    ``fixed`` off the boundary.
    """
    skip[:arcs] = 1
    splits = 0
    moved = False
    for k in range(count):
        a = tails[k]
        stops[a] = stops[heads[k]] = 1
        kept[a] = 1
        tested[a] = heads[k]
    for k in range(count):
        if not bad[k] or final[k]:
            continue
        splits += 1
        a, b, arc = tails[k], heads[k], arc_of[k]
        start, end = offsets[arc], offsets[arc + 1]
        skip[arc] = 0
        kept[a] = 0
        tested[a] = -1
        ay, ax, by, bx = edges[k, 0], edges[k, 1], edges[k, 2], edges[k, 3]
        best, where = -1, -1
        m = a
        while True:
            m += 1
            if m == end:
                m = start
            if m == b:
                break
            ry, rx = points[m, 0] - ay, points[m, 1] - ax
            off = abs((bx - ax) * ry - (by - ay) * rx)
            if ay == by and ax == bx:
                off = ry * ry + rx * rx
            if off > best:
                best, where = off, m
        if where >= 0:
            stops[where] = 1
            is_vertex[where] = 1
            at[where, 0], at[where, 1] = points[where, 0], points[where, 1]
        else:
            for m in (np.int64(a), np.int64(b)):
                if at[m, 0] == points[m, 0] and at[m, 1] == points[m, 1]:
                    continue
                if fixed[m]:
                    return -1
                at[m, 0], at[m, 1] = points[m, 0], points[m, 1]
                if closed[arc] or (m != start and m != end - 1):
                    continue
                # A node moves for all arcs that meet there.
                for other in range(arcs):
                    if closed[other] or offsets[other + 1] - offsets[other] < 2:
                        continue
                    for n in (np.int64(offsets[other]), np.int64(offsets[other + 1] - 1)):
                        if points[n, 0] == points[m, 0] and points[n, 1] == points[m, 1] and not fixed[n]:
                            at[n, 0], at[n, 1] = points[n, 0], points[n, 1]
            moved = True
    if moved:
        tested[:] = -1
    return splits


@njit(
    "Tuple((i8, i8))(u1[:,::1], i8, i8, i4[:,::1], i4[::1], u1[::1], u1[::1], u1[::1], i8, i8, i8, i8, u1[::1],"
    " u1[::1], u1[::1], i4[:,::1], u1[::1])",
    cache=True,
    nogil=True,
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
    fixed: NDArray[np.uint8],
    stops: NDArray[np.uint8],
    kept: NDArray[np.uint8],
    at: NDArray[np.int32],
    is_vertex: NDArray[np.uint8],
) -> tuple[int, int]:
    """Simplify arcs, then split edges until all hold, meet only at vertices and enclose what the boundary encloses.

    ``special`` marks corners with more than two cracks, the others are as in ``simplify_arcs``; ``stops``, ``kept``,
    ``at`` and ``is_vertex`` change. ``fixed`` marks ends of open arcs at vertices that are not to move, since other
    edges end there. Returns how many edges were split, or -1 if those vertices are in the way; and how many edges there
    were before.

    It ends: each round splits an edge or puts a vertex onto the boundary for good, and the boundary itself is as it
    should be.
    """
    size = offsets[arcs]
    skip = np.zeros(arcs, np.uint8)
    was_kept = kept.copy()
    simplify_arcs(cracks, oy, ox, points, offsets, closed, arcs, fy, fx, epsilon2, stops, kept, at, is_vertex, skip)
    part = find_parts(points, offsets, closed, arcs)
    # What is connected to vertices that don't move can't be turned over as a whole.
    anchored = np.zeros(arcs, np.uint8)
    for arc in range(arcs):
        if not closed[arc] and (fixed[offsets[arc]] or fixed[offsets[arc + 1] - 1]):
            anchored[part[arc]] = 1
    tails, heads, arc_of = np.empty(size, np.int32), np.empty(size, np.int32), np.empty(size, np.int32)
    edges = np.empty((size, 9), np.int64)
    tested = np.full(size, -1, np.int32)  # the head of the edge that leaves a corner and was tested already
    reach = int(np.sqrt(float(epsilon2))) // 16 + 1
    splits, before = 0, -1
    for attempt in range(1 << 30):
        count = list_edges(points, offsets, closed, arcs, at, is_vertex, tails, heads, arc_of, edges)
        if attempt == 0:
            before = count
        bad = np.zeros(count, np.uint8)
        rank = np.zeros(count, np.uint8)
        fresh, final, around = np.zeros(count, np.uint8), np.zeros(count, np.uint8), np.zeros(count, np.uint8)
        for k in range(count):
            a, b, arc = tails[k], heads[k], arc_of[k]
            start, end = offsets[arc], offsets[arc + 1]
            around[k] = special[a] + 2 * special[b]
            fresh[k] = tested[a] != b
            raw = (
                edges[k, 0] == edges[k, 4]
                and edges[k, 1] == edges[k, 5]
                and edges[k, 2] == edges[k, 6]
                and edges[k, 3] == edges[k, 7]
            )
            final[k] = raw and (b == a + 1 or (b == start and a == end - 1))
            if not fresh[k]:
                continue
            ay, ax, by, bx = 16 * edges[k, 0], 16 * edges[k, 1], 16 * edges[k, 2], 16 * edges[k, 3]
            ty, tx = 16 * edges[k, 4] + fy, 16 * edges[k, 5] + fx
            uy, ux = 16 * edges[k, 6] + fy, 16 * edges[k, 7] + fx
            sound = (
                (ay != by or ax != bx)
                and max(abs(by - ay), abs(bx - ax)) <= 16 * 4096
                and is_near(ty, tx, ay, ax, ay, ax, epsilon2)
                and is_near(uy, ux, by, bx, by, bx, epsilon2)
            )
            m = a
            while sound:
                m += 1
                if m == end:
                    m = start
                if m == b:
                    break
                sound = is_near(16 * points[m, 0] + fy, 16 * points[m, 1] + fx, ay, ax, by, bx, epsilon2)
            bad[k] = not sound
        starts, content, low_y, low_x, rows, columns = fill_buckets(edges[:count], 16)
        for k in range(count):
            # Of two in conflict what must stay stays, and else what was there before.
            rank[k] = 2 if final[k] else was_kept[tails[k]] & kept[tails[k]]
        find_conflicts(
            edges[:count], starts, content, rank, fresh,
            attempt >= ROUNDS_OF_ONE, bad,
        )  # fmt: skip
        clean = True
        for k in range(count):
            clean = clean and not bad[k]
        if clean:
            find_turned(edges[:count], around, bad)
            # What is not anchored may have been turned over, or inside out: compare the areas of its three states.
            true_areas, areas = np.zeros((arcs, 3), np.int64), np.zeros((arcs, 3), np.int64)
            complete = np.zeros(arcs, np.uint8)
            witnesses = np.empty(arcs, np.int32)
            found = 0
            k = 0
            for arc in range(arcs):
                p, left, right = part[arc], labels[arc] // 3, labels[arc] % 3
                # Where backs of walls are left out, only free space has all of its boundary.
                complete[p] |= closed[arc] or labels[arc] == 5
                area = twice_area(points, offsets[arc], offsets[arc + 1], closed[arc])
                true_areas[p, left] += area
                true_areas[p, right] -= area
                first = k
                own = np.int64(0)
                while k < count and arc_of[k] == arc:
                    own += edges[k, 1] * edges[k, 2] - edges[k, 0] * edges[k, 3]
                    k += 1
                areas[p, left] += own
                areas[p, right] -= own
                a, b = offsets[arc], offsets[arc + 1] - 1
                if fixed[a] and points[a, 0] == points[b, 0] and points[a, 1] == points[b, 1]:
                    # A loop through a single vertex outside.
                    if (area > 0) != (own > 0) or (area < 0) != (own < 0):
                        bad[first:k] = 1
                if k > first and p == arc:
                    witnesses[found] = first
                    found += 1
            for k in range(count):
                p = part[arc_of[k]]
                for state in range(0 if anchored[p] else 3 if complete[p] else 1):
                    if (areas[p, state] > 0) != (true_areas[p, state] > 0) or (areas[p, state] < 0) != (
                        true_areas[p, state] < 0
                    ):
                        bad[k] = 1
            find_jumps(
                points, offsets, tails, heads, arc_of, edges[:count], starts, content, low_y, low_x, rows, columns,
                16, part, witnesses[:found], reach, bad,
            )  # fmt: skip
        done = True
        for k in range(count):
            if bad[k] and not final[k]:
                done = False
        if done:
            return splits, before
        split = split_edges(
            points, offsets, closed, arcs, count, tails, heads, arc_of, edges, bad, final, fixed, stops, kept, at,
            is_vertex, tested, skip,
        )  # fmt: skip
        if split < 0:
            return -1, before
        splits += split
        simplify_arcs(cracks, oy, ox, points, offsets, closed, arcs, fy, fx, epsilon2, stops, kept, at, is_vertex, skip)
    return splits, before
