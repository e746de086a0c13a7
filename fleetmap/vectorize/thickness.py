"""How deep the obstacle behind each edge is known to be, in quarters of a cell."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.vectormap import OBSTACLE_LABELS, THICKNESS_PER_CELL
from fleetmap.vectorize.boundary import Boundary
from fleetmap.vectorize.simplify import Chains

QUANTUM = 2
"""New values are multiples of half a cell: finer ones cost bytes and show nothing."""

AREA_FACTOR = 1.2
"""A wall may be painted over so many times the area of its cells: more would fill what lies between the crumbs
behind a ragged wall (measured on 21 real maps: less costs OPDF, more costs OPDF_reverse)."""

CHANGE_CELLS, CHANGE_RATIO = 1.0, 0.3
"""An edge that was kept also keeps its thickness until it is off by so much: each change costs bytes."""


def measure_thickness(boundary: Boundary, chains: Chains, edge_of: NDArray[np.int64]) -> NDArray[np.int64]:
    """Measure (v,) thickness, at least a cell on obstacle edges and 0 on all others.

    The cells of a wall of thickness d lie half of d from its surface on average, so d is twice the mean
    distance of the cells behind an edge; but not so deep that much more is painted than there are cells.
    """
    count = len(chains.at)
    edge = edge_of[boundary.wall_owners]
    tail, head = chains.at[edge].astype(np.float64), chains.at[chains.following[edge]].astype(np.float64)
    # Distance of each cell's centre from the edge that owns it, in cells.
    centre = boundary.wall_cells + 0.5 + np.array(boundary.phase_yx) / 16
    along = head - tail
    t = np.clip(((centre - tail) * along).sum(axis=1) / (along**2).sum(axis=1), 0, 1)
    off = centre - tail - t[:, None] * along
    cells = np.bincount(edge, minlength=count)
    distance = np.bincount(edge, np.hypot(off[:, 0], off[:, 1]), minlength=count)
    step = chains.at[chains.following] - chains.at
    length = np.hypot(step[:, 0], step[:, 1])
    depth = np.minimum(2 * distance / np.maximum(cells, 1), np.maximum(AREA_FACTOR * cells / length, 1))

    fresh = QUANTUM * np.rint(np.maximum(depth, 1) * THICKNESS_PER_CELL / QUANTUM).astype(np.int64)
    known = chains.thickness
    change = np.abs(depth * THICKNESS_PER_CELL - known)
    keep = (known > 0) & (change < np.maximum(CHANGE_CELLS * THICKNESS_PER_CELL, CHANGE_RATIO * known))
    thickness = np.where(keep, known, np.minimum(fresh, 255))
    return np.where(np.isin(chains.labels, OBSTACLE_LABELS), thickness, 0)
