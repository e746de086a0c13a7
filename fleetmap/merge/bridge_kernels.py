"""Integer kernel of the bridges: shortest ways from the tips of walls.

Lengths are sums of at most ``MOST_VERTICES`` pieces of at most 2^18 steps along each axis: below 2^26.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.merge import bridge
from fleetmap.model.kernel import kernel

Ints = NDArray[np.int64]

LONGEST_CELLS = bridge.LONGEST_CELLS
DETOUR = bridge.DETOUR
MOST_VERTICES = bridge.MOST_VERTICES
MOST_WALLS = bridge.MOST_WALLS
BEND_FIFTHS = bridge.BEND_FIFTHS

LENGTH, VERTEX, BEFORE, PIECE = range(4)
"""Columns of what is on a way: how far from the start, which vertex, the row before it, the piece from there."""


@kernel("boolean(int64[:, ::1], int64, int64)")
def comes_before(rows: Ints, i: int, j: int) -> bool:
    """Whether row i comes before row j: nearer, or lower, or reached from what was reached earlier."""
    for column in range(4):
        if rows[i, column] != rows[j, column]:
            return bool(rows[i, column] < rows[j, column])
    return False


@kernel("int64(int64[:, ::1], int64[:, ::1], int64[::1], int64[::1], int64, int64, int64[::1], int64, int64[:, ::1])")
def near(
    at: Ints, ids: Ints, start: Ints, items: Ints, vertex: int, reach: int, met: Ints, mark: int, done: Ints
) -> int:
    """How many vertices are nearest to one, at most ``reach`` along the pieces; ``done`` gets them in this order.

    Ties by place, then by the way. ``met``: by which search each vertex was reached last; ``mark`` is this one's.
    """
    size = MOST_VERTICES * MOST_WALLS + 1
    heap = np.empty((size, 4), np.int64)
    heap[0, LENGTH], heap[0, VERTEX], heap[0, BEFORE], heap[0, PIECE] = 0, vertex, -1, -1
    n_heap, n = 1, 0
    while n_heap > 0 and n < len(done):
        length, here, before, piece = heap[0, LENGTH], heap[0, VERTEX], heap[0, BEFORE], heap[0, PIECE]
        n_heap -= 1
        k = 0  # the last one sinks from the top
        while True:
            child = 2 * k + 1
            if child >= n_heap:
                break
            if child + 1 < n_heap and comes_before(heap, child + 1, child):
                child += 1
            if not comes_before(heap, child, n_heap):
                break
            heap[k] = heap[child]
            k = child
        heap[k] = heap[n_heap]
        if met[here] == mark:
            continue
        met[here] = mark
        done[n, LENGTH], done[n, VERTEX], done[n, BEFORE], done[n, PIECE] = length, here, before, piece
        n += 1
        for q in range(start[here], min(start[here + 1], start[here] + MOST_WALLS)):
            to = ids[items[q], 0] if ids[items[q], 1] == here else ids[items[q], 1]
            longer = length + abs(at[to, 0] - at[here, 0]) + abs(at[to, 1] - at[here, 1])
            if longer > reach or met[to] == mark:
                continue
            k = n_heap
            heap[k, LENGTH], heap[k, VERTEX], heap[k, BEFORE], heap[k, PIECE] = longer, to, n - 1, items[q]
            n_heap += 1
            while k > 0 and comes_before(heap, k, (k - 1) // 2):
                heap[k], heap[(k - 1) // 2] = heap[(k - 1) // 2].copy(), heap[k].copy()
                k = (k - 1) // 2
    return n


@kernel("boolean(int64[:, ::1], int64[:, ::1], int64[::1], int64[::1], int64)")
def is_tip(at: Ints, ids: Ints, start: Ints, items: Ints, vertex: int) -> bool:
    """Whether all walls leave a vertex within a right angle: it is the end of a wall, or the tip of a wedge."""
    if start[vertex + 1] - start[vertex] > MOST_WALLS:
        return False
    for p in range(start[vertex], start[vertex + 1]):
        for q in range(start[vertex], p):
            a = ids[items[p], 0] + ids[items[p], 1] - vertex
            b = ids[items[q], 0] + ids[items[q], 1] - vertex
            dot = (at[a, 0] - at[vertex, 0]) * (at[b, 0] - at[vertex, 0])
            if dot + (at[a, 1] - at[vertex, 1]) * (at[b, 1] - at[vertex, 1]) <= 0:
                return False
    return True


@kernel(
    "boolean[::1](int64[:, ::1], int64[:, ::1], int64[::1], int64[::1], int64[::1], int64[::1], int64[::1], int64[::1])"
)
def find_bridges(
    at: Ints, ids: Ints, cell: Ints, tips: Ints, way_start: Ints, ways: Ints, wall_start: Ints, walls: Ints
) -> NDArray[np.bool_]:
    """Which pieces lead on from a tip of walls that stay to another one, see ``bridge.bridges``.

    ``at``: (v, 2) vertices; ``ids``: (n, 2) those of each piece. ``ways[way_start[v]:way_start[v + 1]]`` are the pieces
    at vertex v that would go, ``walls`` those that stay.
    """
    found = np.zeros(len(ids), np.bool_)
    reached = np.empty((MOST_VERTICES, 4), np.int64)
    own = np.empty((MOST_VERTICES, 4), np.int64)
    met, met_own = np.full(len(at), -1), np.full(len(at), -1)
    candidates = np.empty(MOST_VERTICES, np.int64)
    for tip in tips:
        if not is_tip(at, ids, wall_start, walls, tip):
            continue
        unit = 0
        for q in range(way_start[tip], way_start[tip + 1]):
            unit = max(unit, cell[ways[q]])
        n = near(at, ids, way_start, ways, tip, LONGEST_CELLS * unit, met, tip, reached)
        n_ends, longest = 0, 0
        for k in range(1, n):  # the first is the tip itself
            length, to = reached[k, LENGTH], reached[k, VERTEX]
            dy, dx = at[to, 0] - at[tip, 0], at[to, 1] - at[tip, 1]
            if 5 * (length - unit) > BEND_FIFTHS * (abs(dy) + abs(dx)) or wall_start[to] == wall_start[to + 1]:
                continue
            away = True
            for q in range(wall_start[tip], wall_start[tip + 1]):
                a = ids[walls[q], 0] + ids[walls[q], 1] - tip
                if (at[a, 0] - at[tip, 0]) * dy + (at[a, 1] - at[tip, 1]) * dx > 0:
                    away = False
                    break
            if away:
                candidates[n_ends] = k
                n_ends += 1
                longest = max(longest, length)
        if n_ends == 0:
            continue
        n_own = near(at, ids, wall_start, walls, tip, DETOUR * longest, met_own, tip, own)
        for e in range(n_ends):  # nearest first
            k = candidates[e]
            detour = -1
            for m in range(n_own):
                if own[m, VERTEX] == reached[k, VERTEX]:
                    detour = own[m, LENGTH]
                    break
            if detour < 0 or detour > DETOUR * reached[k, LENGTH]:
                while k > 0:
                    found[reached[k, PIECE]] = True
                    k = reached[k, BEFORE]
                break
    return found
