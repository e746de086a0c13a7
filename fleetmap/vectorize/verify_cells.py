"""What the verifier knows of the grid: its boundary, its components and specks, and which face each cell is in."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.errors import ConfigError
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN
from fleetmap.model.pose import wrap
from fleetmap.model.vectormap import VectorMap
from fleetmap.vectorize.verify_cover import UNIT, first_gaps
from fleetmap.vectorize.verify_faces import Faces

PHASES = 16
"""A grid's true offset from the lattice counts in sixteenths of a cell."""

Segments = NDArray[np.int64]
"""(n, 4) rows (y0, x0, y1, x1) in 1/32 cells of the map's lattice."""


class GridCells:
    """A grid with a rim of unknown cells, placed on the lattice of a vector map.

    Free and unknown 4-connected components of at most ``specks`` cells are *specks*: the map may have made
    anything of them, so no boundary is demanded of them, and any boundary they could have become will do.
    """

    def __init__(self, grid: OccupancyGrid, vector_map: VectorMap, specks: int) -> None:
        from scipy.ndimage import label

        self.epsilon_cells = vector_map.epsilon_cells
        self.states: NDArray[np.uint8] = np.pad(grid.states_yx(), 1, constant_values=UNKNOWN)
        self.origin_yx = _place_on_lattice(grid, vector_map) - UNIT  # of the rim's lower left corner
        free_labels, self.free_count = label(self.states == FREE)
        unknown_labels, unknown_count = label(self.states == UNKNOWN)
        # All components in one numbering, the free ones first; 0 is occupied.
        self.labels: NDArray[np.int64] = np.where(
            unknown_labels > 0, unknown_labels.astype(np.int64) + self.free_count, free_labels
        )
        self.sizes: NDArray[np.int64] = np.bincount(self.labels.ravel(), minlength=1 + self.free_count + unknown_count)
        is_speck = self.sizes <= specks
        is_speck[0] = is_speck[self.labels[0, 0]] = False  # neither the walls nor the outside
        self.speck: NDArray[np.int64] = np.where(is_speck[self.labels], self.labels, 0)

    def boundary(self, a: int, b: int, *, certain: bool) -> Segments:
        """Where state ``a`` meets state ``b``, as maximal straight runs.

        ``certain`` leaves out the boundary of specks; else they count as every state at once.
        """
        in_speck = self.speck > 0
        is_a, is_b = (
            (self.states == state) & ~in_speck if certain else (self.states == state) | in_speck for state in (a, b)
        )
        runs = []
        for axis in (0, 1):
            low, high = _neighbours(is_a, axis), _neighbours(is_b, axis)
            meets = (low[0] & high[1]) | (low[1] & high[0])
            speck0, speck1 = _neighbours(self.speck, axis)
            meets &= (speck0 != speck1) | (speck0 == 0)  # a speck becomes one thing as a whole
            runs.append(self._runs(meets, axis))
        return np.concatenate(runs)

    def obstacle_centres(self) -> Segments:
        """The centres of the occupied cells that touch a free cell by a side or corner, as segments of no length."""
        from scipy.ndimage import maximum_filter

        touches = (self.states == OCCUPIED) & (maximum_filter((self.states == FREE).view(np.uint8), 3) > 0)
        centres = np.argwhere(touches) * UNIT + UNIT // 2 + self.origin_yx
        return np.concatenate([centres, centres], axis=1)

    def lost_specks(self, obstacles: Segments, frontiers: Segments, epsilon2: Fraction) -> NDArray[np.int64]:
        """Sizes in cells of the specks whose boundary is not all within epsilon of the edges of its kind."""
        lost = np.zeros(len(self.sizes), bool)
        for other, edges in ((OCCUPIED, obstacles), (UNKNOWN, frontiers)):
            cracks, owners = [], []
            for axis in (0, 1):
                state0, state1 = _neighbours(self.states, axis)
                meets = ((state0 == FREE) & (state1 == other)) | ((state0 == other) & (state1 == FREE))
                for speck in _neighbours(self.speck, axis):
                    place = np.argwhere(meets & (speck > 0))
                    cracks.append(self._cracks(place, axis))
                    owners.append(speck[tuple(place.T)])
            gaps = first_gaps(np.concatenate(cracks), edges, epsilon2)
            lost[np.concatenate(owners)[~np.isnan(gaps)]] = True
        return self.sizes[lost]

    def faces_of_cells(self, edges: Segments, faces: Faces) -> NDArray[np.int64]:
        """The face that each cell's centre lies in, (height + 2, width + 2); on an edge, either one's."""
        height, width = self.states.shape
        first_y, first_x = (self.origin_yx + UNIT // 2).tolist()
        # Every edge crosses the rows of centres with y0 <= y < y1. East of it is its right face.
        y0, x0, y1, x1 = edges.T
        low, high = (np.clip(-((first_y - y) // UNIT), 0, height) for y in (y0, y1))
        edge = np.repeat(np.arange(len(edges)), high - low)
        row = np.arange(len(edge)) - np.repeat(np.cumsum(high - low) - (high - low), high - low) + low[edge]
        slope = (x1 - x0)[edge] / (y1 - y0)[edge]
        column = (x0[edge] + (first_y + UNIT * row - y0[edge]) * slope - first_x) / UNIT
        order = np.lexsort((slope, column, row))
        # One key for row and column, a row's crossings kept within its own range.
        span = width + 2.0
        keys = (row * span + np.clip(column, -1, width))[order]
        cells = np.arange(height)[:, None] * span + np.arange(width)
        before = np.searchsorted(keys, cells.ravel(), side="right").reshape(cells.shape) - 1
        face_east, row_of = np.append(faces.right[edge[order]], faces.outside), np.append(row[order], -1)
        same_row = row_of[before] == np.arange(height)[:, None]
        return np.where(same_row, face_east[before], faces.outside)

    def near_others(self) -> NDArray[np.bool_]:
        """Which cells have their centre at most epsilon away from a cell that is not free."""
        from scipy.ndimage import maximum_filter1d

        others = (self.states != FREE).view(np.uint8)
        near: NDArray[np.bool_] = np.zeros(others.shape, bool)
        height = len(others)
        reach = min(math.floor(self.epsilon_cells + 0.5 + 1e-9), height - 1)
        for dy in range(-reach, reach + 1):
            # From a centre to a cell that is n > 0 rows or columns away it is n - 1/2 cells.
            across2 = self.epsilon_cells**2 - max(abs(dy) - 0.5, 0) ** 2
            widest = math.floor(math.sqrt(max(across2, 0)) + 0.5 + 1e-9)
            spread = maximum_filter1d(others, 2 * widest + 1, axis=1, mode="constant", cval=1)
            near[max(dy, 0) : height + min(dy, 0)] |= spread[max(-dy, 0) : height - max(dy, 0)] > 0
        return near

    def _runs(self, meets: NDArray[np.bool_], axis: int) -> Segments:
        """Maximal straight runs of cracks; ``meets[i, j]``: between cell (i, j) and its neighbour along ``axis``."""
        lines = meets if axis == 0 else meets.T
        steps = np.diff(np.pad(lines, ((0, 0), (1, 1))).astype(np.int8), axis=1)
        line, start = np.nonzero(steps == 1)
        _, end = np.nonzero(steps == -1)
        across = line + 1
        corners = np.column_stack([across, start, across, end] if axis == 0 else [start, across, end, across])
        return corners * UNIT + np.tile(self.origin_yx, 2)

    def _cracks(self, place: NDArray[np.int64], axis: int) -> Segments:
        """The unit segments between the cells at ``place``, (n, 2), and their neighbours along ``axis``."""
        first = place + ((1, 0) if axis == 0 else (0, 1))
        last = first + ((0, 1) if axis == 0 else (1, 0))
        return np.concatenate([first, last], axis=1) * UNIT + np.tile(self.origin_yx, 2)


Scalar = TypeVar("Scalar", bound=np.generic)


def _neighbours(cells: NDArray[Scalar], axis: int) -> tuple[NDArray[Scalar], NDArray[Scalar]]:
    """Each cell but the last along ``axis``, and the one after it."""
    return (cells[:-1], cells[1:]) if axis == 0 else (cells[:, :-1], cells[:, 1:])


def _place_on_lattice(grid: OccupancyGrid, vector_map: VectorMap) -> NDArray[np.int64]:
    """The grid's lower left corner, (y, x) in 1/32 cells of the lattice, rounded to sixteenths."""
    lattice = vector_map.lattice
    T_lattice_grid = lattice.T_frame_lattice.to_pose().inverse() @ grid.origin
    if abs(grid.resolution_m * 1e6 - lattice.resolution_um) >= 1:
        reason = f"the map has cells of {lattice.resolution_m} m; a map belongs to grids of its own resolution"
        raise ConfigError(option="grid.resolution_m", value=grid.resolution_m, reason=reason)
    if abs(wrap(T_lattice_grid.yaw_rad)) > 1e-6:
        reason = "the map's lattice is turned against the grid"
        raise ConfigError(option="grid.origin.yaw_rad", value=grid.origin.yaw_rad, reason=reason)
    corner = np.array([T_lattice_grid.y_m, T_lattice_grid.x_m]) / lattice.resolution_m
    return np.rint(corner * PHASES).astype(np.int64) * (UNIT // PHASES)
