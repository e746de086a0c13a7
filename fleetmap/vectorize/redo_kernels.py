"""Numba kernels that give up edges which hold, where all around them takes too many vertices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.kernel import kernel
from fleetmap.vectorize.fewest_kernels import AT_X, AT_Y, GAP_ROWS, TRUE_X, TRUE_Y, choose_fewest

SLACK_EDGES = 1
"""So many edges more than that are let be: each change costs bytes."""

STRETCH_EDGES = 16
"""So many edges between gaps are looked at together."""

WINDOW_EDGES = 3
"""Kept edges on each side of a gap that are looked at together with it."""


@kernel(
    "i8(i4[:,::1], i8, i8, i8, i8, i8, i8, u1[::1], i4[:,::1], b1, i8[:,::1])",
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
        gap[AT_Y, n], gap[AT_X, n] = points[m, 0], points[m, 1]
        if stops[m] and (not through or q == low or q == high):
            gap[AT_Y, n], gap[AT_X, n] = at[m, 0], at[m, 1]
        n += 1
    return n


@kernel(
    "i8(i4[:,::1], i8, i8, i8[::1], i8, i8, i8, i8, f8, f8, u1[::1], u1[::1], i4[:,::1], i4[::1], i8[:,::1], f8[::1])",
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


@kernel(
    "i8(i4[:,::1], i4[::1], u1[::1], i8, i8, i8, i8, f8, u1[::1], u1[::1], u1[::1], i4[:,::1], i4[::1])",
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
