"""Edges as chains: walks that visit each edge once, so that a vertex costs one step and not two endpoints."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.arcs import flip

DIRECTED_LABELS = (1, 2, 5)
"""Free | occupied, free | unknown, occupied | unknown: every edge is walked with the lesser label, so that free
space lies to the left and the walks run around it."""


@dataclass(frozen=True, slots=True, eq=False)
class Chain:
    """Edges of one label, end to end; ``continues`` where the chain before it ended.

    ``points`` are (y, x); ``edges`` holds the index of each edge.
    """

    label: int
    points: list[tuple[int, int]]
    edges: list[int]
    continues: bool


def find_chains(edges: NDArray[np.int32], known: Iterable[tuple[int, int]]) -> list[Chain]:
    """Cover each edge, (n, 5), by one chain; chains that start at a ``known`` vertex come first.

    A walk goes on as long as an unused edge leaves its last vertex, and a new chain starts where the label
    changes. Walks start where more edges leave than arrive, then wherever unused edges remain, known vertices
    first and each group in ascending order: the same edges give the same chains.
    """
    leaving: defaultdict[tuple[int, int], list[tuple[int, tuple[int, int], int]]] = defaultdict(list)
    surplus: defaultdict[tuple[int, int], int] = defaultdict(int)
    for i, (y0, x0, y1, x1, label) in enumerate(edges.tolist()):
        a, b = ((y0, x0), (y1, x1)) if label < flip(label) else ((y1, x1), (y0, x0))
        leaving[a].append((min(label, flip(label)), b, i))
        surplus[a] += 1
        surplus[b] -= 1
    for around in leaving.values():
        around.sort(reverse=True)

    def walk(vertex: tuple[int, int]) -> list[Chain]:
        chains: list[Chain] = []
        label = 0
        while leaving[vertex]:
            around = leaving[vertex]
            # Going on with the same label saves a chain; otherwise the least edge goes first.
            pick = next((k for k in range(len(around) - 1, -1, -1) if around[k][0] == label), len(around) - 1)
            edge_label, end, i = around.pop(pick)
            if edge_label != label:
                label = edge_label
                chains.append(Chain(label, [vertex], [], bool(chains)))
            chains[-1].points.append(end)
            chains[-1].edges.append(i)
            vertex = end
        return chains

    known_set = set(known)
    tails = sorted(v for v in leaving if surplus[v] > 0)
    loops = sorted(leaving)
    walks: list[list[Chain]] = []
    for starts in (tails, loops):
        for group in (True, False):
            for vertex in starts:
                while (vertex in known_set) is group and leaving[vertex]:
                    walks.append(walk(vertex))
                    if starts is tails and surplus[vertex] <= 1:
                        break
                    surplus[vertex] -= 1
    walks.sort(key=lambda chains: (chains[0].points[0] not in known_set, chains[0].points[0]))
    return [chain for chains in walks for chain in chains]
