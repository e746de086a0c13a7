"""``VectorMap``: the graph <V, E> of the paper, as a set of labelled edges on an epoch's lattice."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.bands import REASONS, Bands
from fleetmap.model.checks import check_type
from fleetmap.model.errors import MapFormatError
from fleetmap.model.hashing import hash_ints
from fleetmap.model.lattice import EPSILON_CELLS, FREE, OCCUPIED, UNKNOWN, Lattice

if TYPE_CHECKING:
    import networkx as nx

    from fleetmap.model.arcs import Arcs

SALT_HEADER = 1
"""Salt of the lattice in the digest; ``row_kernels`` has those of the edges."""

THICKNESS_PER_CELL = 4
"""Unit of ``thickness``: a quarter of a cell."""


def make_label(left: int, right: int) -> int:
    """The label of an edge: the states to the left and right of it, seen from its lower endpoint."""
    return 3 * left + right


OBSTACLE_LABELS = (make_label(FREE, OCCUPIED), make_label(OCCUPIED, FREE))
FRONTIER_LABELS = (make_label(FREE, UNKNOWN), make_label(UNKNOWN, FREE))
HIDDEN_LABELS = (make_label(OCCUPIED, UNKNOWN), make_label(UNKNOWN, OCCUPIED))
"""Backs of walls: only in the profiles ``full`` and ``exact``."""


class VectorMap:
    """Labelled edges that delimit free space; never changed once it is built.

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
    MapFormatError : wrong shape, type, coordinate, label or thickness
    ConfigError : ``lattice`` is none

    Notes
    -----
    Inside, the edges lie in bands (``model.bands``), which maps share that differ little; ``edges`` and ``thickness``
    are put together when they are first asked for.
    """

    __slots__ = (
        "__weakref__",
        "_bounds",
        "_digest",
        "_edges",
        "_thickness",
        "bands",
        "epsilon_cells",
        "lattice",
        "profile",
    )

    lattice: Lattice
    epsilon_cells: float
    profile: str
    bands: Bands
    _bounds: tuple[int, int, int, int] | None
    _digest: int | None
    _edges: NDArray[np.int32] | None
    _thickness: NDArray[np.uint8] | None

    def __init__(
        self,
        lattice: Lattice,
        edges: NDArray[np.int32],
        thickness: NDArray[np.uint8],
        epsilon_cells: float = EPSILON_CELLS,
        profile: str = "share",
    ) -> None:
        check_type("lattice", lattice, Lattice)
        rows = _checked_rows(edges, thickness)
        self._set(lattice, Bands.of(rows), epsilon_cells, profile, None)

    @classmethod
    def of_bands(
        cls, lattice: Lattice, bands: Bands, *, epsilon_cells: float, profile: str, digest: int | None = None
    ) -> VectorMap:
        """A map of bands that are known to be valid, and its digest if that is known; nothing is checked."""
        result = cls.__new__(cls)
        result._set(lattice, bands, epsilon_cells, profile, digest)
        return result

    @classmethod
    def of_rows(
        cls,
        lattice: Lattice,
        rows: NDArray[np.int32],
        *,
        epsilon_cells: float = EPSILON_CELLS,
        profile: str = "share",
    ) -> VectorMap:
        """A map of (n, 6) int32 rows (edge, thickness) that are known to be valid and in canonical order.

        Nothing is checked, and the rows are kept: they are the map's from now on.
        """
        return cls.of_bands(lattice, Bands.of(rows), epsilon_cells=epsilon_cells, profile=profile)

    @classmethod
    def empty(cls, lattice: Lattice, *, epsilon_cells: float = EPSILON_CELLS, profile: str = "share") -> VectorMap:
        """A map without edges: what a snapshot is a delta from."""
        return cls.of_bands(lattice, Bands((), ()), epsilon_cells=epsilon_cells, profile=profile)

    def _set(self, lattice: Lattice, bands: Bands, epsilon_cells: float, profile: str, digest: int | None) -> None:
        put = object.__setattr__
        put(self, "lattice", lattice)
        put(self, "bands", bands)
        put(self, "epsilon_cells", epsilon_cells)
        put(self, "profile", profile)
        put(self, "_bounds", None)
        put(self, "_digest", digest)
        put(self, "_edges", None)
        put(self, "_thickness", None)

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"a VectorMap is never changed: build another one to have another {name}")

    def __reduce__(self) -> tuple[object, ...]:
        return VectorMap, (self.lattice, self.edges, self.thickness, self.epsilon_cells, self.profile)

    def __repr__(self) -> str:
        return f"VectorMap({len(self)} edges, profile {self.profile!r}, digest {self.digest:016x})"

    @property
    def edges(self) -> NDArray[np.int32]:
        """(n, 5) int32 all edges, in canonical order."""
        edges = self._edges
        if edges is None:
            edges = self.bands.rows()[:, :5].copy()
            object.__setattr__(self, "_edges", edges)
        return edges

    @property
    def thickness(self) -> NDArray[np.uint8]:
        """(n,) uint8 the thickness of each edge, quarters of a cell."""
        thickness = self._thickness
        if thickness is None:
            thickness = self.bands.rows()[:, 5].astype(np.uint8)
            object.__setattr__(self, "_thickness", thickness)
        return thickness

    @property
    def bounds_yx(self) -> tuple[int, int, int, int] | None:
        """(y0, x0, y1, x1) least and largest lattice coordinates; None for a map without edges."""
        if self._bounds is None and len(self):
            low = np.min([part[:, :4].min(axis=0) for part in self.bands.parts], axis=0)
            high = np.max([part[:, :4].max(axis=0) for part in self.bands.parts], axis=0)
            bounds = (int(low[0]), int(min(low[1], low[3])), int(high[2]), int(max(high[1], high[3])))
            object.__setattr__(self, "_bounds", bounds)
        return self._bounds

    @property
    def digest(self) -> int:
        """The sum mod 2^64 over all edges and the lattice (``docs/format.md``)."""
        digest = self._digest
        if digest is None:
            from fleetmap.model.row_kernels import sum_of_hashes

            pose = self.lattice.T_frame_lattice
            header = (self.lattice.resolution_um, pose.x_um, pose.y_um, pose.cos_q30, pose.sin_q30)
            total = hash_ints(header, SALT_HEADER) + int(sum_of_hashes(self.bands.rows()))
            digest = total & ((1 << 64) - 1)
            object.__setattr__(self, "_digest", digest)
        return digest

    def __len__(self) -> int:
        return len(self.bands)

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


def _checked_rows(edges: NDArray[np.int32], thickness: NDArray[np.uint8]) -> NDArray[np.int32]:
    """(m, 6) rows: edges checked, each turned with its lower end first, sorted, repeated ones dropped."""
    from fleetmap.model.band_kernels import canonical_rows
    from fleetmap.model.row_kernels import GOOD

    edges, thickness = np.asarray(edges), np.asarray(thickness)
    if edges.ndim != 2 or edges.shape[1] != 5 or edges.dtype.kind not in "iu":
        reason = f"expected (n, 5) integers; found {edges.shape} {edges.dtype}"
    elif thickness.shape != (len(edges),) or thickness.dtype.kind not in "iu":
        reason = f"expected ({len(edges)},) integers as thickness; found {thickness.shape} {thickness.dtype}"
    else:
        found, rows = canonical_rows(_int64(edges), _int64(thickness))
        if found == GOOD:
            return rows
        reason = REASONS[found]
    raise MapFormatError(path="<array>", field="edges", reason=reason)


def _int64(values: NDArray[np.integer]) -> NDArray[np.int64]:
    """A copy; what is too large for it becomes its largest number, which no bound lets pass, and not a negative one."""
    if values.dtype == np.uint64:
        values = np.minimum(values, np.uint64(np.iinfo(np.int64).max))
    return np.array(values, np.int64, order="C")
