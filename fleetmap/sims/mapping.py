"""A robot's own occupancy grid from its scans: log-odds by cell, with noise held still."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import UNKNOWN
from fleetmap.model.pose import Pose2
from fleetmap.sims.lidar import Lidar

BLOCK = 64
"""The grid grows by whole blocks of this many cells, so that it rarely has to be copied."""

WALL_DEPTH_CELLS = 1.6
"""How far behind a return cells vote occupied: a wall in any direction is then about two cells thick and
8-connected even with noise. (1.3 leaks into the wall in places, and leaks are frontiers that cost way and bytes.)"""

NEAR_M = 2.5
"""Up to here votes count most (see the kernel)."""


class Mapper:
    """Scans in, occupancy grid out, in the robot's map frame (its start pose is the origin).

    Parameters
    ----------
    lidar : the scans' make
    resolution_m : metres a cell; cell corners lie on whole multiples of it
    """

    def __init__(self, lidar: Lidar, *, resolution_m: float = 0.05) -> None:
        self.lidar, self.resolution_m = lidar, resolution_m
        self._low = np.zeros(2, np.int64)  # lattice coordinates (y, x) of the grid's lower left corner
        self._votes = np.zeros((0, 0), np.int16)
        self._states = np.zeros((0, 0), np.uint8)

    def add(self, ranges_m: NDArray[np.float64], pose: Pose2) -> None:
        """Take one scan, made at ``pose`` (robot's map frame, as the robot believes it to be)."""
        from fleetmap.sims.mapping_kernels import integrate

        reach_m = min(float(ranges_m.max()) + 2 * WALL_DEPTH_CELLS * self.resolution_m, self.lidar.range_m)
        self._grow_to(pose, reach_m)
        cell = self.resolution_m
        integrate(
            self._votes,
            self._states,
            pose.x_m / cell - self._low[1],
            pose.y_m / cell - self._low[0],
            pose.yaw_rad,
            ranges_m / cell,
            self.lidar.range_m / cell,
            WALL_DEPTH_CELLS,
            NEAR_M / cell,
        )

    @property
    def states_yx(self) -> NDArray[np.uint8]:
        """(h, w) FREE, OCCUPIED, UNKNOWN; cell (0, 0) starts at lattice point ``low_yx``. Not a copy."""
        return self._states

    @property
    def low_yx(self) -> tuple[int, int]:
        """Lattice coordinates (in cells) of the grid's lower left corner."""
        return int(self._low[0]), int(self._low[1])

    def grid(self) -> OccupancyGrid:
        """The map as it stands."""
        low_y, low_x = self.low_yx
        origin = Pose2(low_x * self.resolution_m, low_y * self.resolution_m)
        return OccupancyGrid.from_states(self._states, self.resolution_m, origin)

    def known_m2(self) -> float:
        """Area of the cells that are free or occupied."""
        return float((self._states != UNKNOWN).sum()) * self.resolution_m**2

    def _grow_to(self, pose: Pose2, reach_m: float) -> None:
        centre = np.array([pose.y_m, pose.x_m]) / self.resolution_m
        reach = reach_m / self.resolution_m
        low = np.floor((centre - reach) / BLOCK).astype(np.int64) * BLOCK
        high = np.ceil((centre + reach) / BLOCK).astype(np.int64) * BLOCK
        old_high = self._low + self._votes.shape
        if self._votes.size:
            low, high = np.minimum(low, self._low), np.maximum(high, old_high)
        if self._votes.size and (low == self._low).all() and (high == old_high).all():
            return
        votes = np.zeros(high - low, np.int16)
        states = np.full(high - low, UNKNOWN, np.uint8)
        y, x = self._low - low
        height, width = self._votes.shape
        votes[y : y + height, x : x + width] = self._votes
        states[y : y + height, x : x + width] = self._states
        self._low, self._votes, self._states = low, votes, states
