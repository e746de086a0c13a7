"""The arcs of a boundary and the vertices chosen along them: what kernels fill and read."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(slots=True, eq=False)
class Arcs:
    """Corners of one arc after the other, and which of them are vertices.

    Parameters
    ----------
    points : (n, 2) int32 lattice points (y, x); an open arc has both its ends
    offsets : (k + 1,) int32; arc i has the points ``offsets[i]`` to ``offsets[i + 1]``
    labels, closed, thickness : (k,) uint8; thickness in quarters of a cell
    special : (n,) uint8 corners where more than two cracks meet
    ends : (2 k,) int32 records of the vertices at both ends of open arcs that stay as they are, else -1
    fixed, stops, kept : (n,) uint8 as ``build_network`` takes them
    old_of : (n,) int32 the record whose edge is kept from a corner on, or -1
    at : (n, 2) int32 where the vertices lie
    is_vertex : (n,) uint8
    """

    points: NDArray[np.int32]
    offsets: NDArray[np.int32]
    labels: NDArray[np.uint8]
    closed: NDArray[np.uint8]
    thickness: NDArray[np.uint8]
    special: NDArray[np.uint8]
    ends: NDArray[np.int32]
    fixed: NDArray[np.uint8]
    stops: NDArray[np.uint8]
    kept: NDArray[np.uint8]
    old_of: NDArray[np.int32]
    at: NDArray[np.int32]
    is_vertex: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.labels)

    @classmethod
    def untouched(
        cls,
        points: NDArray[np.int32],
        offsets: NDArray[np.int32],
        labels: NDArray[np.uint8],
        closed: NDArray[np.uint8],
        thickness: NDArray[np.uint8],
        special: NDArray[np.uint8],
    ) -> Arcs:
        """Arcs without any vertex yet."""
        n, k = len(points), len(labels)
        return cls(
            points, offsets, labels, closed, thickness, special, np.full(2 * k, -1, np.int32),
            np.zeros(n, np.uint8), np.zeros(n, np.uint8), np.zeros(n, np.uint8), np.full(n, -1, np.int32),
            points.copy(), np.zeros(n, np.uint8),
        )  # fmt: skip

    def build(
        self, cracks: NDArray[np.uint8], low_yx: tuple[int, int], phase_yx: tuple[int, int], epsilon2: int, choose2: int
    ) -> tuple[int, int]:
        """Choose the vertices; returns how many edges were split, or -1, and how many there were before.

        Edges hold if they are within ``epsilon2``; what is new is chosen within ``choose2``.
        """
        from fleetmap.vectorize.network_kernels import build_network

        splits, before = build_network(
            cracks, *low_yx, self.points, self.offsets, self.closed, self.labels, self.special, len(self), *phase_yx,
            epsilon2, choose2, self.fixed, self.stops, self.kept, self.at, self.is_vertex,
        )  # fmt: skip
        return int(splits), int(before)

    def edges(self) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
        """Edges as ``edge_kernels`` has them, with a row to spare; the corners of both ends; the arc of each."""
        from fleetmap.vectorize.edge_kernels import list_edges

        most = int(np.count_nonzero(self.is_vertex)) + 1
        tails, heads, arc_of = (np.empty(most, np.int32) for _ in range(3))
        edges = np.empty((most, 9), np.int64)
        count = list_edges(
            self.points, self.offsets, self.closed, len(self), self.at, self.is_vertex, tails, heads, arc_of, edges
        )
        return edges[: count + 1], tails[:count], heads[:count], arc_of[:count]
