"""Numba kernels that find which stored edges still hold against the boundary as it is now."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.kernel import kernel
from fleetmap.vectorize.fewest_kernels import is_near
from fleetmap.vectorize.index_kernels import AT_X, AT_Y, IN, LABEL, NEXT, OUT, POINT_X, POINT_Y

PLACES = 4
"""At most so many places of the boundary are considered for one old vertex (a thin wall has two sides)."""


@kernel("i8(i8, i8, i8, i8, i8)", inline="always")
def after(m: int, step: int, start: int, end: int, closed: int) -> int:
    """The next (step 1) or last (-1) point of an arc's points start to end; -1 beyond the ends of an open one."""
    m += step
    if start <= m < end:
        return m
    if not closed:
        return -1
    return start if m == end else end - 1


@kernel(
    "void(i4[:,::1], i4[::1], i4[::1], i8, i4[:,::1], u1[::1], i4[::1], u1[::1], u1[::1], i4[::1], i4[::1], i8,"
    " i4[::1], i8, i8, i8, i8, i8, i8, i8, i4[:,::1], i4[::1], i4[::1])",
)
def keep_edges(
    records: NDArray[np.int32],
    local: NDArray[np.int32],
    touched: NDArray[np.int32],
    touched_count: int,
    units: NDArray[np.int32],
    leaves: NDArray[np.uint8],
    offsets: NDArray[np.int32],
    labels: NDArray[np.uint8],
    closed: NDArray[np.uint8],
    first: NDArray[np.int32],
    last: NDArray[np.int32],
    arcs: int,
    arc_of: NDArray[np.int32],
    fy: int,
    fx: int,
    epsilon2: int,
    low_y: int,
    low_x: int,
    height: int,
    width: int,
    at: NDArray[np.int32],
    old_edge: NDArray[np.int32],
    ends: NDArray[np.int32],
) -> None:
    """Find the runs of the new boundary on which old edges hold their certificate.

    1. Vertices outside of the window stay. A node takes the place of an old one that stood for its point, else of
       the nearest within epsilon that no other node has.
    2. Each old vertex gets its places: a stretch of boundary within epsilon of it gives one. That is the passage that
       it stood for, if it is still there; else the nearest point (the first of equals).
    3. An old edge holds between two places if the boundary between has its label and its certificate holds. Edges
       whose ends stand for what they stood for come first; one that would overlap another's run, or put a vertex in
       two places, is not kept.

    Parameters
    ----------
    records, local : see ``index_kernels``; ``local`` (-1 for each record, before and after) is room to work in
    touched : the records whose edges may not hold any more
    units, leaves, offsets, labels, closed, first, last, arcs : as ``trace_window`` gives them; ``arc_of`` each point
    fy, fx, epsilon2 : the boundary's true place, and epsilon squared, in sixteenths of a cell
    low_y, low_x, height, width : the part of the lattice where places are looked for
    at : (n, 2) out: where the vertex of a point lies, if there is one
    old_edge : (n,) out: the record whose edge is kept from this point on, else -1; ``ends`` the point where it ends
    """
    size = offsets[arcs]
    first_at = np.full((height, width), -1, np.int32)  # a point of the boundary on each lattice point
    next_at = np.full(size + 1, -1, np.int32)  # and the further ones there
    for m in range(size - 1, -1, -1):
        at[m, 0], at[m, 1] = units[m, 0], units[m, 1]
        old_edge[m] = -1
        y, x = units[m, 0] - low_y, units[m, 1] - low_x
        if 0 <= y < height and 0 <= x < width:
            next_at[m] = first_at[y, x]
            first_at[y, x] = m

    # Vertices of the old edges, numbered.
    vertices = np.empty(2 * touched_count + 1, np.int32)
    count = 0
    for k in range(touched_count):
        for r in (np.int64(touched[k]), np.int64(records[touched[k], NEXT])):
            if local[r] < 0:
                local[r] = count
                vertices[count] = r
                count += 1
    fixed_in, fixed_out = np.full(count, -1, np.int32), np.full(count, -1, np.int32)
    # A vertex outside of the window stays where it is, as the start of one arc, the end of another, or both.
    outside = np.zeros(size + 1, np.uint8)
    for arc in range(arcs):
        if closed[arc]:
            continue
        for side in range(2):
            r = first[arc] if side == 0 else last[arc]
            m = offsets[arc] if side == 0 else offsets[arc + 1] - 1
            if r < 0:
                continue
            at[m, 0], at[m, 1] = records[r, AT_Y], records[r, AT_X]
            outside[m] = 1
            if local[r] >= 0:
                if side == 0:
                    fixed_out[local[r]] = m
                else:
                    fixed_in[local[r]] = m
    # Nodes.
    claimed = np.zeros(count, np.uint8)
    settled = outside.copy()
    old_nodes = np.empty(count, np.int32)
    node_count = 0
    for v in range(count):
        r = vertices[v]
        if (records[r, OUT] < 0 or records[r, IN] < 0) and fixed_in[v] < 0 and fixed_out[v] < 0:
            old_nodes[node_count] = v
            node_count += 1
    for exact in (True, False):
        for arc in range(arcs):
            if closed[arc]:
                continue
            for side in range(2):
                m = offsets[arc] if side == 0 else offsets[arc + 1] - 1
                if settled[m]:
                    continue
                ty, tx = 16 * units[m, 0] + fy, 16 * units[m, 1] + fx
                best, near = -1, epsilon2 + 1
                for q in range(node_count):
                    v = old_nodes[q]
                    r = vertices[v]
                    same = records[r, POINT_Y] == units[m, 0] and records[r, POINT_X] == units[m, 1]
                    if claimed[v] or (exact and not same):
                        continue
                    ry, rx = ty - 16 * records[r, AT_Y], tx - 16 * records[r, AT_X]
                    if abs(ry) > 1024 or abs(rx) > 1024:
                        continue
                    if ry * ry + rx * rx < near:
                        best, near = v, ry * ry + rx * rx
                if best < 0 and exact:
                    continue
                y, x = units[m, 0], units[m, 1]
                if best >= 0:
                    y, x = records[vertices[best], AT_Y], records[vertices[best], AT_X]
                    for q in range(node_count):
                        r = vertices[old_nodes[q]]
                        if records[r, AT_Y] == y and records[r, AT_X] == x:
                            claimed[old_nodes[q]] = 1
                # All arcs that meet at the node.
                n = np.int64(m)
                if 0 <= units[m, 0] - low_y < height and 0 <= units[m, 1] - low_x < width:
                    n = np.int64(first_at[units[m, 0] - low_y, units[m, 1] - low_x])
                while n >= 0:
                    a = arc_of[n]
                    if not closed[a] and (n == offsets[a] or n == offsets[a + 1] - 1) and not settled[n]:
                        at[n, 0], at[n, 1] = y, x
                        settled[n] = 1
                    n = next_at[n]

    # Places.
    reach = int(np.sqrt(float(epsilon2))) // 16 + 1
    same_place = np.full(count, -1, np.int32)
    places_in = np.full((count, PLACES), -1, np.int32)
    places_out = np.full((count, PLACES), -1, np.int32)
    label_in, label_out = np.full(count, -1, np.int64), np.full(count, -1, np.int64)
    for k in range(touched_count):
        r = touched[k]
        label_out[local[r]] = records[r, LABEL]
        label_in[local[records[r, NEXT]]] = records[r, LABEL]
    for v in range(count):
        r = vertices[v]
        wy, wx = records[r, AT_Y], records[r, AT_X]
        found = 0
        for y in range(max(wy - reach - low_y, 0), min(wy + reach - low_y + 1, height)):
            for x in range(max(wx - reach - low_x, 0), min(wx + reach - low_x + 1, width)):
                start = np.int64(first_at[y, x])
                while start >= 0:
                    arc = arc_of[start]
                    begin, end, close = offsets[arc], offsets[arc + 1], closed[arc]
                    if labels[arc] != label_in[v] and labels[arc] != label_out[v]:
                        start = next_at[start]
                        continue
                    ry, rx = 16 * (units[start, 0] - wy) + fy, 16 * (units[start, 1] - wx) + fx
                    distance2 = ry * ry + rx * rx
                    # Only from the start of a stretch, or from the first point of a loop: it may lie within
                    # epsilon altogether.
                    before = after(start, -1, begin, end, close)
                    is_start = before < 0
                    if not is_start:
                        py, px = 16 * (units[before, 0] - wy) + fy, 16 * (units[before, 1] - wx) + fx
                        is_start = py * py + px * px > epsilon2
                    if distance2 <= epsilon2 and (is_start or before >= start):
                        near, best = np.int64(1) << 60, np.int64(-1)
                        m = start
                        while distance2 <= epsilon2:
                            if (
                                units[m, 0] == records[r, POINT_Y]
                                and units[m, 1] == records[r, POINT_X]
                                and (records[r, OUT] < 0 or leaves[m] == records[r, OUT])
                            ):
                                previous = after(m, -1, begin, end, close)
                                if (records[r, IN] < 0 or records[r, OUT] < 0) == (previous < 0 or leaves[m] >= 4) and (
                                    records[r, IN] < 0 or previous < 0 or leaves[previous] & 3 == records[r, IN]
                                ):
                                    same_place[v] = m
                            if distance2 < near:
                                near, best = distance2, m
                            n = after(m, 1, begin, end, close)
                            if n < 0:
                                is_start = True
                                break
                            m = n
                            ry, rx = 16 * (units[m, 0] - wy) + fy, 16 * (units[m, 1] - wx) + fx
                            distance2 = ry * ry + rx * rx
                            if m == start:
                                is_start = True
                                break
                        if is_start and found < PLACES:
                            if same_place[v] >= 0 and arc_of[same_place[v]] == arc:
                                best = same_place[v]
                            if labels[arc] == label_in[v]:
                                places_in[v, found] = best
                            if labels[arc] == label_out[v]:
                                places_out[v, found] = best
                            found += 1
                    start = next_at[start]

    taken = np.zeros(size + 1, np.uint8)  # steps of the boundary that a kept edge owns
    stands = np.zeros(size + 1, np.uint8)  # points that have a vertex
    place_of = np.full(count, -1, np.int32)  # the point that an old vertex stands for
    for m in range(size):
        stands[m] = settled[m]
    for only_same in (True, False):
        for k in range(touched_count):
            r = np.int64(touched[k])
            i, j = local[r], local[records[r, NEXT]]
            h = records[r, NEXT]
            ay, ax = 16 * records[r, AT_Y], 16 * records[r, AT_X]
            by, bx = 16 * records[h, AT_Y], 16 * records[h, AT_X]
            for q in range(PLACES):
                if fixed_out[i] >= 0:
                    a = np.int64(fixed_out[i])
                elif only_same:
                    a = np.int64(same_place[i])
                else:
                    a = np.int64(places_out[i, q])
                if a < 0 or old_edge[a] >= 0 or labels[arc_of[a]] != records[r, LABEL]:
                    continue
                if stands[a] and (16 * at[a, 0] != ay or 16 * at[a, 1] != ax):
                    continue
                if fixed_out[i] < 0 and place_of[i] >= 0 and place_of[i] != a:
                    continue
                arc = arc_of[a]
                begin, end, close = offsets[arc], offsets[arc + 1], closed[arc]
                kept = is_near(16 * units[a, 0] + fy, 16 * units[a, 1] + fx, ay, ax, ay, ax, epsilon2)
                m = a
                reached = False
                # Walk while the certificate can still hold, until a place of the other end.
                while kept and not taken[m]:
                    m = after(m, 1, begin, end, close)
                    if m < 0 or m == a:
                        break
                    if fixed_in[j] >= 0:
                        is_end = m == fixed_in[j]
                    else:
                        is_end = m == same_place[j]
                        for n in range(PLACES):
                            is_end = is_end or (not only_same and places_in[j, n] == m)
                    if is_end and stands[m] and (16 * at[m, 0] != by or 16 * at[m, 1] != bx):
                        is_end = False
                    if is_end and fixed_in[j] < 0 and place_of[j] >= 0 and place_of[j] != m:
                        is_end = False
                    if is_end:
                        reached = is_near(16 * units[m, 0] + fy, 16 * units[m, 1] + fx, by, bx, by, bx, epsilon2)
                        break
                    if stands[m]:
                        break
                    n = after(m, -1, begin, end, close)
                    if leaves[m] != leaves[n]:
                        kept = is_near(16 * units[m, 0] + fy, 16 * units[m, 1] + fx, ay, ax, by, bx, epsilon2)
                if reached:
                    old_edge[a] = r
                    ends[a] = m
                    if fixed_out[i] < 0:
                        place_of[i] = a
                    if fixed_in[j] < 0:
                        place_of[j] = m
                    stands[a] = stands[m] = 1
                    at[a, 0], at[a, 1] = records[r, AT_Y], records[r, AT_X]
                    at[m, 0], at[m, 1] = records[h, AT_Y], records[h, AT_X]
                    while a != m:
                        taken[a] = 1
                        a = after(a, 1, begin, end, close)
                if reached or only_same or fixed_out[i] >= 0:
                    break
    for v in range(count):
        local[vertices[v]] = -1
