"""``VectorMap``: the graph <V, E> of the paper, as a set of labelled edges on an epoch's lattice."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.errors import MapFormatError
from fleetmap.model.hashing import hash_ints, hash_rows, sum_mod64
from fleetmap.model.lattice import EPSILON_CELLS, FREE, MAX_COORDINATE, OCCUPIED, UNKNOWN, Lattice

if TYPE_CHECKING:
    import networkx as nx

    from fleetmap.model.arcs import Arcs

SALT_HEADER, SALT_EDGE, SALT_THICKNESS = 1, 2, 3

THICKNESS_PER_CELL = 4
"""Unit of ``thickness``: a quarter of a cell."""


def make_label(left: int, right: int) -> int:
    """The label of an edge: the states to the left and right of it, seen from its lower endpoint."""
    return 3 * left + right


OBSTACLE_LABELS = (make_label(FREE, OCCUPIED), make_label(OCCUPIED, FREE))
FRONTIER_LABELS = (make_label(FREE, UNKNOWN), make_label(UNKNOWN, FREE))
HIDDEN_LABELS = (make_label(OCCUPIED, UNKNOWN), make_label(UNKNOWN, OCCUPIED))
"""Backs of walls: only in the profiles ``full`` and ``exact``."""


@dataclass(frozen=True, eq=False)
class VectorMap:
    """Labelled edges that delimit free space.

    Parameters
    ----------
    lattice : where the integer lattice lies in its frame
    edges : (n, 5) int32 rows (y0, x0, y1, x1, label), a set in canonical order: (y0, x0) < (y1, x1),
        rows ascending, no row twice; label = 3 * left + right with the states FREE, OCCUPIED, UNKNOWN of
        the sides of the edge seen from (y0, x0) towards (y1, x1), x right and y up. Any order is taken.
    thickness : (n,) uint8, quarters of a cell: how deep the obstacle behind the edge is known to be; 0 on
        frontiers. Beside the edges, not part of their identity.
    epsilon_cells : the bound that the vectorizer certified, in cells
    profile : ``share`` (the boundary of free space), ``full`` (all boundaries) or ``exact``

    Raises
    ------
    MapFormatError : wrong shape, coordinate, label or thickness
    """

    lattice: Lattice
    edges: NDArray[np.int32]
    thickness: NDArray[np.uint8]
    epsilon_cells: float = EPSILON_CELLS
    profile: str = "share"
    digest: int = field(init=False)

    def __post_init__(self) -> None:
        edges, thickness = canonical_edges(self.edges, self.thickness)
        object.__setattr__(self, "edges", edges)
        object.__setattr__(self, "thickness", thickness)
        object.__setattr__(self, "digest", self._digest())

    @classmethod
    def empty(cls, lattice: Lattice, *, epsilon_cells: float = EPSILON_CELLS, profile: str = "share") -> VectorMap:
        """A map without edges: what a snapshot is a delta from."""
        return cls(lattice, np.zeros((0, 5), np.int32), np.zeros(0, np.uint8), epsilon_cells, profile)

    def __len__(self) -> int:
        return len(self.edges)

    @property
    def obstacle(self) -> NDArray[np.bool_]:
        """(n,) which edges are obstacles (free against occupied)."""
        return np.isin(self.edges[:, 4], OBSTACLE_LABELS)

    @property
    def frontier(self) -> NDArray[np.bool_]:
        """(n,) which edges are frontiers (free against unknown)."""
        return np.isin(self.edges[:, 4], FRONTIER_LABELS)

    @property
    def segments_xy(self) -> NDArray[np.float64]:
        """(n, 2, 2) metres: endpoints (x, y) of the edges in the submap's frame."""
        return self.lattice.to_metres(self.edges[:, :4].reshape(-1, 2, 2))

    def count_vertices(self) -> int:
        """How many different endpoints the edges have: |V|."""
        return len(np.unique(self.edges[:, :4].reshape(-1, 2), axis=0))

    def arcs(self) -> Arcs:
        """Maximal chains of one label between vertices of degree other than 2 (see ``model.arcs``)."""
        from fleetmap.model.arcs import find_arcs

        return find_arcs(self.edges)

    def to_networkx(self) -> nx.Graph:
        """The graph <V, E>: nodes (y, x) with ``pos`` in metres, edges with ``label``, ``weight`` in metres."""
        import networkx as nx

        graph: nx.Graph = nx.Graph(resolution_m=self.lattice.resolution_m, epsilon_cells=self.epsilon_cells)
        for (y0, x0, y1, x1, label), (a, b) in zip(self.edges.tolist(), self.segments_xy, strict=True):
            graph.add_node((y0, x0), pos=(float(a[0]), float(a[1])))
            graph.add_node((y1, x1), pos=(float(b[0]), float(b[1])))
            graph.add_edge(
                (y0, x0),
                (y1, x1),
                label=label,
                obstacle=label in OBSTACLE_LABELS,
                weight=float(np.hypot(*(b - a))),
            )
        return graph

    def _digest(self) -> int:
        pose = self.lattice.T_frame_lattice
        header = (self.lattice.resolution_um, pose.x_um, pose.y_um, pose.cos_q30, pose.sin_q30)
        rows = np.column_stack([self.edges, self.thickness])[self.thickness > 0]
        total = (
            hash_ints(header, SALT_HEADER)
            + sum_mod64(hash_rows(self.edges, SALT_EDGE))
            + sum_mod64(hash_rows(rows, SALT_THICKNESS))
        )
        return total & ((1 << 64) - 1)


