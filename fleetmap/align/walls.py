"""What an aligner sees of a map: points along its walls, with the direction to free space, and where it knows what.

The free side of a wall is known, so that directions count over the whole circle: a map has no twin that is turned by
180 degrees.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError

from fleetmap.model.errors import ConfigError
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import FREE, UNKNOWN
from fleetmap.model.vectormap import OBSTACLE_LABELS, VectorMap

Floats = NDArray[np.float64]

SPACING_M = 0.2
"""Between two points of a wall."""
CELL_M = 0.1
"""Of the rasters in which free space is looked up."""
LOOSE_M, LASTING = 1.2, 0.1
"""What stands free and is no larger may have been moved: where the other map has it not, so much of it counts."""
INDEX_M = 0.3
"""Of the cells in which the nearest point is looked for."""
MOST_M2, MOST_CELLS = 360_000.0, 150_000_000
"""A map in a larger box, of square metres or its cells, takes gigabytes; two of 400 m by 400 m take 600 MB and 5 s."""


class Index(NamedTuple):
    """Points by the cell that they lie in, as ``match_kernels`` takes them.

    Parameters
    ----------
    table : (n, 6) x, y, normal x, normal y, metres of wall, and of that what lasts; sorted by cell
    start : the first row of each cell, row by row, and the number of points
    frame : x, y of the lower left corner, size of a cell, how many in a row, how many rows
    """

    table: Floats
    start: NDArray[np.int64]
    frame: Floats


@dataclass(frozen=True, eq=False)
class Walls:
    """A map's walls, sampled.

    Parameters
    ----------
    points_xy : (n, 2) metres
    normals_xy : (n, 2) unit vectors into free space
    lengths_m : (n,) how much wall each point stands for
    lasting_m : (n,) and how much of it will still be there: what stands free and is small may have been moved
    edge : (n,) of which edge each point is; those of one lie together
    states_yx, corner_xy : the map's states in cells of ``CELL_M``, and where its lower left corner lies, in metres
    """

    points_xy: Floats
    normals_xy: Floats
    lengths_m: Floats
    lasting_m: Floats
    edge: NDArray[np.int64]
    states_yx: NDArray[np.uint8]
    corner_xy: Floats

    @functools.cached_property
    def table(self) -> Floats:
        """(n, 6) points, normals and lengths, as the kernels take them."""
        return np.column_stack([self.points_xy, self.normals_xy, self.lengths_m, self.lasting_m])

    @functools.cached_property
    def segments(self) -> NDArray[np.int64]:
        """(2 edges,) for each edge, the longest first, its first point and how many it has."""
        if len(self.edge) == 0:
            return np.zeros(0, np.int64)
        first = np.concatenate([[0], np.flatnonzero(np.diff(self.edge)) + 1, [len(self.edge)]])
        length = np.add.reduceat(self.lengths_m, first[:-1])
        order = np.argsort(-length, kind="stable")
        return np.column_stack([first[:-1], np.diff(first)])[order].ravel().astype(np.int64)

    @functools.cached_property
    def index(self) -> Index:
        """The same, sorted by place."""
        low = self.points_xy.min(axis=0) if len(self.points_xy) else np.zeros(2)
        cells = np.floor((self.points_xy - low) / INDEX_M).astype(np.int64)
        columns, rows = (cells.max(axis=0) + 1).tolist() if len(cells) else (1, 1)
        flat = cells[:, 1] * columns + cells[:, 0]
        start = np.concatenate([[0], np.cumsum(np.bincount(flat, minlength=rows * columns))]).astype(np.int64)
        frame = np.array([*low, INDEX_M, columns, rows])
        return Index(np.ascontiguousarray(self.table[np.argsort(flat, kind="stable")]), start, frame)

    @functools.cached_property
    def outline_xy(self) -> Floats:
        """(h, 2) the corners of the convex hull of the points: nothing else moves farther between two poses."""
        try:
            corners: Floats = self.points_xy[ConvexHull(self.points_xy).vertices]
        except (QhullError, ValueError):  # fewer than three points, or all on one line
            corners = self.points_xy
        return corners

    @functools.cached_property
    def clearance_m(self) -> NDArray[np.float32]:
        """(h, w) of free cells, how far the nearest cell is that isn't free; 0 elsewhere."""
        clear: NDArray[np.float64] = ndimage.distance_transform_edt(self.states_yx == FREE)
        return (clear * CELL_M).astype(np.float32)


