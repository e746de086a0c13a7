"""What a robot plans on: the fleet's merged map with its own fresh grid over it, and what travel costs there."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.lattice import OCCUPIED, UNKNOWN
from fleetmap.model.mergedmap import MergedMap
from fleetmap.model.pose import Pose2
from fleetmap.sims.mapping import Mapper

MARGINS_M = ((0.02, 12), (0.05, 4), (0.10, 1))
"""(margin beyond the robot's radius, price of a cell that keeps it): a margin is a price, not a wall, so that
a narrow door is taken when there is no other way, and passed in its middle. Below the least of them, which
is what the pose and the cells may be wrong by, nothing is travelled."""

ESCAPE_M = 0.4
"""A robot that stands where it would not go may start from the nearest good cell within this distance."""


@dataclass(frozen=True, eq=False)
class View:
    """States and prices of cells in the fleet frame.

    Parameters
    ----------
    states_yx : (h, w) FREE, OCCUPIED, UNKNOWN; cell (0, 0) begins at lattice point ``low_yx``
    low_yx : lattice point (cells of ``resolution_m``) of the lower left corner
    radius_m : the robot's
    """

    states_yx: NDArray[np.uint8]
    low_yx: tuple[int, int]
    radius_m: float
    resolution_m: float
    price_yx: NDArray[np.uint8] = field(init=False)
    """(h, w) what entering a cell costs; 0 where the robot's centre can't be."""

    def __post_init__(self) -> None:
        from fleetmap.sims.space_kernels import clearance2, prices

        least_cells = [(self.radius_m + margin_m) / self.resolution_m for margin_m, _ in MARGINS_M]
        clearance = clearance2(self.states_yx == OCCUPIED, math.ceil(least_cells[-1]) + 1)
        least = np.array([math.ceil(4 * cells**2) for cells in least_cells], np.int64)
        price = np.array([price for _, price in MARGINS_M], np.uint8)
        object.__setattr__(self, "price_yx", prices(self.states_yx, clearance, least, price))

    def cell(self, xy: tuple[float, float]) -> tuple[int, int]:
        """The cell that a point (metres, fleet frame) lies in, moved into the grid if it is outside."""
        row = math.floor(xy[1] / self.resolution_m) - self.low_yx[0]
        column = math.floor(xy[0] / self.resolution_m) - self.low_yx[1]
        height, width = self.states_yx.shape
        return min(max(row, 0), height - 1), min(max(column, 0), width - 1)

    def centres_xy(self, cells_yx: NDArray[np.int64]) -> NDArray[np.float64]:
        """(n, 2) metres: centres of the cells (n, 2)."""
        points: NDArray[np.float64] = (cells_yx[:, ::-1] + np.array(self.low_yx[::-1]) + 0.5) * self.resolution_m
        return points

    def costs_from(self, xy: tuple[float, float]) -> NDArray[np.int32]:
        """(h, w) travel cost from a point to each cell: 10 a cell on open ground; ``space_kernels.FAR`` if cut off."""
        from fleetmap.sims.space_kernels import cost_field

        return cost_field(self.price_yx, *self._way_out(self.cell(xy)))

    def rough_costs_from(self, xy: tuple[float, float], cells_yx: NDArray[np.int64]) -> NDArray[np.int64]:
        """(n,) travel costs from a point to cells (n, 2), on every second row and column: a quarter of the work.

        Walls, with the robot's radius around them, are far wider than the cells that are left out.
        """
        from fleetmap.sims.space_kernels import cost_field

        half = np.ascontiguousarray(self.price_yx[::2, ::2])
        row, column = self._way_out(self.cell(xy))
        costs = cost_field(half, min(row // 2, len(half) - 1), min(column // 2, half.shape[1] - 1))
        there: NDArray[np.int64] = 2 * costs[cells_yx[:, 0] // 2, cells_yx[:, 1] // 2].astype(np.int64)
        return there

    def path_to(self, costs: NDArray[np.int32], cell: tuple[int, int]) -> NDArray[np.float64]:
        """(n, 2) metres: the way from where ``costs`` begin to ``cell``, with as few waypoints as the prices allow."""
        from fleetmap.sims.space_kernels import dearest_on_line, descend

        cells = descend(costs, self.price_yx, *cell)
        prices = self.price_yx[cells[:, 0], cells[:, 1]]
        kept, at = [0], 0
        while at < len(cells) - 1:
            # As far ahead as a straight line is no dearer than the cells it replaces; doubling, then halving.
            low, high = at + 1, min(at + 2, len(cells) - 1)

            def straight(to: int, start: int = at) -> bool:
                dearest = dearest_on_line(self.price_yx, *cells[start], *cells[to])
                return bool(dearest <= max(1, prices[start : to + 1].max()))

            while high < len(cells) - 1 and straight(high):
                low, high = high, min(at + 2 * (high - at), len(cells) - 1)
            if straight(high):
                low = high
            while high - low > 1:
                middle = (low + high) // 2
                low, high = (middle, high) if straight(middle) else (low, middle)
            kept.append(low)
            at = low
        return self.centres_xy(cells[kept])

    def _way_out(self, cell: tuple[int, int]) -> tuple[int, int]:
        """The nearest cell with a price, if there is one near; else the cell itself."""
        if self.price_yx[cell]:
            return cell
        reach = round(ESCAPE_M / self.resolution_m)
        low = np.maximum(np.array(cell) - reach, 0)
        window = self.price_yx[low[0] : cell[0] + reach + 1, low[1] : cell[1] + reach + 1]
        good = np.argwhere(window) + low
        if not len(good):
            return cell
        best = good[np.argmin(((good - cell) ** 2).sum(axis=1))]
        return int(best[0]), int(best[1])


def look(merged: MergedMap | None, mapper: Mapper, *, T_fleet_robot: Pose2, radius_m: float) -> View:
    """The merged map as cells, with what the robot's own grid knows written over it.

    Its own cells win because they are fresher and finer than the vectors that it has published of them.
    """
    from fleetmap.sims.space_kernels import overlay

    cell = mapper.resolution_m
    height, width = mapper.states_yx.shape
    own_low = np.array(mapper.low_yx)
    corners_yx = own_low + np.array([(0, 0), (0, width), (height, 0), (height, width)])
    corners = T_fleet_robot.apply(corners_yx[:, ::-1] * cell)[:, ::-1] / cell
    low, high = np.floor(corners.min(axis=0)).astype(int), np.ceil(corners.max(axis=0)).astype(int)
    grid = merged.to_grid(cell) if merged is not None and len(merged) else None
    if grid is not None:
        at = np.array([round(grid.origin.y_m / cell), round(grid.origin.x_m / cell)])
        low, high = np.minimum(low, at), np.maximum(high, at + grid.cells_yx.shape)
    states = np.full(high - low, UNKNOWN, np.uint8)
    if grid is not None:
        y, x = at - low
        states[y : y + grid.height, x : x + grid.width] = grid.states_yx()
    overlay(
        states,
        int(low[0]),
        int(low[1]),
        mapper.states_yx,
        int(own_low[0]),
        int(own_low[1]),
        math.cos(T_fleet_robot.yaw_rad),
        math.sin(T_fleet_robot.yaw_rad),
        T_fleet_robot.x_m / cell,
        T_fleet_robot.y_m / cell,
    )
    return View(states, (int(low[0]), int(low[1])), radius_m, cell)
