"""Numba kernels that find what a window turned over, together with stored edges outside of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.kernel import kernel
from fleetmap.vectorize.conflict_kernels import go_around
from fleetmap.vectorize.edge_kernels import direction
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
    find_record,
    passage_key,
)
from fleetmap.vectorize.network_kernels import find_parts

FEW_OUTSIDE = 3
"""A face with more edges than this outside of the window can't be turned over by what is inside."""


@kernel("void(i8[:,::1], i8, i8, i8)", inline="always")
def add_area(areas: NDArray[np.int64], part: int, label: int, twice_area: int) -> None:
    """Count the area left of a piece of boundary for the state on its left, against that on its right."""
    areas[part, label // 3] += twice_area
    areas[part, label % 3] -= twice_area


@kernel(
    "b1(i4[:,::1], i4[:,::1], i4[::1], u1[::1], u1[::1], i8, i4[::1], i4[:,::1], u1[::1], b1)",
)
def is_inverted(
    records: NDArray[np.int32],
    points: NDArray[np.int32],
    offsets: NDArray[np.int32],
    closed: NDArray[np.uint8],
    labels: NDArray[np.uint8],
    arcs: int,
    first_last: NDArray[np.int32],
    at: NDArray[np.int32],
    is_vertex: NDArray[np.uint8],
    share: bool,
) -> bool:
    """Whether arcs, with the few stored edges that lead from their ends back to their starts, were turned over.

    Arguments as in ``store_kernels.remember``. Arcs that share ends, or are connected by such edges, are a part of the
    network; in it, each state's area must have the sign that the boundary gives it. What is connected to farther edges
    is held by them, and what is to none, ``build_network`` has checked.
    """
    part = find_parts(points, offsets, closed, arcs, at)
    areas, true_areas = np.zeros((arcs, 3), np.int64), np.zeros((arcs, 3), np.int64)
    anchored, reached = np.zeros(arcs, np.uint8), np.zeros(arcs, np.uint8)
    for arc in range(arcs):
        record = np.int64(first_last[2 * arc + 1])
        outside = 0
        while record >= 0:
            n = np.int64(records[record, NEXT])
            start = -1
            for other in range(arcs):
                s = np.int64(first_last[2 * other])
                # At a node outside of the window the boundary of free space goes on with the arc that starts there.
                if s == record or (
                    share
                    and n < 0
                    and s >= 0
                    and records[s, PREV] < 0
                    and records[s, POINT_Y] == records[record, POINT_Y]
                    and records[s, POINT_X] == records[record, POINT_X]
                ):
                    start = other
            if start >= 0:
                reached[start] = 1
                a, b = part[arc], part[start]
                if a != b:
                    for other in range(arcs):
                        if part[other] == b:
                            part[other] = a
                break
            if n < 0 or outside == FEW_OUTSIDE:
                anchored[arc] = 1
                break
            y, x = np.int64(records[record, POINT_Y]), np.int64(records[record, POINT_X])
            area = x * records[n, POINT_Y] - y * records[n, POINT_X]
            add_area(true_areas, arc, records[record, LABEL], area)
            y, x = np.int64(records[record, AT_Y]), np.int64(records[record, AT_X])
            area = x * records[n, AT_Y] - y * records[n, AT_X]
            add_area(areas, arc, records[record, LABEL], area)
            record = n
            outside += 1
    has_ends = np.zeros(arcs, np.uint8)
    for arc in range(arcs):
        p, start = part[arc], np.int64(offsets[arc])
        if first_last[2 * arc] >= 0 and not reached[arc]:
            anchored[arc] = 1
        if anchored[arc]:
            anchored[p] = 1
        if first_last[2 * arc] >= 0 or first_last[2 * arc + 1] >= 0:
            has_ends[p] = 1
        area, true_area, last = np.int64(0), np.int64(0), start
        for m in range(start + 1, np.int64(offsets[arc + 1])):
            true_area += np.int64(points[m - 1, 1]) * points[m, 0] - np.int64(points[m - 1, 0]) * points[m, 1]
            if is_vertex[m]:
                area += np.int64(at[last, 1]) * at[m, 0] - np.int64(at[last, 0]) * at[m, 1]
                last = np.int64(m)
        add_area(areas, arc, labels[arc], area)
        add_area(true_areas, arc, labels[arc], true_area)
    for arc in range(arcs):
        if part[arc] != arc:
            areas[part[arc]] += areas[arc]
            true_areas[part[arc]] += true_areas[arc]
    for p in range(arcs):
        if part[p] != p or anchored[p] or not has_ends[p]:
            continue
        # Where backs of walls are left out, only free space has all of its boundary.
        for state in range(1 if share else 3):
            if (areas[p, state] > 0) != (true_areas[p, state] > 0) or (areas[p, state] < 0) != (
                true_areas[p, state] < 0
            ):
                return True
    return False


@kernel(
    "b1(i4[:,::1], i8[:,::1], u1[::1], i4[:,::1], i4[::1], u1[::1], i8, i4[::1], i4[:,::1], u1[::1])",
)
def is_turned(
    records: NDArray[np.int32],
    table: NDArray[np.int64],
    marks: NDArray[np.uint8],
    points: NDArray[np.int32],
    offsets: NDArray[np.int32],
    closed: NDArray[np.uint8],
    arcs: int,
    first_last: NDArray[np.int32],
    at: NDArray[np.int32],
    is_vertex: NDArray[np.uint8],
) -> bool:
    """Whether around some stored vertex at which an arc ends the edges don't have the order of their cracks.

    There may be three or four, those of the arcs and stored ones that no one has marked. Arguments as in
    ``is_inverted``; ``table`` and ``marks`` as in ``index_kernels``.
    """
    crack, away = np.empty(8, np.int64), np.empty((8, 2), np.int64)
    for end in range(2 * arcs):
        if closed[end >> 1] or first_last[end] < 0:
            continue
        own = np.int64(first_last[end])
        y, x = np.int64(records[own, POINT_Y]), np.int64(records[own, POINT_X])
        count = 0
        for other in range(2 * arcs):
            arc, is_last = other >> 1, other & 1
            m = np.int64(offsets[arc + 1] - 1) if is_last else np.int64(offsets[arc])
            if closed[arc] or first_last[other] < 0 or points[m, 0] != y or points[m, 1] != x or count == 8:
                continue
            if at[m, 0] != records[own, AT_Y] or at[m, 1] != records[own, AT_X]:
                continue  # boundaries that touch here have a vertex each
            step = -1 if is_last else 1
            n = m + step
            crack[count] = direction(y, x, points[n, 0], points[n, 1])
            while not is_vertex[n]:
                n += step
            away[count, 0], away[count, 1] = at[n, 0] - at[m, 0], at[n, 1] - at[m, 1]
            count += 1
        for code in range(8):
            r = find_record(table, passage_key(y, x, code))
            if r < 0 or records[r, AT_Y] != records[own, AT_Y] or records[r, AT_X] != records[own, AT_X]:
                continue
            for side in range(2):
                neighbour = np.int64(records[r, PREV if side else NEXT])
                way = np.int64(records[r, IN if side else OUT])
                if neighbour < 0 or way < 0 or marks[neighbour if side else r] or count == 8:
                    continue
                crack[count] = (way + 2) & 3 if side else way
                away[count, 0] = records[neighbour, AT_Y] - records[r, AT_Y]
                away[count, 1] = records[neighbour, AT_X] - records[r, AT_X]
                count += 1
        if not go_around(crack, away, crack.copy(), count):
            return True
    return False
