"""Grid A* with exact clearance, its path pulled taut: the honest baseline of the registry.

1. Rasterise the merged map; the disc's centre may be in free cells only.
2. Clear every cell whose centre is too near to an obstacle *edge* (not cell), with so much in hand that a step
   between two neighbouring centres keeps the clearance too.
3. Link start and goal to near centres, search, then shortcut wherever the straight line keeps the clearance and
   stays in free cells.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.errors import NoPath
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import EPSILON_CELLS, FREE
from fleetmap.model.mergedmap import FLEET_UM, MergedMap
from fleetmap.planners.protocol import Path

_FAR_CELLS = 1e6
"""Cells; a clearance that large is reported as infinite."""


def plan_astar(
    merged: MergedMap, start_xy: tuple[float, float], goal_xy: tuple[float, float], *, clearance_m: float
) -> Path:
    """Plan as ``Planner`` says; at most one cell of clearance is given away to the grid."""
    from fleetmap.planners.grid_kernels import astar, block_near, segment_clearance

    if len(merged) == 0:
        raise NoPath(status="outside", reason="the map is empty: no robot has shared one in its frame")
    grid = merged.to_grid()
    cell_m = grid.resolution_m
    origin = np.array([grid.origin.x_m, grid.origin.y_m])
    free = np.ascontiguousarray(grid.states_yx() == FREE)
    walls = np.ascontiguousarray(((merged.segments_xy[merged.obstacle] - origin) / cell_m).reshape(-1, 4))
    start, goal = (np.asarray(start_xy, float) - origin) / cell_m, (np.asarray(goal_xy, float) - origin) / cell_m
    clearance = clearance_m / cell_m

    for name, point in (("start", start), ("goal", goal)):
        col, row = (int(v) for v in np.floor(point))
        if not (0 <= row < grid.height and 0 <= col < grid.width):
            raise NoPath(status="outside", reason=f"the {name} lies outside of the map")
        if not free[row, col]:
            raise NoPath(status=f"{name}_blocked", reason=f"the {name} is not in known free space")
        room = segment_clearance(point[0], point[1], point[0], point[1], walls, _FAR_CELLS)
        if room < clearance:
            raise NoPath(
                status=f"{name}_blocked",
                reason=f"the {name} is {room * cell_m:.3f} m from an obstacle; {clearance_m:.3f} m are asked for",
            )

    if _clear(start, goal, walls, free, clearance):
        return _finish(merged, grid, np.array([start, goal]), walls, start_xy, goal_xy)
    passable = free.copy()
    # Two centres that are d from a wall, a diagonal apart: the point between them is sqrt(d^2 - 1/2) from it.
    block_near(passable, walls, math.sqrt(clearance * clearance + 0.5))
    ends = []
    for name, point in (("start", start), ("goal", goal)):
        centre = _nearest_centre(point, passable, walls, free, clearance)
        if centre is None:
            raise NoPath(status=f"{name}_blocked", reason=f"no way for the disc out of the {name}'s surroundings")
        ends.append(centre[0] * grid.width + centre[1])
    cells = astar(passable, ends[0], ends[1])
    if len(cells) == 0:
        raise NoPath(status="unreachable", reason="no free way that is wide enough leads from start to goal")
    centres = np.column_stack([cells % grid.width, cells // grid.width]) + 0.5
    taut = _pull_taut(np.vstack([start, centres, goal]), walls, free, clearance)
    return _finish(merged, grid, taut, walls, start_xy, goal_xy)


def _clear(
    a: NDArray[np.float64],
    b: NDArray[np.float64],
    walls: NDArray[np.float64],
    free: NDArray[np.bool_],
    clearance: float,
) -> bool:
    """Whether the straight line from a to b, in cells, is in free cells and keeps the clearance."""
    from fleetmap.planners.grid_kernels import segment_clearance, stays_free

    return bool(
        stays_free(free, a[0], a[1], b[0], b[1])
        # The search radius is a little larger than what is asked for, so that "none found" means "far enough".
        and segment_clearance(a[0], a[1], b[0], b[1], walls, clearance + 1.0) >= clearance
    )


def _nearest_centre(
    point: NDArray[np.float64],
    passable: NDArray[np.bool_],
    walls: NDArray[np.float64],
    free: NDArray[np.bool_],
    clearance: float,
) -> tuple[int, int] | None:
    """The nearest passable cell, (row, col), that the disc can reach from ``point`` in a straight line."""
    reach = 4
    row0, col0 = max(0, int(point[1]) - reach), max(0, int(point[0]) - reach)
    rows, cols = np.nonzero(passable[row0 : int(point[1]) + reach + 1, col0 : int(point[0]) + reach + 1])
    centres = np.column_stack([cols + col0, rows + row0]) + 0.5
    for i in np.argsort(((centres - point) ** 2).sum(axis=1), kind="stable"):
        if _clear(point, centres[i], walls, free, clearance):
            return int(centres[i, 1]), int(centres[i, 0])
    return None


def _pull_taut(
    points: NDArray[np.float64], walls: NDArray[np.float64], free: NDArray[np.bool_], clearance: float
) -> NDArray[np.float64]:
    """Skip every point that a straight line can skip; the farthest one is found by doubling, then halving."""
    keep = [0]
    while keep[-1] < len(points) - 1:
        here = keep[-1]
        good, step = here + 1, 2
        while here + step < len(points) and _clear(points[here], points[here + step], walls, free, clearance):
            good, step = here + step, step * 2
        bad = min(here + step, len(points))
        while bad - good > 1:
            middle = (good + bad) // 2
            if _clear(points[here], points[middle], walls, free, clearance):
                good = middle
            else:
                bad = middle
        keep.append(good)
    return points[keep]


def _finish(
    merged: MergedMap,
    grid: OccupancyGrid,
    points: NDArray[np.float64],
    walls: NDArray[np.float64],
    start_xy: tuple[float, float],
    goal_xy: tuple[float, float],
) -> Path:
    """Back to metres, with the clearance that the path really has."""
    from fleetmap.planners.grid_kernels import segment_clearance

    clearance = min(
        segment_clearance(a[0], a[1], b[0], b[1], walls, _FAR_CELLS)
        for a, b in zip(points[:-1], points[1:], strict=True)
    )
    points_xy = grid.origin.apply(points * grid.resolution_m)
    # Exactly what was asked for, and not what rounding to cells and back made of it.
    points_xy[0], points_xy[-1] = start_xy, goal_xy
    return Path(
        points_xy=points_xy,
        length_m=float(np.hypot(*np.diff(points_xy, axis=0).T).sum()),
        clearance_m=math.inf if clearance >= _FAR_CELLS else clearance * grid.resolution_m,
        map_error_m=(EPSILON_CELLS * merged.resolution_um + merged.tolerance * FLEET_UM) / 1e6,
    )
