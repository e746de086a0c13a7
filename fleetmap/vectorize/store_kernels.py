"""Numba kernels between the traced arcs and the records that are stored: see ``index_kernels`` for the words."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fleetmap.vectorize.conflict_kernels import conflict
from fleetmap.vectorize.fewest_kernels import AT_X as GAP_AT_X
from fleetmap.vectorize.fewest_kernels import AT_Y as GAP_AT_Y
from fleetmap.vectorize.fewest_kernels import GAP_ROWS, TRUE_X, TRUE_Y, choose_fewest, is_near
from fleetmap.vectorize.index_kernels import (
    AT_X,
    AT_Y,
    BUCKET,
    IN,
    LABEL,
    NEXT,
    OUT,
    POINT_X,
    POINT_Y,
    PREV,
    THICK,
    find_record,
    insert_record,
    link_edge,
    passage_key,
    remove_record,
)
from fleetmap.vectorize.jump_kernels import count_passes
from fleetmap.vectorize.window_kernels import VERTEX


@njit(
    "i8(i4[:,::1], i4[:,::1], i4[:,::1], u1[::1], i8, i8, i8, i8, i8, i8, i8, b1, i8, i4[::1])", cache=True, nogil=True
)
def gather_touched(
    records: NDArray[np.int32],
    buckets: NDArray[np.int32],
    links: NDArray[np.int32],
    marks: NDArray[np.uint8],
    oy: int,
    ox: int,
    y0: int,
    x0: int,
    y1: int,
    x1: int,
    reach: int,
    share: bool,
    around: int,
    touched: NDArray[np.int32],
) -> int:
    """List and mark the records whose edges leave a point of the window y0 <= y <= y1, x0 <= x <= x1 (lattice).

    Of the outlines of hidden obstacles in the profile ``share``, all records, if an edge comes within ``around``.
    Returns how many.
    """
    count = 0
    wide = max(reach, around if share else 0)
    for row in range(max(y0 - wide - oy, 0) // BUCKET, min((y1 + wide - oy) // BUCKET + 1, len(buckets))):
        for column in range(max(x0 - wide - ox, 0) // BUCKET, min((x1 + wide - ox) // BUCKET + 1, buckets.shape[1])):
            link = buckets[row, column]
            while link >= 0:
                r = np.int64(links[link, 0])
                link = links[link, 1]
                if marks[r]:
                    continue
                y, x = records[r, POINT_Y], records[r, POINT_X]
                hidden = share and records[r, LABEL] == 5
                ny, nx, by, bx = y, x, y, x
                more = 0
                if hidden:
                    # The whole edge: nothing else tells that its run passes through the window.
                    h = records[r, NEXT]
                    more = around + reach
                    ny, nx = min(y, records[h, POINT_Y]), min(x, records[h, POINT_X])
                    by, bx = max(y, records[h, POINT_Y]), max(x, records[h, POINT_X])
                if y0 - more <= by and ny <= y1 + more and x0 - more <= bx and nx <= x1 + more:
                    while not marks[r]:
                        marks[r] = 2 if hidden else 1
                        touched[count] = r
                        count += 1
                        if not hidden:
                            break
                        r = np.int64(records[r, NEXT])
    return count


@njit(
    "i8(i4[:,::1], u1[::1], i4[::1], i4[::1], i8, u1[::1], i4[:,::1], i4[::1], i4[::1], u1[:,::1], i8, i8,"
    " i4[:,::1], i4[::1], u1[::1], u1[::1], u1[::1], u1[::1], i4[:,::1], i4[::1])",
    cache=True,
    nogil=True,
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


SLACK_EDGES = 1
"""So many edges more than that are let be: each change costs bytes."""

STRETCH_EDGES = 16
"""So many edges between gaps are looked at together."""

WINDOW_EDGES = 3
"""Kept edges on each side of a gap that are looked at together with it."""


@njit(
    "i8(i4[:,::1], i8, i8, i8, i8, i8, i8, u1[::1], i4[:,::1], b1, i8[:,::1])",
    cache=True,
    nogil=True,
)
def collect(
    points: NDArray[np.int32],
    start: int,
    size: int,
    low: int,
    high: int,
    fy: int,
    fx: int,
    stops: NDArray[np.uint8],
    at: NDArray[np.int32],
    through: bool,
    gap: NDArray[np.int64],
) -> int:
    """Fill a gap with the corners from ``low`` to ``high`` of an arc, its ends where they lie; returns how many.

    ``through``: the vertices between stand on the boundary again.
    """
    n = 0
    for q in range(low, high + 1):
        m = q if q < start + size else q - size
        gap[TRUE_Y, n], gap[TRUE_X, n] = 16 * points[m, 0] + fy, 16 * points[m, 1] + fx
        gap[GAP_AT_Y, n], gap[GAP_AT_X, n] = points[m, 0], points[m, 1]
        if stops[m] and (not through or q == low or q == high):
            gap[GAP_AT_Y, n], gap[GAP_AT_X, n] = at[m, 0], at[m, 1]
        n += 1
    return n


@njit(
    "i8(i4[:,::1], i8, i8, i8[::1], i8, i8, i8, i8, f8, f8, u1[::1], u1[::1], i4[:,::1], i4[::1], i8[:,::1], f8[::1])",
    cache=True,
    nogil=True,
)
def give_up(
    points: NDArray[np.int32],
    start: int,
    size: int,
    around: NDArray[np.int64],
    low: int,
    high: int,
    fy: int,
    fx: int,
    epsilon: float,
    ratio: float,
    stops: NDArray[np.uint8],
    kept: NDArray[np.uint8],
    at: NDArray[np.int32],
    old_of: NDArray[np.int32],
    gap: NDArray[np.int64],
    error: NDArray[np.float64],
) -> int:
    """Give up the kept edges between vertices ``low`` and ``high`` of an arc if they are too many; how many there were.

    ``around`` are the corners of an arc's vertices, beyond its end where it is closed and goes around. What is fewest
    is only estimated, by going on from the two farthest vertices each time.
    """
    end = start + size
    now, held = 0, 0
    for q in range(low, high):
        b = around[q] if around[q] < end else around[q] - size
        if kept[b]:
            now += 1
            held += 1
        elif not stops[b]:
            return 0  # it was given up before
        else:
            n = collect(points, start, size, around[q], around[q + 1], fy, fx, stops, at, False, gap)
            now += choose_fewest(gap, n, epsilon, error, 2) - 1
    if now < 3 or held == 0:
        return 0
    n = collect(points, start, size, around[low], around[high], fy, fx, stops, at, True, gap)
    if now <= ratio * (choose_fewest(gap, n, epsilon, error, 2) - 1) + SLACK_EDGES:
        return 0
    for q in range(low, high):
        b = around[q] if around[q] < end else around[q] - size
        kept[b] = 0
        old_of[b] = -1
        if q > low:
            stops[b] = 0
            at[b, 0], at[b, 1] = points[b, 0], points[b, 1]
    return held


@njit(
    "i8(i4[:,::1], i4[::1], u1[::1], i8, i8, i8, i8, f8, u1[::1], u1[::1], u1[::1], i4[:,::1], i4[::1])",
    cache=True,
    nogil=True,
)
def redo_wasteful(
    points: NDArray[np.int32],
    offsets: NDArray[np.int32],
    closed: NDArray[np.uint8],
    arcs: int,
    fy: int,
    fx: int,
    epsilon2: int,
    ratio: float,
    fixed: NDArray[np.uint8],
    stops: NDArray[np.uint8],
    kept: NDArray[np.uint8],
    at: NDArray[np.int32],
    old_of: NDArray[np.int32],
) -> int:
    """Give up kept edges beside a gap where all of it together would take far fewer edges.

    A stretch of a gap and ``WINDOW_EDGES`` kept edges on both its sides is done anew if it has more than ``ratio``
    times the edges of the fewest. Returns how many kept edges were given up.
    """
    given_up = 0
    longest = 0
    for arc in range(arcs):
        longest = max(longest, offsets[arc + 1] - offsets[arc])
    room = 2 * longest + 2
    gap, error = np.empty((GAP_ROWS, room), np.int64), np.empty(room, np.float64)
    around = np.empty(room, np.int64)
    epsilon = np.sqrt(float(epsilon2)) / 16.0
    for arc in range(arcs):
        start, end, size = offsets[arc], offsets[arc + 1], offsets[arc + 1] - offsets[arc]
        # The vertices that stay, once around.
        count = 0
        for m in range(start, end):
            if stops[m]:
                around[count] = m
                count += 1
        if closed[arc]:
            if count < 3:
                continue
            around[count] = around[0] + size
            count += 1
        # Stretches around gaps first, then, if there was one, those between.
        gaps = 0
        done = 0
        for g in range(count - 1):
            a = around[g] if around[g] < end else around[g] - size
            if kept[a]:
                continue
            gaps += 1
            if g < done:
                continue
            low, high = max(g - WINDOW_EDGES, done), min(g + 1 + WINDOW_EDGES, count - 1)
            lost = give_up(
                points, start, size, around, low, high, fy, fx, epsilon, ratio, stops, kept, at, old_of,
                gap, error,
            )  # fmt: skip
            given_up += lost
            done = high if lost > 0 else done
        low = 0
        while gaps > 0 and low < count - 1:
            high = min(low + STRETCH_EDGES, count - 1)
            given_up += give_up(
                points, start, size, around, low, high, fy, fx, epsilon, ratio, stops, kept, at, old_of,
                gap, error,
            )  # fmt: skip
            low = high
    return given_up


@njit(
    "i8(i4[::1], i4[::1], i4[::1], i4[:,::1], i4[::1], u1[::1], i4[:,::1], i4[:,::1], i4[:,::1], u1[::1],"
    " i8[:,::1], u1[::1], i8, i8, i8, i8, i4[::1])",
    cache=True,
    nogil=True,
)
def find_foreign(
    tails: NDArray[np.int32],
    heads: NDArray[np.int32],
    arc_of: NDArray[np.int32],
    points: NDArray[np.int32],
    offsets: NDArray[np.int32],
    closed: NDArray[np.uint8],
    records: NDArray[np.int32],
    buckets: NDArray[np.int32],
    links: NDArray[np.int32],
    marks: NDArray[np.uint8],
    edges: NDArray[np.int64],
    is_new: NDArray[np.uint8],
    count: int,
    oy: int,
    ox: int,
    reach: int,
    found: NDArray[np.int32],
) -> int:
    """List and mark stored edges, not marked so far, that new ones conflict with or have jumped over.

    Beside the first vertex of a closed arc every stored edge within reach is listed: it may have jumped over that.
    ``edges`` as in ``edge_kernels``, with one unused row at the end. Returns how many were found.
    """
    total = 0
    wide2 = (16 * (reach + 1)) ** 2
    for k in range(count):
        arc = arc_of[k]
        witness = closed[arc] and (k == 0 or arc_of[k - 1] != arc)
        if not is_new[k] and not witness:
            continue
        y0, y1 = min(edges[k, 0], edges[k, 2]) - reach, max(edges[k, 0], edges[k, 2]) + reach
        x0, x1 = min(edges[k, 1], edges[k, 3]) - reach, max(edges[k, 1], edges[k, 3]) + reach
        for row in range(max(y0 - oy, 0) // BUCKET, min((y1 - oy) // BUCKET + 1, len(buckets))):
            for column in range(max(x0 - ox, 0) // BUCKET, min((x1 - ox) // BUCKET + 1, buckets.shape[1])):
                link = buckets[row, column]
                while link >= 0:
                    r = np.int64(links[link, 0])
                    link = links[link, 1]
                    h = records[r, NEXT]
                    if (
                        marks[r]
                        or max(records[r, AT_Y], records[h, AT_Y]) < y0
                        or min(records[r, AT_Y], records[h, AT_Y]) > y1
                        or max(records[r, AT_X], records[h, AT_X]) < x0
                        or min(records[r, AT_X], records[h, AT_X]) > x1
                    ):
                        continue
                    f = count
                    edges[f, 0], edges[f, 1] = records[r, AT_Y], records[r, AT_X]
                    edges[f, 2], edges[f, 3] = records[h, AT_Y], records[h, AT_X]
                    edges[f, 4], edges[f, 5] = records[r, POINT_Y], records[r, POINT_X]
                    edges[f, 6], edges[f, 7] = records[h, POINT_Y], records[h, POINT_X]
                    hit = is_new[k] and conflict(edges, k, f)
                    if not hit and is_new[k]:
                        hit = (
                            count_passes(
                                points, tails[k], heads[k], offsets[arc], offsets[arc + 1], edges, k,
                                edges[f, 4], edges[f, 5], edges[f, 0], edges[f, 1],
                            )
                            != 0
                        )  # fmt: skip
                    if not hit and witness:
                        hit = is_near(
                            16 * edges[k, 0], 16 * edges[k, 1], 16 * edges[f, 0], 16 * edges[f, 1],
                            16 * edges[f, 2], 16 * edges[f, 3], wide2,
                        )  # fmt: skip
                    if hit and total < len(found):
                        marks[r] = 1
                        found[total] = r
                        total += 1
    return total


@njit(
    "void(i4[:,::1], i8[:,::1], i4[:,::1], i4[:,::1], i8[::1], i8[::1], i8[::1], i4[::1], i8, u1[::1], i8, i8, i8,"
    " i8, i8, i8)",
    cache=True,
    nogil=True,
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


@njit(
    "void(i4[:,::1], i8[:,::1], i4[:,::1], i4[:,::1], i8[::1], i8[::1], i8[::1], u1[:,::1], i8, i8, i4[:,::1], i4[::1],"
    " u1[::1], u1[::1], u1[::1], i8, i4[::1], i4[:,::1], u1[::1])",
    cache=True,
    nogil=True,
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


@njit("i8(i8, i8, i8, i8, i8)", cache=True, nogil=True, inline="always")
def row_hash(y0: int, x0: int, y1: int, x1: int, label: int) -> int:
    """A number above 0 for an edge; two edges hardly ever have the same."""
    one, two = np.int64(label + 1), np.int64(label + 17)
    for value in (y0, x0, y1, x1):
        one = (one * 48271 + value + (1 << 22)) % 2147483647
        two = (two * 69621 + value + (1 << 22)) % 2147483629
    return (one << 31) + two + 1


@njit("void(i8[:,::1], i8, i8, i8, i8, i8, i8, i8)", cache=True, nogil=True, inline="always")
def write_row(rows: NDArray[np.int64], k: int, y0: int, x0: int, y1: int, x1: int, label: int, thickness: int) -> None:
    """Row k: an edge as maps hold it, the lower end first, and its thickness."""
    if y0 > y1 or (y0 == y1 and x0 > x1):
        y0, x0, y1, x1 = y1, x1, y0, x0
        label = 3 * (label % 3) + label // 3
    rows[k, 0], rows[k, 1], rows[k, 2], rows[k, 3], rows[k, 4], rows[k, 5] = y0, x0, y1, x1, label, thickness


@njit(
    "Tuple((i8, i8, i8))(i4[:,::1], i4[::1], i8, i8[:,::1], i4[::1], i4[::1], u1[::1], u1[::1], i8, i8[:,::1],"
    " i8[:,::1], i8[:,::1])",
    cache=True,
    nogil=True,
)
def list_changes(
    records: NDArray[np.int32],
    touched: NDArray[np.int32],
    touched_count: int,
    edges: NDArray[np.int64],
    tails: NDArray[np.int32],
    arc_of: NDArray[np.int32],
    labels: NDArray[np.uint8],
    thickness: NDArray[np.uint8],
    count: int,
    removed: NDArray[np.int64],
    added: NDArray[np.int64],
    rethickened: NDArray[np.int64],
) -> tuple[int, int, int]:
    """Compare the edges of the touched records with the new ones, by content; returns how many rows of each kind.

    ``thickness`` is that of the edge that leaves each corner.
    """
    size = 16
    while size < 4 * touched_count:
        size *= 2
    table = np.zeros((size, 2), np.int64)
    row = np.empty((1, 6), np.int64)
    stays = np.zeros(touched_count, np.uint8)
    for k in range(touched_count):
        r = touched[k]
        h = records[r, NEXT]
        write_row(row, 0, records[r, AT_Y], records[r, AT_X], records[h, AT_Y], records[h, AT_X], records[r, LABEL], 0)
        insert_record(table, row_hash(row[0, 0], row[0, 1], row[0, 2], row[0, 3], row[0, 4]), k)
    gone, new, changed = 0, 0, 0
    for e in range(count):
        d = thickness[tails[e]]
        write_row(added, new, edges[e, 0], edges[e, 1], edges[e, 2], edges[e, 3], labels[arc_of[e]], d)
        k = find_record(table, row_hash(added[new, 0], added[new, 1], added[new, 2], added[new, 3], added[new, 4]))
        if k < 0:
            new += 1
            continue
        stays[k] = 1
        if records[touched[k], THICK] != d:
            rethickened[changed, :] = added[new, :]
            changed += 1
    for k in range(touched_count):
        if stays[k]:
            continue
        r = touched[k]
        h = records[r, NEXT]
        write_row(
            removed, gone, records[r, AT_Y], records[r, AT_X], records[h, AT_Y], records[h, AT_X], records[r, LABEL], 0
        )
        gone += 1
    return gone, new, changed
