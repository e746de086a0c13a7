"""Numba kernels between the traced arcs and the records that are stored: see ``index_kernels`` for the words."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.kernel import kernel
from fleetmap.vectorize.index_kernels import (
    AT_X,
    AT_Y,
    IN,
    LABEL,
    NEXT,
    OUT,
    POINT_X,
    POINT_Y,
    PREV,
    THICK,
    insert_record,
    link_edge,
    passage_key,
    remove_record,
)
from fleetmap.vectorize.window_kernels import VERTEX


@kernel(
    "i8(i4[:,::1], u1[::1], i4[::1], i4[::1], i8, u1[::1], i4[:,::1], i4[::1], i4[::1], u1[:,::1], i8, i8,"
    " i4[:,::1], i4[::1], u1[::1], u1[::1], u1[::1], u1[::1], i4[:,::1], i4[::1])",
)
def list_corners(
    units: NDArray[np.int32],
    leaves: NDArray[np.uint8],
    offsets: NDArray[np.int32],
    old_edge: NDArray[np.int32],
    arcs: int,
    closed: NDArray[np.uint8],
    unit_at: NDArray[np.int32],
    ends: NDArray[np.int32],
    first_last: NDArray[np.int32],
    cracks: NDArray[np.uint8],
    oy: int,
    ox: int,
    points: NDArray[np.int32],
    corner_offsets: NDArray[np.int32],
    special: NDArray[np.uint8],
    fixed: NDArray[np.uint8],
    stops: NDArray[np.uint8],
    kept: NDArray[np.uint8],
    at: NDArray[np.int32],
    old_of: NDArray[np.int32],
) -> int:
    """Reduce points a unit step apart to corners, ends and the vertices of kept edges; returns how many.

    ``first_last`` (2 arcs,) are the records at the ends of the arcs, or -1. ``old_of``: the record whose edge is kept
    from a corner on, or -1; the other results are those that ``build_network`` wants.
    """
    size = offsets[arcs]
    stands = np.zeros(size + 1, np.uint8)
    for m in range(size):
        if old_edge[m] >= 0:
            stands[m] = stands[ends[m]] = 1
    count = 0
    corner_offsets[0] = 0
    for arc in range(arcs):
        start, end = offsets[arc], offsets[arc + 1]
        for m in range(start, end):
            is_end = not closed[arc] and (m == start or m == end - 1)
            if not is_end and not stands[m]:
                before = m - 1 if m > start else end - 1
                if leaves[before] == leaves[m]:
                    continue
            points[count, 0], points[count, 1] = units[m, 0], units[m, 1]
            bits = cracks[units[m, 0] - oy, units[m, 1] - ox] & 15
            special[count] = bits == 15 or bits == 7 or bits == 11 or bits == 13 or bits == 14
            fixed[count] = is_end and first_last[2 * arc + (m != start)] >= 0
            stops[count] = is_end or stands[m]
            kept[count] = old_edge[m] >= 0
            old_of[count] = old_edge[m]
            at[count, 0], at[count, 1] = unit_at[m, 0], unit_at[m, 1]
            count += 1
        corner_offsets[arc + 1] = count
    return count


@kernel(
    "void(i4[:,::1], i8[:,::1], i4[:,::1], i4[:,::1], i8[::1], i8[::1], i8[::1], i4[::1], i8, u1[::1], i8, i8, i8,"
    " i8, i8, i8)",
)
def forget(
    records: NDArray[np.int32],
    table: NDArray[np.int64],
    buckets: NDArray[np.int32],
    links: NDArray[np.int32],
    free_links: NDArray[np.int64],
    free: NDArray[np.int64],
    used: NDArray[np.int64],
    touched: NDArray[np.int32],
    count: int,
    marks: NDArray[np.uint8],
    oy: int,
    ox: int,
    y0: int,
    x0: int,
    y1: int,
    x1: int,
) -> None:
    """Take the touched edges out of the buckets, and free their vertices that lie in the window (lattice).

    Those of a hidden outline, which is touched as a whole, are freed wherever they are: all whose edges on both sides
    are touched and marked 2. ``free`` lists unused records, ``used`` = (how many are in the list, highest used + 1).
    """
    for k in range(count):
        link_edge(records, buckets, links, touched[k], oy, ox, len(links), free_links, False)
    for k in range(2 * count):
        r = np.int64(touched[k >> 1])
        if k & 1:
            r = np.int64(records[r, NEXT])
            if r < 0 or records[r, OUT] >= 0:
                continue  # it is touched itself, or lies outside
        y, x = records[r, POINT_Y], records[r, POINT_X]
        if (y0 <= y <= y1 and x0 <= x <= x1) or marks[r] == 2:
            if records[r, LABEL] < 0:
                continue
            code = records[r, OUT] if records[r, OUT] >= 0 else 4 + records[r, IN]
            remove_record(table, passage_key(y, x, code))
            records[r, LABEL] = -1
    for k in range(2 * count):
        r = np.int64(touched[k >> 1])
        if k & 1:
            r = np.int64(records[r, NEXT])
            if r < 0 or records[r, OUT] >= 0:
                continue
        if records[r, LABEL] == -1:
            records[r, LABEL] = -2
            free[used[0]] = r
            used[0] += 1
    for k in range(count):
        marks[touched[k]] = 0


@kernel(
    "void(i4[:,::1], i8[:,::1], i4[:,::1], i4[:,::1], i8[::1], i8[::1], i8[::1], u1[:,::1], i8, i8, i4[:,::1], i4[::1],"
    " u1[::1], u1[::1], u1[::1], i8, i4[::1], i4[:,::1], u1[::1])",
)
def remember(
    records: NDArray[np.int32],
    table: NDArray[np.int64],
    buckets: NDArray[np.int32],
    links: NDArray[np.int32],
    free_links: NDArray[np.int64],
    free: NDArray[np.int64],
    used: NDArray[np.int64],
    cracks: NDArray[np.uint8],
    oy: int,
    ox: int,
    points: NDArray[np.int32],
    offsets: NDArray[np.int32],
    labels: NDArray[np.uint8],
    closed: NDArray[np.uint8],
    thickness: NDArray[np.uint8],
    arcs: int,
    first_last: NDArray[np.int32],
    at: NDArray[np.int32],
    is_vertex: NDArray[np.uint8],
) -> None:
    """Store arcs: ``thickness`` of the edge that leaves each corner, ``first_last`` as in ``list_corners``."""
    for arc in range(arcs):
        start, end = offsets[arc], offsets[arc + 1]
        before, first = np.int64(-1), np.int64(-1)
        vertices = 0
        for m in range(start, end):
            if not is_vertex[m]:
                continue
            vertices += 1
            is_first, is_last = not closed[arc] and m == start, not closed[arc] and m == end - 1
            r = np.int64(-1)
            if is_first:
                r = np.int64(first_last[2 * arc])
            elif is_last:
                r = np.int64(first_last[2 * arc + 1])
            known = r >= 0
            if not known:
                if used[0] > 0:
                    used[0] -= 1
                    r = free[used[0]]
                else:
                    r = used[1]
                    used[1] += 1
                records[r, OUT] = records[r, IN] = records[r, NEXT] = records[r, PREV] = -1
                records[r, LABEL] = labels[arc]
                records[r, AT_Y], records[r, AT_X] = at[m, 0], at[m, 1]
                records[r, POINT_Y], records[r, POINT_X] = points[m, 0], points[m, 1]
            if not is_last:
                n = m + 1 if m + 1 < end else start
                records[r, LABEL] = labels[arc]
                records[r, THICK] = thickness[m]
                if not known:
                    dy, dx = points[n, 0] - points[m, 0], points[n, 1] - points[m, 1]
                    records[r, OUT] = 0 if dx > 0 else 2 if dx < 0 else 1 if dy > 0 else 3
            if not is_first and not known:
                n = m - 1 if m > start else end - 1
                dy, dx = points[m, 0] - points[n, 0], points[m, 1] - points[n, 1]
                records[r, IN] = 0 if dx > 0 else 2 if dx < 0 else 1 if dy > 0 else 3
            if not known:
                code = records[r, OUT] if records[r, OUT] >= 0 else 4 + records[r, IN]
                insert_record(table, passage_key(points[m, 0], points[m, 1], code), r)
                cracks[points[m, 0] - oy, points[m, 1] - ox] |= VERTEX
            if before >= 0:
                records[before, NEXT] = r
                records[r, PREV] = before
            else:
                first = r
            before = r
        if closed[arc] and before >= 0:
            records[before, NEXT] = first
            records[first, PREV] = before
        # Once all are chained: an edge lies where its two ends are.
        r = first
        for _ in range(vertices if closed[arc] else vertices - 1):
            link_edge(records, buckets, links, r, oy, ox, len(links), free_links, True)
            r = np.int64(records[r, NEXT])
