"""``align``: where one map lies in another, without being told anything.

1. ``candidates``: rotations by direction histograms, translations by votes of all walls at once (FFT)
2. ``refine``: the best of them to where walls meet lines, several at once
3. ``weigh``: what speaks for and against each, in metres of wall
4. ``judge``: whether the best one is true, and the only one
"""

from __future__ import annotations

import math

import numpy as np

from fleetmap.align.accept import judge, rival
from fleetmap.align.candidates import candidates
from fleetmap.align.evidence import weigh
from fleetmap.align.protocol import Alignment, Matrix
from fleetmap.align.refine import Poses, information, refine
from fleetmap.align.walls import Floats, Walls, walls_of
from fleetmap.model.pose import Pose2
from fleetmap.model.vectormap import VectorMap

HYPOTHESES = 20
"""So many candidates are refined."""
ELSEWHERE_M, ELSEWHERE_RAD = 0.5, math.radians(4.0)
"""What is farther from another hypothesis, anywhere in what both have, is another place."""
SIGMA_M = 0.025
"""Of a sight of a wall about the line that stands for it."""
ALIKE_OVER_M = 1.0
"""Sights along so much of a wall aren't independent."""
ZEROS: Matrix = ((0.0, 0.0, 0.0),) * 3


def align(a: VectorMap, b: VectorMap) -> Alignment:
    """Where b lies in a: p_a = T_a_b p_b.

    Notes
    -----
    The answer depends on the maps alone. It uses floats, so that other machines may give it in other last digits.
    """
    return align_walls(walls_of(a), walls_of(b))


def align_walls(a: Walls, b: Walls) -> Alignment:
    """The same of maps whose walls are known already."""
    found = candidates(a, b)[:HYPOTHESES]
    if not found:
        return Alignment("too_small", None, ZEROS, (0.0, 0.0), None, None, "no walls to compare")
    poses = refine(a, b, found)
    weighed = [(weigh(a, b, pose_of(row)), row) for row in poses.rows]
    best, row = max(weighed, key=lambda each: each[0].score_m)
    second = rival(evidence for evidence, other in weighed if elsewhere(a, b, row, other))
    outcome, text = judge(best, second)
    covariance, middle = spread(a, b, row) if outcome == "committed" else (ZEROS, (0.0, 0.0))
    return Alignment(outcome, pose_of(row), covariance, middle, best, second, text)


def pose_of(row: Floats) -> Pose2:
    """A row (x, y, yaw) as a pose."""
    x, y, yaw = (float(value) for value in row)
    return Pose2(x, y, math.remainder(yaw, math.tau))


def elsewhere(a: Walls, b: Walls, one: Floats, other: Floats) -> bool:
    """Whether two poses put what both maps have at different places."""
    if abs(math.remainder(float(one[2] - other[2]), math.tau)) > ELSEWHERE_RAD:
        return True
    first, second = Poses(np.stack([one, other])).apply(b.points_xy)
    return bool(np.hypot(*(first - second).T).max() > ELSEWHERE_M)


def spread(a: Walls, b: Walls, row: Floats) -> tuple[Matrix, tuple[float, float]]:
    """The covariance about the middle of the common walls, and that middle."""
    known, middle = information(a, b, Poses(row[None]))
    matrix = np.linalg.inv(known / (SIGMA_M**2 * ALIKE_OVER_M))
    rows = tuple((float(x), float(y), float(yaw)) for x, y, yaw in matrix)
    return rows, (float(middle[0]), float(middle[1]))