@functools.lru_cache(8)
def walls_of(vector_map: VectorMap) -> Walls:
    """The walls of a vector map, in metres of its frame. The last few are kept: maps are looked at again and again.

    Raises
    ------
    ConfigError : the map is too large
    """
    from fleetmap.vectorize import rasterize

    check_size(vector_map)
    rows = vector_map.edges
    segments = vector_map.segments_xy[vector_map.obstacle]
    free_left = rows[vector_map.obstacle, 4] == OBSTACLE_LABELS[0]
    points, normals, lengths, which = sampled(segments, free_left)
    lasting = np.where(loose(rows[vector_map.obstacle, :4], vector_map.lattice.resolution_um / 1e6), LASTING, 1.0)
    grid = rasterize(vector_map) if len(rows) else None
    states, corner = coarse(grid) if grid is not None else (np.full((1, 1), UNKNOWN, np.uint8), np.zeros(2))
    return Walls(points, normals, lengths, lengths * lasting[which], which, states, corner)


def check_size(vector_map: VectorMap) -> None:
    """Refuse a map that would take all memory, and be looked at for minutes."""
    if vector_map.bounds_yx is None:
        return
    y0, x0, y1, x1 = vector_map.bounds_yx
    cell_m = vector_map.lattice.resolution_um / 1e6
    height_m, width_m = (y1 - y0) * cell_m, (x1 - x0) * cell_m
    if height_m * width_m > MOST_M2 or (y1 - y0) * (x1 - x0) > MOST_CELLS:
        raise ConfigError(
            option="map",
            value=f"{width_m:.0f} m x {height_m:.0f} m in cells of {cell_m:g} m",
            reason=f"too large to be aligned: expected at most {MOST_M2:.0f} m2 and {MOST_CELLS} cells, as of "
            "600 m x 600 m in cells of 0.05 m. Is the resolution right?",
        )


def mirrored(walls: Walls) -> Walls:
    """The same map seen in a mirror: x becomes -x."""
    flip = np.array([-1.0, 1.0])
    right_m = walls.corner_xy[0] + CELL_M * walls.states_yx.shape[1]
    return replace(
        walls,
        points_xy=walls.points_xy * flip,
        normals_xy=walls.normals_xy * flip,
        states_yx=np.ascontiguousarray(walls.states_yx[:, ::-1]),
        corner_xy=np.array([-right_m, walls.corner_xy[1]]),
    )


def loose(edges: NDArray[np.int32], cell_m: float) -> NDArray[np.bool_]:
    """(n,) whether an obstacle edge (y0, x0, y1, x1), in cells, belongs to something small that stands free."""
    if not len(edges):
        return np.zeros(0, bool)
    ends, which = np.unique(edges.reshape(-1, 2), axis=0, return_inverse=True)
    pairs = which.reshape(-1, 2)
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), (len(ends), len(ends)))
    count, part = connected_components(graph, directed=False)
    low, high = np.full((count, 2), np.iinfo(np.int64).max), np.full((count, 2), np.iinfo(np.int64).min)
    np.minimum.at(low, part, ends)
    np.maximum.at(high, part, ends)
    small = (high - low).max(axis=1) * cell_m < LOOSE_M
    of: NDArray[np.bool_] = small[part[pairs[:, 0]]]
    return of


def sampled(segments: Floats, free_left: NDArray[np.bool_]) -> tuple[Floats, Floats, Floats, NDArray[np.int64]]:
    """Points in the middles of equal parts of each segment (n, 2, 2), the normal, length and segment of each."""
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
    return points, normals, (length / parts)[which], which


def coarse(grid: OccupancyGrid) -> tuple[NDArray[np.uint8], Floats]:
    """The states of a grid in cells of ``CELL_M``, by their centres, and where the first one begins."""
    height, width = grid.height * grid.resolution_m, grid.width * grid.resolution_m
    corners = grid.origin.apply(np.array([(0, 0), (width, 0), (0, height), (width, height)], np.float64))
    low = np.floor(corners.min(axis=0) / CELL_M) * CELL_M
    columns, rows = np.ceil((corners.max(axis=0) - low) / CELL_M).astype(int)
    states, of_grid, T_grid_frame = np.full((rows, columns), UNKNOWN, np.uint8), grid.states_yx(), grid.origin.inverse()
    x = low[0] + (np.arange(columns) + 0.5) * CELL_M
    for row in range(rows):  # one at a time: all at once takes sixteen times the map
        centres = np.column_stack([x, np.full(columns, low[1] + (row + 0.5) * CELL_M)])
        cell = np.floor(T_grid_frame.apply(centres) / grid.resolution_m).astype(np.int64)
        inside = (cell >= 0).all(axis=1) & (cell[:, 0] < grid.width) & (cell[:, 1] < grid.height)
        states[row, inside] = of_grid[cell[inside, 1], cell[inside, 0]]
    return states, low


def rotated(yaw_rad: float, points_xy: Floats) -> Floats:
    """(..., 2) points turned about (0, 0)."""
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    turned: Floats = points_xy @ np.array([[c, s], [-s, c]])
    return turned
