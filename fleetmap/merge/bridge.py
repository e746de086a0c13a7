"""Part of step 5: of second sights that would go, those stay that close a hole.

Where two sights of a thin wall cross, they are one wall up to the crossing, a wedge whose tip lies there, and side by
side beyond it. Each sight of the part beyond may lie within reach of the walls at both of its ends, and be explained
by them, though nothing is left between the tips.
"""

from __future__ import annotations

import heapq

import numpy as np
from numpy.typing import NDArray

from fleetmap.merge.arrange import pack, unpack

LONGEST_CELLS = 8
"""Holes are no longer than twice the reach of a second sight (6 cells), along the axes a little more."""

DETOUR = 3
"""Walls that stay lead around a hole, if at all, by a way that is at least so many times as long."""

MOST_VERTICES = 100
"""So many are looked at around a tip, so that nobody's map of dense crossings takes the time of all."""

BEND_FIFTHS = 6
"""What closes a hole goes on from the tip rather straight: its way is no longer than 6 / 5 of the distance, and a
cell."""


def bridges(
    ends: NDArray[np.int64], cell: NDArray[np.int64], stays: NDArray[np.bool_], gone: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Which of the walls that go lead on from the tip of one that stays to another one; (n,) bool.

    From each tip the shortest way is taken (the sum of |dy| + |dx|, ties by place) that leads away from the tip's own
    walls, and to where these lead by a long detour only, if at all. So the result doesn't depend on any order.

    Parameters
    ----------
    ends : (n, 4) int64 pieces, which meet only at vertices
    cell : (n,) size of a cell of the source of each, lattice steps
    stays, gone : (n,) boundaries that stay, and walls that would go
    """
    found = np.zeros(len(ends), bool)
    keys, ids = np.unique(pack(ends[stays | gone].reshape(-1, 2)), return_inverse=True)
    at: list[list[int]] = unpack(keys).tolist()
    all_ids = np.zeros((len(ends), 2), np.int64)
    all_ids[stays | gone] = ids.reshape(-1, 2)
    ways, walls = _Graph(at, all_ids, gone), _Graph(at, all_ids, stays)
    for tip in np.intersect1d(all_ids[gone], all_ids[stays]).tolist():
        away = [(at[to][0] - at[tip][0], at[to][1] - at[tip][1]) for to, _ in walls.next(tip)]
        if not _is_tip(away):
            continue
        unit = max(int(cell[k]) for _, k in ways.next(tip))
        ends_of_ways = []
        for to, (length, way) in ways.near(tip, LONGEST_CELLS * unit).items():
            dy, dx = at[to][0] - at[tip][0], at[to][1] - at[tip][1]
            straight = 5 * (length - unit) <= BEND_FIFTHS * (abs(dy) + abs(dx))
            if way and straight and walls.next(to) and all(ay * dy + ax * dx <= 0 for ay, ax in away):
                ends_of_ways.append((to, length, way))
        if ends_of_ways:
            own = walls.near(tip, DETOUR * max(length for _, length, _ in ends_of_ways))
            for to, length, way in ends_of_ways:  # nearest first
                if to not in own or own[to][0] > DETOUR * length:
                    found[list(way)] = True
                    break
    return found


def _is_tip(away: list[tuple[int, int]]) -> bool:
    """Whether all boundaries leave a vertex within a right angle: it is the end of a wall, or the tip of a wedge."""
    return all(ay * by + ax * bx > 0 for i, (ay, ax) in enumerate(away) for by, bx in away[:i])


class _Graph:
    """Some of the pieces, by their vertices, which are numbered in the order of their places."""

    def __init__(self, at: list[list[int]], ids: NDArray[np.int64], among: NDArray[np.bool_]) -> None:
        self._at = at
        pieces = np.flatnonzero(among)
        here, there = ids[pieces].T.ravel(), ids[pieces][:, ::-1].T.ravel()
        order = np.argsort(here, kind="stable")
        self._start: list[int] = np.searchsorted(here[order], np.arange(len(at) + 1)).tolist()
        self._next = list(zip(there[order].tolist(), np.tile(pieces, 2)[order].tolist(), strict=True))

    def next(self, vertex: int) -> list[tuple[int, int]]:
        """The other end of each piece at a vertex, and which piece it is."""
        return self._next[self._start[vertex] : self._start[vertex + 1]]

    def near(self, start: int, reach: int) -> dict[int, tuple[int, tuple[int, ...]]]:
        """The nearest vertices, at most ``reach`` along the pieces, in this order: how far, and by which pieces."""
        queue: list[tuple[int, int, tuple[int, ...]]] = [(0, start, ())]
        done: dict[int, tuple[int, tuple[int, ...]]] = {}
        while queue and len(done) < MOST_VERTICES:
            length, vertex, way = heapq.heappop(queue)
            if vertex in done:
                continue
            done[vertex] = length, way
            y, x = self._at[vertex]
            for to, k in self.next(vertex):
                longer = length + abs(self._at[to][0] - y) + abs(self._at[to][1] - x)
                if longer <= reach and to not in done:
                    heapq.heappush(queue, (longer, to, (*way, k)))
        return done
