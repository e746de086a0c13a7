"""What the verifier knows of the grid: its boundary, its components and specks, and which face each cell is in."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.errors import ConfigError
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN
from fleetmap.model.pose import wrap
from fleetmap.model.vectormap import VectorMap
from fleetmap.vectorize.verify_cover import UNIT, Segments, find_touched_owners, first_gaps
from fleetmap.vectorize.verify_faces import Faces

PHASES = 16
"""A grid's true offset from the lattice counts in sixteenths of a cell."""

SPECK = 3
"""Instead of a state where a speck may have become any."""


class GridCells:
    """A grid with a rim of unknown cells, placed on the lattice of a vector map.

    Free and unknown 4-connected components of at most ``specks`` cells are *specks*: the map may have made
    anything of them, so no boundary is demanded of them, and any boundary they could have become will do.
    """

    def __init__(self, grid: OccupancyGrid, vector_map: VectorMap, specks: int) -> None:
        from scipy.ndimage import label

        self.epsilon_cells = vector_map.epsilon_cells
        self.states: NDArray[np.uint8] = np.full((grid.height + 2, grid.width + 2), UNKNOWN, np.uint8)
        self.states[1:-1, 1:-1] = grid.states_yx()
        self.origin_yx = place_on_lattice(grid, vector_map) - UNIT  # of the rim's lower left corner
        # All components in one numbering, the free ones first; 0 is occupied.
        self.labels, self.free_count = label(self.states == FREE)
        unknown = self.states == UNKNOWN
        unknown_labels, unknown_count = label(unknown)
        self.labels[unknown] = unknown_labels[unknown] + self.free_count
        self.sizes: NDArray[np.int64] = np.bincount(self.labels.ravel(), minlength=1 + self.free_count + unknown_count)
        self.is_speck: NDArray[np.bool_] = self.sizes <= specks
        self.is_speck[0] = self.is_speck[self.labels[0, 0]] = False  # neither the walls nor the outside
        self.in_speck: NDArray[np.bool_] = self.is_speck[self.labels]

    def boundary(self, a: int, b: int, *, certain: bool) -> Segments:
        """Where state ``a`` meets state ``b``, as maximal straight runs.

        ``certain`` leaves out the boundary of specks; else they count as every state at once.
        """
        from fleetmap.vectorize.verify_cells_kernels import list_runs

        is_a, is_b = self.states == a, self.states == b
        has_specks = self.is_speck.any()
        if has_specks and certain:
            is_a, is_b = is_a & ~self.in_speck, is_b & ~self.in_speck
        elif has_specks:
            is_a, is_b = is_a | self.in_speck, is_b | self.in_speck
        apart = bool(has_specks and not certain)  # a speck becomes one thing as a whole
        runs = list_runs(is_a.view(np.uint8), is_b.view(np.uint8), self.labels, apart, UNIT)
        return runs + np.tile(self.origin_yx, 2)

    def obstacle_centres(self) -> Segments:
        """The centres of the occupied cells that touch a free cell by a side or corner, as segments of no length."""
        from scipy.ndimage import maximum_filter

        touches = (self.states == OCCUPIED) & (maximum_filter((self.states == FREE).view(np.uint8), 3) > 0)
        centres = np.argwhere(touches) * UNIT + UNIT // 2 + self.origin_yx
        return np.concatenate([centres, centres], axis=1)

    def dropped_specks(self, edges_by_pair: dict[tuple[int, int], Segments], epsilon2: Fraction) -> NDArray[np.int64]:
        """Sizes in cells of the specks whose boundary is not all within epsilon of the edges of its kind.

        ``edges_by_pair`` holds the edges between the states (a, b) of each kind.
        """
        missing = np.zeros(len(self.sizes), bool)
        if self.is_speck.any():
            for (a, b), edges in edges_by_pair.items():
                cracks, owners = self.cracks_between(self.states, (a, b), self.labels, self.in_speck)
                missing[owners[~np.isnan(first_gaps(cracks, edges, epsilon2))]] = True
        return self.sizes[missing]

    def lost_obstacles(
        self, edges: Segments, epsilon2: Fraction, *, also: NDArray[np.bool_], found: NDArray[np.bool_]
    ) -> NDArray[np.float64]:
        """Where obstacles are that have no edge within epsilon of their boundary.

        Parameters
        ----------
        also : cells of specks that may have become part of one: obstacles are 8-connected components of occupied
            cells and these
        found : cells of which one suffices to say that the map has the obstacle

        Returns
        -------
        (n, 2) centres (y, x) of the obstacles' first cells, in cells of the lattice
        """
        from scipy.ndimage import label

        occupied = self.states == OCCUPIED
        labels, count = label(occupied | also, np.ones((3, 3)))
        cracks, owners = self.cracks_between(occupied.view(np.uint8), (0, 1), labels, occupied)
        known = find_touched_owners(cracks, owners, count + 1, edges, epsilon2)
        known[labels[found & occupied]] = True
        known[0] = True
        return self.first_places(np.where(known[labels] | ~occupied, 0, labels))

    def faces_of_cells(self, edges: Segments, faces: Faces) -> NDArray[np.int32]:
        """The face that each cell's centre lies in, (height + 2, width + 2); on an edge, either one's."""
        from fleetmap.vectorize.verify_cells_kernels import fill_cells

        result = np.empty(self.states.shape, np.int32)
        first_y, first_x = (self.origin_yx + UNIT // 2).tolist()
        right = np.ascontiguousarray(faces.right)
        fill_cells(np.ascontiguousarray(edges), right, faces.outside, first_y, first_x, UNIT, result)
        return result

    def deep(self, kinds: NDArray[np.uint8]) -> NDArray[np.bool_]:
        """Which cells have their centre more than epsilon away from all cells of other kinds, and are no specks.

        ``kinds`` is as ``states``, and may tell fewer apart.
        """
        from fleetmap.vectorize.verify_cells_kernels import find_deep

        kinds = np.where(self.in_speck, np.uint8(SPECK), kinds)
        # From a centre to a cell that is n > 0 rows or columns away it is n - 1/2 cells.
        reach = []
        for dy in range(math.floor(self.epsilon_cells + 0.5 + 1e-9) + 1):
            across2 = self.epsilon_cells**2 - max(dy - 0.5, 0) ** 2
            reach.append(math.floor(math.sqrt(max(across2, 0)) + 0.5 + 1e-9))
        deep: NDArray[np.bool_] = find_deep(kinds, np.array(reach, np.int64)) > 0
        return deep & ~self.in_speck

    def first_places(self, labels: NDArray[np.int32]) -> NDArray[np.float64]:
        """(n, 2) centres (y, x), in cells of the lattice, of the first cell of each label but 0."""
        y, x = np.nonzero(labels)
        _, first = np.unique(labels[y, x], return_index=True)
        places: NDArray[np.float64] = np.column_stack([y[first], x[first]]) + 0.5 + self.origin_yx / UNIT
        return places

    def first_of_groups(self, cells: NDArray[np.bool_]) -> NDArray[np.float64]:
        """(n, 2) as ``first_places``, for each group of these cells that hang together."""
        from scipy.ndimage import label

        return self.first_places(label(cells)[0]) if cells.any() else np.zeros((0, 2))

    def cracks_between(
        self, states: NDArray[np.uint8], pair: tuple[int, int], labels: NDArray[np.int32], mine: NDArray[np.bool_]
    ) -> tuple[Segments, NDArray[np.int64]]:
        """Units of boundary between two states of which one side is ``mine``, and the label of that side."""
        from fleetmap.vectorize.verify_cells_kernels import list_cracks

        cracks, owners = list_cracks(states, *pair, labels, mine.view(np.uint8), UNIT)
        return cracks + np.tile(self.origin_yx, 2), owners


def place_on_lattice(grid: OccupancyGrid, vector_map: VectorMap) -> NDArray[np.int64]:
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
