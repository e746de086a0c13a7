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

from fleetmap.model.checks import check_type
from fleetmap.model.errors import ConfigError
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN
from fleetmap.model.vectormap import FRONTIER_LABELS, HIDDEN_LABELS, OBSTACLE_LABELS, THICKNESS_PER_CELL, VectorMap
from fleetmap.vectorize.rasterize import rasterize
from fleetmap.vectorize.verify_cells import GridCells, place_on_lattice
from fleetmap.vectorize.verify_components import find_component_defects
from fleetmap.vectorize.verify_cover import UNIT, first_gaps
from fleetmap.vectorize.verify_faces import find_crossings, find_faces, find_odd_outlines, find_states
from fleetmap.verify import find_openings

KINDS = (
    ("obstacle", OBSTACLE_LABELS, FREE, OCCUPIED),
    ("frontier", FRONTIER_LABELS, FREE, UNKNOWN),
    ("hidden", HIDDEN_LABELS, OCCUPIED, UNKNOWN),
)


@dataclass(frozen=True, slots=True)
class Violation:
    """One broken promise.

    ``kind`` is ``uncovered`` (boundary of the grid without an edge near), ``astray`` (edge without boundary
    near), ``lost`` (an obstacle of which there is no edge), ``crossing``, ``sides`` (a face that has one state for
    one edge and another for another), ``identity`` (cells in a face of another state), ``components``, or ``opened`` (a
    wall that the drawn grid opens).
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
    drawn: OccupancyGrid | None = None,
) -> VerifyReport:
    """Check a vector map against the grid that it was made from.

    1. Every point of the boundary between free space and occupied (unknown) cells is at most epsilon away
       from an obstacle (frontier) edge: ``uncovered``. So is, but for the profile ``share``, every point of the
       boundary between occupied and unknown from a hidden edge.
    2. Every point of an edge is at most epsilon away from boundary of its own kind: ``astray``.
    3. Edges meet only at vertices: ``crossing``.
    4. All edges agree which faces are free, occupied and unknown (``sides``). In ``share`` nothing separates what
       is occupied from what is unknown: all edges agree which faces are free, and the hidden ones that hang together
       what they enclose: an obstacle, or a hole in one.
    5. Cells whose centre is more than epsilon away from all cells of other states lie in a face of their state
       (``identity``); in ``exact``, where epsilon is less than half a cell, these are all cells. In ``share``
       occupied and unknown are one state here, and free cells are left to the next test.
    6. The free faces are the components of free cells (``components``; components are 4-connected, and specks are
       those of at most ``specks`` cells):

       a. Every component of free cells that is no speck lies in exactly one free face, the whole of it; only
          cells within epsilon of what is not free may lie elsewhere.
       b. Components that share a face are connected there: at corners whose two other cells are not occupied (a
          beam leaves cells that meet so, and the vectorizer makes one sliver of them), through free specks, or
          through unknown specks that the map has made free there. Never through occupied cells, nor at a corner
          beside one: a hole in a wall is a violation. Nothing demands that components which meet at a corner
          share a face.
       c. A free face without such a component is where a free speck is, and each has a speck of its own.
    7. Every obstacle, an 8-connected component of occupied cells, has a point of its boundary at most epsilon away
       from an obstacle or hidden edge, or a cell in an occupied face: else it is ``lost``. In ``share``, where one
       can't tell which specks have become occupied, specks that are not in a free face may connect obstacles.
    8. In the grid that is drawn from the map (``rasterize``), no 4-connected path of cells that aren't blocked leads
       from one side of an obstacle edge to the other but around its ends, or through a gap: else the wall is
       ``opened`` there (see ``fleetmap.verify.drawn``).

    Epsilon is the map's own; a distance of exactly epsilon is legal. What lies outside of the grid is unknown.
    The grid may have any phase on the map's lattice: it stands at its true offset, in sixteenths of a cell.

    Parameters
    ----------
    points : ``boundary`` tests the boundary as above. ``centres`` is the paper's reading, for obstacles alone:
        the points to be near are the centres of the occupied cells that touch a free one, if only by a
        corner; each must be near an obstacle edge, and obstacle edges near such centres. 5. is left out.
    specks : free or unknown 4-connected components of at most so many cells may be missing from the map, or
        have become anything in it; those that are missing are listed as ``dropped``. In ``exact`` there are none.
    drawn : a grid that was drawn from the map, to be checked in place of ``rasterize(vector_map, like=grid)``

    Raises
    ------
    ConfigError : a grid has another resolution or yaw than the map, ``points`` is neither of both, or one of the maps
        is something else
    """
    if points not in ("boundary", "centres"):
        raise ConfigError(option="points", value=points, reason="expected 'boundary' or 'centres'")
    check_type("grid", grid, OccupancyGrid)
    check_type("vector_map", vector_map, VectorMap)
    share, exact = vector_map.profile == "share", vector_map.profile == "exact"
    cells = GridCells(grid, vector_map, 0 if exact else specks)
    epsilon2 = Fraction(round(vector_map.epsilon_cells**2 * 2**20), 2**20)  # exactly 2 for sqrt(2)
    edges = vector_map.edges.astype(np.int64)
    segments = edges[:, :4] * UNIT
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
    label = edges[:, 4]
    edges_by_kind = {name: segments[(label == ab) | (label == ba)] for name, (ab, ba), _, _ in KINDS}
    for name, _, a, b in KINDS:
        if points == "centres":
            if name != "obstacle":
                continue
            certain = possible = cells.obstacle_centres()
        else:
            certain, possible = cells.boundary(a, b, certain=True), cells.boundary(a, b, certain=False)
        if name != "hidden" or not share:
            report_gaps("uncovered", f"no {name} edge", certain, edges_by_kind[name])
        report_gaps("astray", f"{name} edge without such a boundary", edges_by_kind[name], possible)

    # 3. Crossings; with them there are no faces to speak of.
    crossings = find_crossings(edges[:, :4])
    report("crossing", edges[crossings[:, 1], :2].astype(np.float64), "edge meets another one beside a vertex")

    # 4. to 6. Faces.
    in_state: NDArray[np.uint8] | None = None
    if len(crossings) == 0:
        encloses = vector_map.thickness == 0
        defects, in_state = _find_face_defects(cells, edges, encloses, share=share, identity=points == "boundary")
        for kind, place, detail in defects:
            report(kind, [place], detail)

    # 7. Obstacles.
    known = np.concatenate([edges_by_kind["obstacle"], edges_by_kind["hidden"]])
    nowhere = np.zeros_like(cells.in_speck)
    found = nowhere if in_state is None else in_state == OCCUPIED
    also = nowhere
    if share:
        also = cells.in_speck if in_state is None else cells.in_speck & (in_state != FREE)
    report("lost", cells.lost_obstacles(known, epsilon2, also=also, found=found), "no edge of this obstacle")

    # 8. The drawn grid.
    drawn = rasterize(vector_map, like=grid) if drawn is None else drawn
    left, right = np.divmod(edges[:, 4], 3)
    origin_y, origin_x = place_on_lattice(drawn, vector_map).tolist()
    openings = find_openings(
        segments,
        left,
        right,
        np.where(vector_map.obstacle, vector_map.thickness.astype(np.int64) * (UNIT // THICKNESS_PER_CELL), -1),
        cell=UNIT,
        origin_yx=(origin_y, origin_x),
        blocked=drawn.states_yx() == OCCUPIED,
    )
    report("opened", openings / UNIT, "the drawn grid lets a path through the wall")

    dropped = cells.dropped_specks(
        {(a, b): edges_by_kind[name] for name, _, a, b in KINDS[: 2 if share else 3]}, epsilon2
    )
    area_m2 = int(dropped.sum()) * grid.resolution_m**2
    return VerifyReport(tuple(violations), Dropped(len(dropped), int(dropped.sum()), area_m2))


def _find_face_defects(
    cells: GridCells, edges: NDArray[np.int64], encloses: NDArray[np.bool_], *, share: bool, identity: bool
) -> tuple[list[tuple[str, NDArray[np.float64], str]], NDArray[np.uint8] | None]:
    """What is wrong with the faces of edges that don't cross, (kind, (y, x) in cells of the lattice, detail).

    Beside it the state of the face that each cell's centre lies in, unless edges disagree about that. Hidden edges of
    ``share`` that are as thick as they say needn't enclose anything.
    """
    left, right = np.divmod(edges[:, 4], 3)
    by_cell = cells.states
    found: list[tuple[str, NDArray[np.float64], str]] = []
    if share:
        hidden = np.flatnonzero((left != FREE) & (right != FREE) & encloses)
        for edge, detail in find_odd_outlines(edges[hidden, :4], left[hidden], right[hidden]):
            found.append(("sides", edges[hidden[edge], :2].astype(np.float64), detail))
        left, right, by_cell = (np.where(s == FREE, s, UNKNOWN).astype(s.dtype) for s in (left, right, by_cell))
    faces = find_faces(edges[:, :4])
    states, odd = find_states(faces, left, right)
    found += [("sides", edges[edge, :2].astype(np.float64), detail) for edge, detail in odd]
    if odd:
        return found, None

    deep = cells.deep(by_cell)
    segments = edges[:, :4] * UNIT
    face_of = cells.faces_of_cells(segments, faces)
    in_state = states.astype(np.uint8)[face_of]
    if identity:
        wrong = deep & (in_state != by_cell)
        if share:
            wrong &= by_cell != FREE
        detail = "cells lie in a face of another state"
        found += [("identity", place, detail) for place in cells.first_of_groups(wrong)]
    for detail, place in find_component_defects(cells, segments, faces, states == FREE, face_of, deep):
        found.append(("components", place, detail))
    return found, in_state
