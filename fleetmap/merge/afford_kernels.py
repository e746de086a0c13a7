"""Integer kernels that count what a fold would cost.

Why int64 suffices: the fold takes at most 2^21 entries (``afford.MOST_ENTRIES``), so that no sum of squares of how many
lie in a tile exceeds 2^42, and products of edges stay below 2^36 (``arrange_kernels``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.merge.arrange_kernels import crossing_in_tile
from fleetmap.model.kernel import kernel

Ints = NDArray[np.int64]


@kernel("int64(int64[:, ::1], int64[::1], int64[::1], int64[::1], int64)")
def count_crossings(ends: Ints, keys: Ints, start: Ints, items: Ints, most: int) -> int:
    """In how many points the insides of edges, lower end first, cross; it stops beyond ``most``.

    ``keys``, ``start``, ``items``: ``Tiles`` of the edges.
    """
    n = 0
    for t in range(len(keys)):
        for k in range(start[t], start[t + 1]):
            i = items[k]
            x_high = max(ends[i, 1], ends[i, 3])
            for m in range(k + 1, start[t + 1]):
                if min(ends[items[m], 1], ends[items[m], 3]) > x_high:
                    break
                if crossing_in_tile(ends, i, items[m], keys[t]):
                    n += 1
            if n > most:
                return n
    return n


@kernel(
    "Tuple((boolean[::1], int64))"
    "(int64[:, ::1], int64[::1], int64[::1], int64[::1], int64[::1], int64[::1], int64, int64, int64, int64, int64,"
    " int64)",
)
def take(
    ends: Ints,
    first_edge: Ints,
    first: Ints,
    tile: Ints,
    keys: Ints,
    items: Ints,
    room: int,
    source_cost: int,
    entry_cost: int,
    crossing_cost: int,
    crossed: int,
    few_crossings: int,
) -> tuple[NDArray[np.bool_], int]:
    """Which sources are taken, in this order, while there is room; and how much of it that takes.

    ``ends``: (n, 4) edges of all, lower end first; those of source s are ``first_edge[s]:first_edge[s + 1]``. Its
    entries are ``first[s]:first[s + 1]`` of ``tile``, ascending numbers of tiles, whose keys are ``keys``, and of
    ``items``, the edges. Costs and room are in tests; see ``afford`` for ``crossed`` and ``few_crossings``.
    """
    n_sources = len(first) - 1
    taken = np.zeros(n_sources, np.bool_)
    count = np.zeros(len(keys), np.int64)  # entries that were taken, by tile, and the last of them
    last = np.full(len(keys), -1)
    before = np.empty(len(items), np.int64)
    n_taken, spent = 0, 0
    for s in range(n_sources):
        tests = 0
        k = first[s]
        while k < first[s + 1]:
            end = k
            while end < first[s + 1] and tile[end] == tile[k]:
                end += 1
            tests += (end - k) * (end - k + 2 * count[tile[k]])
            k = end
        cost = source_cost + tests + entry_cost * (first[s + 1] - first[s])
        if spent + cost > room:
            continue
        most = few_crossings + crossed * (first_edge[s + 1] - first_edge[s]) * n_taken
        most = min(most, (room - spent - cost) // crossing_cost)
        n = 0
        for k in range(first[s], first[s + 1]):
            other = last[tile[k]]
            while other >= 0:
                if crossing_in_tile(ends, items[k], items[other], keys[tile[k]]):
                    n += 1
                other = before[other]
            if n > most:
                break
        if n > most:
            # What it took to find that out is spent: a test of these alone is an eighth of one in all steps.
            spent += tests >> 3
            continue
        for k in range(first[s], first[s + 1]):
            before[k], last[tile[k]] = last[tile[k]], k
            count[tile[k]] += 1
        taken[s] = True
        n_taken += 1
        spent += cost + crossing_cost * n
    return taken, spent
