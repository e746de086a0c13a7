"""What an aligner sees of a map: points along its walls, with the direction to free space, and where it knows what.

The free side of a wall is known, so that directions count over the whole circle: a map has no twin that is turned by
180 degrees.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import FREE, UNKNOWN
from fleetmap.model.vectormap import OBSTACLE_LABELS, VectorMap

Floats = NDArray[np.float64]

SPACING_M = 0.2
"""Between two points of a wall."""
CELL_M = 0.1
"""Of the rasters in which free space is looked up."""
DIRECTION_M = 1.0
"""What a right angle between two walls counts as, as a distance, when the nearest wall is looked for."""


@dataclass(frozen=True, eq=False)
class Walls:
    """A map's walls, sampled.

    Parameters
    ----------
    points_xy : (n, 2) metres
    normals_xy : (n, 2) unit vectors into free space
    lengths_m : (n,) how much wall each point stands for
    states_yx, corner_xy : the map's states in cells of ``CELL_M``, and where its lower left corner lies, in metres
    """

    points_xy: Floats
    normals_xy: Floats
    lengths_m: Floats
    states_yx: NDArray[np.uint8]
    corner_xy: Floats

    @functools.cached_property
    def tree(self) -> cKDTree:
        """Points with their normals: near is what is near in place and faces alike."""
        return cKDTree(np.hstack([self.points_xy, DIRECTION_M * self.normals_xy]))

    @functools.cached_property
    def clearance_m(self) -> Floats:
        """(h, w) of free cells, how far the nearest cell is that isn't free; 0 elsewhere."""
        clear: Floats = ndimage.distance_transform_edt(self.states_yx == FREE) * CELL_M
        return clear

    def look_up(self, table: NDArray[Any], points_xy: Floats, outside: float) -> NDArray[Any]:
        """What a table of this map's cells has at some points (..., 2)."""
        cells = np.floor((points_xy - self.corner_xy) / CELL_M).astype(np.int64)
        height, width = table.shape
        column, row = cells[..., 0], cells[..., 1]
        inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
        found = table[np.where(inside, row, 0), np.where(inside, column, 0)]
        return np.where(inside, found, outside)


def walls_of(vector_map: VectorMap) -> Walls:
    """The walls of a vector map, in metres of its frame."""
    from fleetmap.vectorize import rasterize

    rows = vector_map.edges
    segments = vector_map.segments_xy[vector_map.obstacle]
    free_left = rows[vector_map.obstacle, 4] == OBSTACLE_LABELS[0]
    points, normals, lengths = sampled(segments, free_left)
    grid = rasterize(vector_map) if len(rows) else None
    states, corner = coarse(grid) if grid is not None else (np.full((1, 1), UNKNOWN, np.uint8), np.zeros(2))
    return Walls(points, normals, lengths, states, corner)


def sampled(segments: Floats, free_left: NDArray[np.bool_]) -> tuple[Floats, Floats, Floats]:
    """Points in the middles of equal parts of each segment (n, 2, 2), the normal and the length of each."""
    along = segments[:, 1] - segments[:, 0]
    length = np.hypot(along[:, 0], along[:, 1])
    parts = np.maximum(1, np.ceil(length / SPACING_M)).astype(np.int64)
    which = np.repeat(np.arange(len(segments)), parts)
    first = np.concatenate([[0], np.cumsum(parts)[:-1]]).astype(np.int64) if len(parts) else np.zeros(0, np.int64)
    part = (np.arange(len(which)) - first[which] + 0.5) / parts[which]
    points = segments[which, 0] + part[:, None] * along[which]
    unit = along / np.maximum(length, 1e-9)[:, None]
    left = np.stack([-unit[:, 1], unit[:, 0]], axis=-1)
    normals = np.where(free_left[:, None], left, -left)[which]
    return points, normals, (length / parts)[which]


def coarse(grid: OccupancyGrid) -> tuple[NDArray[np.uint8], Floats]:
    """The states of a grid in cells of ``CELL_M``, by their centres, and where the first one begins."""
    height, width = grid.height * grid.resolution_m, grid.width * grid.resolution_m
    corners = grid.origin.apply(np.array([(0, 0), (width, 0), (0, height), (width, height)], np.float64))
    low = np.floor(corners.min(axis=0) / CELL_M) * CELL_M
    columns, rows = np.ceil((corners.max(axis=0) - low) / CELL_M).astype(int)
    x, y = np.meshgrid(low[0] + (np.arange(columns) + 0.5) * CELL_M, low[1] + (np.arange(rows) + 0.5) * CELL_M)
    local = grid.origin.inverse().apply(np.stack([x, y], axis=-1).reshape(-1, 2)) / grid.resolution_m
    cell = np.floor(local).astype(np.int64)
    inside = (cell >= 0).all(axis=1) & (cell[:, 0] < grid.width) & (cell[:, 1] < grid.height)
    states = np.full(len(cell), UNKNOWN, np.uint8)
    states[inside] = grid.states_yx()[cell[inside, 1], cell[inside, 0]]
    return states.reshape(rows, columns), low


def rotated(yaw_rad: float, points_xy: Floats) -> Floats:
    """(..., 2) points turned about (0, 0)."""
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    turned: Floats = points_xy @ np.array([[c, s], [-s, c]])
    return turned