def canonical_edges(
    edges: NDArray[np.int32], thickness: NDArray[np.uint8]
) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
    """Check edges, turn each with its lower endpoint first, sort them, and drop repeated ones."""

    def refuse(reason: str) -> MapFormatError:
        return MapFormatError(path="<array>", field="edges", reason=reason)

    edges, thickness = np.asarray(edges), np.asarray(thickness)
    if edges.ndim != 2 or edges.shape[1] != 5 or edges.dtype.kind not in "iu":
        raise refuse(f"expected (n, 5) integers; found {edges.shape} {edges.dtype}")
    if thickness.shape != (len(edges),) or thickness.dtype.kind not in "iu":
        raise refuse(f"expected ({len(edges)},) integers as thickness; found {thickness.shape} {thickness.dtype}")
    if len(edges) == 0:
        return np.zeros((0, 5), np.int32), np.zeros(0, np.uint8)
    if thickness.min() < 0 or thickness.max() > 255:
        raise refuse("a thickness is not in 0 to 255 quarters of a cell")
    rows = edges.astype(np.int64)
    if np.abs(rows[:, :4]).max() > MAX_COORDINATE:
        raise refuse(f"a coordinate is farther than {MAX_COORDINATE} cells from the lattice's origin")
    left, right = np.divmod(rows[:, 4], 3)
    if rows[:, 4].min() < 0 or rows[:, 4].max() > 8 or (left == right).any():
        raise refuse("a label is not 3 * left + right with two different states")
    y0, x0, y1, x1 = rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 3]
    if ((y0 == y1) & (x0 == x1)).any():
        raise refuse("an edge has no length")
    turned = (y0 > y1) | ((y0 == y1) & (x0 > x1))
    rows[turned] = np.column_stack([y1, x1, y0, x0, 3 * right + left])[turned]
    order = np.lexsort((rows[:, 4], rows[:, 3], rows[:, 2], rows[:, 1], rows[:, 0]))
    rows, thickness = rows[order], thickness[order]
    first = np.ones(len(rows), bool)
    first[1:] = (rows[1:] != rows[:-1]).any(axis=1)
    return rows[first].astype(np.int32), thickness[first].astype(np.uint8)
