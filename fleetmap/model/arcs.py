"""Arcs: the chains in which edges are encoded, simplified and drawn. Derived from the edge set, never stored."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Arcs:
    """Maximal chains of edges of one label between vertices of degree other than 2.

    Parameters
    ----------
    points_yx : (m, 2) int32 vertices of all arcs, one after the other; a closed arc repeats its first one
    offsets : (k + 1,) int64; arc i has the vertices ``points_yx[offsets[i]:offsets[i + 1]]``
    labels : (k,) label of each arc, seen along its own direction
    edge_index : (m - k,) int64 the edge behind each step, arc after arc
    """

    points_yx: NDArray[np.int32]
    offsets: NDArray[np.int64]
    labels: NDArray[np.int64]
    edge_index: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.labels)

    def points(self, i: int) -> NDArray[np.int32]:
        """(n, 2) vertices (y, x) of arc ``i``."""
        return self.points_yx[self.offsets[i] : self.offsets[i + 1]]


def flip(label: int) -> int:
    """The label of an edge seen from its other end: left and right change places."""
    left, right = divmod(label, 3)
    return 3 * right + left


def find_arcs(edges: NDArray[np.int32]) -> Arcs:
    """Chain edges, (n, 5) in canonical order, into arcs.

    Open arcs come first, in the order of their least end; closed ones follow, each from its least vertex
    along its first edge in canonical order. Pure: the same edges give the same arcs.
    """
    rows = edges.tolist()
    incident: defaultdict[tuple[int, int], list[int]] = defaultdict(list)
    for i, (y0, x0, y1, x1, _) in enumerate(rows):
        incident[y0, x0].append(i)
        incident[y1, x1].append(i)

    def label_from(i: int, vertex: tuple[int, int]) -> int:
        y0, x0, _, _, label = rows[i]
        return label if (y0, x0) == vertex else flip(label)

    def ends_arc(vertex: tuple[int, int]) -> bool:
        around = incident[vertex]
        # Leaving by one edge with its label reversed must look like leaving by the other one.
        return len(around) != 2 or label_from(around[0], vertex) != flip(label_from(around[1], vertex))

    used = [False] * len(rows)
    points: list[tuple[int, int]] = []
    offsets, labels, edge_index = [0], [], []

    def walk(start: tuple[int, int], i: int) -> None:
        labels.append(label_from(i, start))
        points.append(start)
        vertex = start
        while True:
            used[i] = True
            edge_index.append(i)
            y0, x0, y1, x1, _ = rows[i]
            vertex = (y1, x1) if (y0, x0) == vertex else (y0, x0)
            points.append(vertex)
            if vertex == start or ends_arc(vertex):
                break
            a, b = incident[vertex]
            i = b if a == i else a
        offsets.append(len(points))

    for vertex in sorted(v for v in incident if ends_arc(v)):
        for i in incident[vertex]:
            if not used[i]:
                walk(vertex, i)
    for i, (y0, x0, _, _, _) in enumerate(rows):
        if not used[i]:  # a loop; its least vertex is met first, since rows ascend
            walk((y0, x0), i)
    return Arcs(
        np.array(points, np.int32).reshape(-1, 2),
        np.array(offsets, np.int64),
        np.array(labels, np.int64),
        np.array(edge_index, np.int64),
    )
