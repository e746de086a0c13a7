"""How good a run was: coverage and error of the merged map against the true world."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.lattice import FREE
from fleetmap.model.mergedmap import FLEET_UM, MergedMap
from fleetmap.model.pose import Pose2
from fleetmap.sims.worlds import World

LOOKOUT_M = 0.8
"""Pitch of the places from which the visible walls are determined."""

SAMPLE_M = 0.025
"""Merged edges are compared with the truth at points this far apart."""


@dataclass(frozen=True, slots=True)
class MapError:
    """Distances in metres between true walls and merged obstacle edges, each way and taken together."""

    median: float
    p95: float
    truth_to_map_median: float
    truth_to_map_p95: float
    map_to_truth_median: float
    map_to_truth_p95: float


def covered(merged: MergedMap, T_world_merged: Pose2, world: World, reachable: NDArray[np.bool_]) -> float:
    """Share of the reachable cells whose centre is free in the merged map."""
    step_m = FLEET_UM / 1e6
    grid = merged.to_grid(max(1, round(world.resolution_m / step_m)) * step_m if world.resolution_m < 0.05 else None)
    xy = T_world_merged.inverse().apply(world.centres_xy(np.argwhere(reachable)))
    cells = np.floor(grid.origin.inverse().apply(xy)[:, ::-1] / grid.resolution_m).astype(np.int64)
    inside = ((cells >= 0) & (cells < grid.cells_yx.shape)).all(axis=1)
    cells = cells[inside]
    states = grid.states_yx()
    return float((states[cells[:, 0], cells[:, 1]] == FREE).sum() / max(1, len(xy)))


def map_error(
    merged: MergedMap, T_world_merged: Pose2, world: World, reachable: NDArray[np.bool_], *, range_m: float
) -> MapError:
    """True walls that a robot could see against merged obstacle edges, and merged edges against all true walls.

    ``median`` and ``p95`` are of the worse direction. NaN when there is nothing to compare.
    """
    import shapely

    edges = T_world_merged.apply(merged.segments_xy[merged.obstacle])
    every, seen = wall_cracks(world), wall_cracks(world, visible_solid(world, reachable, range_m=range_m))
    if not len(edges) or not len(seen):
        return MapError(*[math.nan] * 6)
    walls = shapely.STRtree(shapely.linestrings(edges))
    missing = walls.query_nearest(shapely.points(seen.mean(axis=1)), return_distance=True, all_matches=False)[1]
    truth = shapely.STRtree(shapely.linestrings(every))
    wrong = truth.query_nearest(shapely.points(along(edges)), return_distance=True, all_matches=False)[1]
    forth = [float(np.median(missing)), float(np.percentile(missing, 95))]
    back = [float(np.median(wrong)), float(np.percentile(wrong, 95))]
    return MapError(max(forth[0], back[0]), max(forth[1], back[1]), *forth, *back)


def wall_cracks(world: World, solid: NDArray[np.bool_] | None = None) -> NDArray[np.float64]:
    """(n, 2, 2) metres, world frame: borders between free cells and solid ones, of ``solid`` cells only if given."""
    open_cells = ~world.solid
    wall = world.solid if solid is None else solid
    parts = []
    for turned in (False, True):
        a, b = (open_cells.T, wall.T) if turned else (open_cells, wall)
        rows, columns = np.nonzero((a[1:] & b[:-1]) | (b[1:] & a[:-1]))
        # Between rows i and i + 1, from column j to j + 1: points (x, y) = (j, i + 1) and (j + 1, i + 1).
        ends = np.stack([np.column_stack([columns, rows + 1]), np.column_stack([columns + 1, rows + 1])], axis=1)
        parts.append(ends[..., ::-1] if turned else ends)
    return world.origin.apply(np.concatenate(parts) * world.resolution_m)


def visible_solid(world: World, reachable: NDArray[np.bool_], *, range_m: float) -> NDArray[np.bool_]:
    """(h, w) solid cells that a lidar hits from some place that a robot can reach."""
    from fleetmap.sims.lidar_kernels import cast

    beams = 720
    angles = np.arange(beams) * (2 * math.pi / beams)
    step = max(1, round(LOOKOUT_M / world.resolution_m))
    cells = np.argwhere(reachable)
    # One lookout in each square of the pitch that holds a reachable cell.
    _, first = np.unique(cells // step, axis=0, return_index=True)
    seen = np.zeros_like(world.solid)
    height, width = world.solid.shape
    reach = range_m / world.resolution_m
    for row, column in cells[first].tolist():
        y, x = row + 0.5, column + 0.5
        distance = cast(world.solid, x, y, 0.0, beams, reach)
        hit = distance < reach
        # A little behind the border that was hit lies the cell.
        behind = distance[hit] + 1e-6
        i = np.floor(y + behind * np.sin(angles[hit])).astype(int)
        j = np.floor(x + behind * np.cos(angles[hit])).astype(int)
        inside = (i >= 0) & (j >= 0) & (i < height) & (j < width)
        seen[i[inside], j[inside]] = True
    return seen & world.solid


def along(segments_xy: NDArray[np.float64]) -> NDArray[np.float64]:
    """(k, 2) points on the segments (n, 2, 2), at most ``SAMPLE_M`` apart; each stands for about as much length."""
    lengths = np.hypot(*(segments_xy[:, 1] - segments_xy[:, 0]).T)
    counts = np.maximum(1, np.ceil(lengths / SAMPLE_M)).astype(int)
    which = np.repeat(np.arange(len(counts)), counts)
    place = (np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts, counts) + 0.5) / counts[which]
    start, end = segments_xy[which, 0], segments_xy[which, 1]
    points: NDArray[np.float64] = start + place[:, None] * (end - start)
    return points
