"""The independent verifier: whether a vector map keeps what the vectorizer promises about a grid.

It shares no code with the vectorizer. Distances are decided exactly (``verify_cover``), faces and crossings
by integers (``verify_faces``); nothing is sampled.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.errors import ConfigError
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN
from fleetmap.model.vectormap import FRONTIER_LABELS, HIDDEN_LABELS, OBSTACLE_LABELS, VectorMap
from fleetmap.vectorize.verify_cells import GridCells
from fleetmap.vectorize.verify_components import find_component_defects
from fleetmap.vectorize.verify_cover import UNIT, first_gaps
from fleetmap.vectorize.verify_faces import find_crossings, find_faces

KINDS = (
    ("obstacle", OBSTACLE_LABELS, FREE, OCCUPIED),
    ("frontier", FRONTIER_LABELS, FREE, UNKNOWN),
    ("hidden", HIDDEN_LABELS, OCCUPIED, UNKNOWN),
)


@dataclass(frozen=True, slots=True)
class Violation:
    """One broken promise.

    ``kind`` is ``uncovered`` (boundary of the grid without an edge near), ``astray`` (edge without boundary
    near), ``crossing``, ``sides`` (a face that is free for one edge and not for another) or ``components``.
    ``place_xy_m`` is in the submap's frame.
    """

    kind: str
    place_xy_m: tuple[float, float]
    detail: str


@dataclass(frozen=True, slots=True)
class Dropped:
    """Specks of the grid whose boundary is not in the map: how many, and their area in all."""

    count: int
    cells: int
    area_m2: float


@dataclass(frozen=True, slots=True)
class VerifyReport:
    """What ``verify`` found."""

    violations: tuple[Violation, ...]
    dropped: Dropped

    @property
    def valid(self) -> bool:
        """Whether every promise holds."""
        return not self.violations


def verify(
    grid: OccupancyGrid,
    vector_map: VectorMap,
    *,
    points: Literal["boundary", "centres"] = "boundary",
    specks: int = 12,
) -> VerifyReport:
    """Check a vector map against the grid that it was made from.

    1. Every point of the boundary between free space and occupied (unknown) cells is at most epsilon away
       from an obstacle (frontier) edge: ``uncovered``.
    2. Every point of an edge is at most epsilon away from boundary of its own kind: ``astray``. For backs of
       walls, which only this test is about, that is the boundary between occupied and unknown.
    3. Edges meet only at vertices: ``crossing``.
    4. All edges agree which faces are free (``sides``), and the free faces are the components of free cells
       (``components``; components are 4-connected, and specks are those of at most ``specks`` cells):

       a. Every component of free cells that is no speck lies in exactly one free face, the whole of it; only
          cells within epsilon of what is not free may lie elsewhere.
       b. Components that share a face are connected there: at corners whose two other cells are not occupied (a
          beam leaves cells that meet so, and the vectorizer makes one sliver of them), through free specks, or
          through unknown specks that the map has made free there. Never through occupied cells, nor at a corner
          beside one: a hole in a wall is a violation. Nothing demands that components which meet at a corner
          share a face.
       c. A free face without such a component is where a free speck is, and each has a speck of its own.

    Epsilon is the map's own; a distance of exactly epsilon is legal. What lies outside of the grid is unknown.
    The grid may have any phase on the map's lattice: it stands at its true offset, in sixteenths of a cell.

    Parameters
    ----------
    points : ``boundary`` tests the boundary as above. ``centres`` is the paper's reading, for obstacles alone:
        the points to be near are the centres of the occupied cells that touch a free one, if only by a
        corner; each must be near an obstacle edge, and obstacle edges near such centres.
    specks : free or unknown 4-connected components of at most so many cells may be missing from the map, or
        have become anything in it; those that are missing are listed as ``dropped``

    Raises
    ------
    ConfigError : the grid has another resolution or yaw than the map, or ``points`` is neither of both
    """
    if points not in ("boundary", "centres"):
        raise ConfigError(option="points", value=points, reason="expected 'boundary' or 'centres'")
    cells = GridCells(grid, vector_map, specks)
    epsilon2 = Fraction(round(vector_map.epsilon_cells**2 * 2**20), 2**20)  # exactly 2 for sqrt(2)
    edges = vector_map.edges.astype(np.int64)
    violations: list[Violation] = []

    def report(kind: str, at_yx: Iterable[NDArray[np.float64]], detail: str) -> None:
        for y, x in at_yx:
            place = vector_map.lattice.T_frame_lattice.to_pose().apply(
                np.array([x, y]) * vector_map.lattice.resolution_m
            )
            violations.append(Violation(kind, (float(place[0]), float(place[1])), detail))

    def report_gaps(kind: str, detail: str, segments: NDArray[np.int64], others: NDArray[np.int64]) -> None:
        gaps = first_gaps(segments, others, epsilon2)
        bad = ~np.isnan(gaps)
        start, end = segments[bad, :2] / UNIT, segments[bad, 2:] / UNIT
        report(kind, start + gaps[bad, None] * (end - start), f"{detail} within {vector_map.epsilon_cells:.4g} cells")

    # 1. and 2. Distances, both ways, kind by kind.
    edges_by_kind = {name: edges[np.isin(edges[:, 4], labels), :4] * UNIT for name, labels, _, _ in KINDS}
    for name, _, a, b in KINDS:
        of_kind = edges_by_kind[name]
        certain, possible = cells.boundary(a, b, certain=True), cells.boundary(a, b, certain=False)
        if points == "centres":
            if name != "obstacle":
                continue
            certain = possible = cells.obstacle_centres()
        if name != "hidden":
            report_gaps("uncovered", f"no {name} edge", certain, of_kind)
        report_gaps("astray", f"{name} edge without such a boundary", of_kind, possible)

    # 3. Crossings.
    crossings = find_crossings(edges[:, :4])
    report("crossing", edges[crossings[:, 0], :2].astype(np.float64), "edge meets another one beside a vertex")

    # 4. Faces; with crossings there are none to speak of.
    if len(crossings) == 0 and len(edges) > 0:
        faces = find_faces(edges[:, :4])
        beside = np.concatenate([faces.left, faces.right])
        state = np.concatenate([edges[:, 4] // 3, edges[:, 4] % 3])
        is_free = np.bincount(beside[state == FREE], minlength=faces.count) > 0
        not_free = np.bincount(beside[state != FREE], minlength=faces.count) > 0
        not_free[faces.outside] = True
        for face in np.flatnonzero(is_free & not_free):
            sides_free = np.flatnonzero((beside == face) & (state == FREE))
            sides_not = np.flatnonzero((beside == face) & (state != FREE))
            odd = sides_not if 0 < len(sides_not) < len(sides_free) else sides_free
            detail = f"{len(sides_free)} edges have free space in this face, {len(sides_not)} others something else"
            report("sides", edges[odd[:1] % len(edges), :2].astype(np.float64), detail)
        if not (is_free & not_free).any():
            for detail, place in find_component_defects(cells, edges[:, :4] * UNIT, faces, is_free):
                report("components", [place], detail)

    lost = cells.lost_specks(edges_by_kind["obstacle"], edges_by_kind["frontier"], epsilon2)
    area_m2 = int(lost.sum()) * grid.resolution_m**2
    return VerifyReport(tuple(violations), Dropped(len(lost), int(lost.sum()), area_m2))
