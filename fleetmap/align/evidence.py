"""Step 3: what speaks for a pose, and what against it: counted in metres of wall, both ways."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetmap.align.walls import CELL_M, Floats, Walls
from fleetmap.model.lattice import FREE
from fleetmap.model.pose import Pose2

NEAR_M = 0.15
"""Two sights of a wall are at most so far apart."""
DEEP_M = 0.25
"""A wall so deep in free space that the other has seen wasn't there."""
INSIDE_M = 0.1
"""So far on its free side it is looked whether the other knows a wall's place."""


MATCHED, LEAST_SEGMENT_M, LINES_APART_M = 0.6, 0.15, 0.3
"""A straight piece of wall counts if so much of it is explained, and it is so long; lines are so far apart."""
AGAINST = 3.0
"""So many metres of explained wall does a metre of contradicted wall outweigh."""
ROUGH_POINTS = 400
"""So many points of the second map tell which poses are worth a closer look."""
AREA_STEP = 2
"""Every so many cells of free space are looked at, along each axis."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """Of one pose.

    Parameters
    ----------
    explained_m : wall of either that the other has, too; the mean of both ways
    conflict_m : wall of either in the other's free space; the mean of both ways
    visible_m : wall of either where the other knows what is there; the mean of both ways
    fixed_m : how much of the explained wall holds the pose against a slide in the direction in which it slides best
    rms_m : distances between the explained walls
    lines : on how many different lines the explained walls lie: a match by chance has few
    long_m : how far the explained walls extend along their longer axis
    beside : how many times as much floor as both have one of the maps shows beside that; of the best pose alone
    """

    explained_m: float
    conflict_m: float
    visible_m: float
    fixed_m: float
    rms_m: float
    lines: int
    long_m: float
    beside: float = math.inf

    @property
    def score_m(self) -> float:
        """What is left of the explained wall for what contradicts it."""
        return self.explained_m - AGAINST * self.conflict_m


def weigh(a: Walls, b: Walls, T_a_b: Pose2) -> Evidence:
    """What speaks for and against a place of b in a."""
    sides = [one_way(a, b, T_a_b), one_way(b, a, T_a_b.inverse())]
    explained, conflict, visible, squares = (float(np.mean([side[k] for side, _ in sides])) for k in range(4))
    fixed = min(eigenvalues(*side[4:7])[0] for side, _ in sides)
    lines = min(lines for _, lines in sides)
    rms = float(np.sqrt(squares / max(explained, 1e-9)))
    return Evidence(explained, conflict, visible, fixed, rms, lines, min(extent_m(side) for side, _ in sides))


def roughly(a: Walls, b: Walls, rows: Floats) -> tuple[Floats, Floats]:
    """(n,) about the score of each pose (n, 3), rows (x, y, yaw), and what it explains: by some points of b."""
    from fleetmap.align import match_kernels

    each = max(1, len(b.table) // ROUGH_POINTS)
    points = np.ascontiguousarray(b.table[::each])
    matched = np.zeros(len(points), bool)
    sums = np.array([match_kernels.one_way(*a.index, points, row, *known(a), matched)[:2] for row in rows])
    explained, conflict = each * sums.reshape(-1, 2).T
    return explained - conflict, explained


def known(a: Walls) -> tuple[NDArray[np.float32], NDArray[np.uint8], Floats]:
    """What a knows, as ``match_kernels.one_way`` takes it."""
    return a.clearance_m, a.states_yx, np.array([*a.corner_xy, CELL_M, NEAR_M, DEEP_M, INSIDE_M])


def one_way(a: Walls, b: Walls, T_a_b: Pose2) -> tuple[Floats, int]:
    """Of the walls of b what ``match_kernels.one_way`` gives, and on how many lines those lie that a has, too."""
    from fleetmap.align import match_kernels

    pose = np.array([T_a_b.x_m, T_a_b.y_m, T_a_b.yaw_rad])
    matched = np.zeros(len(b.table), bool)
    sums = match_kernels.one_way(*a.index, b.table, pose, *known(a), matched)
    lines = match_kernels.count_lines(b.table, b.segments, matched, MATCHED, LEAST_SEGMENT_M, LINES_APART_M)
    return sums, lines


def extent_m(sums: Floats) -> float:
    """How long a straight wall would be that is spread as the matched points are."""
    metres, x, y, xx, xy, yy = sums[[0, 7, 8, 9, 10, 11]] / max(sums[0], 1e-9)
    spread = eigenvalues(xx - x * x, xy - x * y, yy - y * y)[1]
    return float(np.sqrt(12 * max(spread, 0.0))) if metres else 0.0


def eigenvalues(xx: float, xy: float, yy: float) -> tuple[float, float]:
    """Of a symmetric matrix of two rows, the lesser one first."""
    middle, half = (xx + yy) / 2, float(np.hypot((xx - yy) / 2, xy))
    return float(middle - half), float(middle + half)


def beside(a: Walls, b: Walls, T_a_b: Pose2) -> float:
    """How many times as much free space as both have the map shows beside that which shows more."""
    most_m2 = max(float((walls.states_yx == FREE).sum()) for walls in (a, b)) * CELL_M**2
    return most_m2 / max(common_m2(a, b, T_a_b), CELL_M**2) - 1


def common_m2(a: Walls, b: Walls, T_a_b: Pose2) -> float:
    """How much free space both maps have."""
    rows, columns = np.nonzero(b.states_yx[::AREA_STEP, ::AREA_STEP] == FREE)
    centres = b.corner_xy + (AREA_STEP * np.column_stack([columns, rows]) + 0.5) * CELL_M
    column, row = np.floor((T_a_b.apply(centres) - a.corner_xy) / CELL_M).astype(np.int64).T
    height, width = a.states_yx.shape
    inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
    there = a.states_yx[np.where(inside, row, 0), np.where(inside, column, 0)] == FREE
    return float((there & inside).sum()) * (AREA_STEP * CELL_M) ** 2
