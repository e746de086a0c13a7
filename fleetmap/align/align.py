"""``align``: where one map lies in another, without being told anything.

1. ``candidates``: rotations by direction histograms, translations by votes of all walls at once (FFT)
2. ``refine``: the best of them to where walls meet lines, several at once
3. ``weigh``: what speaks for and against each, in metres of wall
4. ``judge``: whether the best one is true, and the only one; and whether the mirror image of the map fits as well
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fleetmap.align.accept import is_mirrored, judge, order, rival, sentence
from fleetmap.align.candidates import Window, candidates, vote_cell_m
from fleetmap.align.evidence import Evidence, beside, roughly, weigh
from fleetmap.align.protocol import Alignment, Matrix, Prior
from fleetmap.align.refine import ROUGH_CELLS, ROUGH_POINTS, ROUGH_STEPS, STAGES, information, refine
from fleetmap.align.walls import Floats, Walls, mirrored, walls_of
from fleetmap.model.pose import Pose2
from fleetmap.model.vectormap import VectorMap

LEAST_RIVAL_M, PROMISING = 4.0, 0.4
"""What explains less before it is refined isn't worth that, half of what a rival explains at least; and of a mirror
image what explains less than such a share of the best place."""
HYPOTHESES = 30
"""So many candidates are refined to the end."""
ELSEWHERE_M, ELSEWHERE_RAD = 0.5, math.radians(4.0)
"""What is farther from another hypothesis, anywhere in the second map, is another place."""
SIGMAS, BESIDE_M, BESIDE_RAD = 4.0, 0.5, math.radians(3.0)
"""A place that is farther from a prior, by so many standard deviations and so much, isn't what it means."""
SIGMA_M = 0.025
"""Of a sight of a wall about the line that stands for it."""
ALIKE_OVER_M = 1.0
"""Sights along so much of a wall aren't independent."""
Hypothesis = tuple[Evidence, Floats]
ZEROS: Matrix = ((0.0, 0.0, 0.0),) * 3


def align(a: VectorMap, b: VectorMap, prior: Prior | None = None) -> Alignment:
    """Where b lies in a: p_a = T_a_b p_b.

    Parameters
    ----------
    prior : about where it lies, if that is known: other places aren't looked at, and rule out nothing

    Notes
    -----
    The answer depends on the maps alone. It uses floats, so that other machines may give it in other last digits.
    """
    return align_walls(walls_of(a), walls_of(b), prior)


def align_walls(a: Walls, b: Walls, prior: Prior | None = None) -> Alignment:
    """The same of maps whose walls are known already."""
    answer = decide(a, b, hypotheses(a, b, prior))
    if answer.outcome != "committed" or answer.evidence is None or prior is not None:
        return answer
    images = hypotheses(a, mirrored(b), least_m=PROMISING * answer.evidence.explained_m)
    image = rival(answer.evidence, (evidence for evidence, _ in images))
    if image is None or not is_mirrored(answer.evidence, image):
        return answer
    text = f"its mirror image fits as well: {answer.evidence.explained_m:.1f} m and {image.explained_m:.1f} m explained"
    return replace(answer, outcome="ambiguous", covariance=ZEROS, second=image, text=text)


def check(a: Walls, b: Walls, T_a_b: Pose2) -> Alignment:
    """Whether a place that was found before still holds, and where it is now: without a look at any other place."""
    return decide(a, b, ranked(a, b, refine(a, b, np.array([row_of(T_a_b)]), STAGES[1:])))


def decide(a: Walls, b: Walls, found: Sequence[Hypothesis]) -> Alignment:
    """What follows from hypotheses, the best first."""
    if not found:
        return Alignment("too_small", None, ZEROS, (0.0, 0.0), None, None, "no walls to compare")
    (best, row), *others = found
    apart = elsewhere(b, row, np.array([other for _, other in others]).reshape(-1, 3))
    second = rival(best, (evidence for (evidence, _), there in zip(others, apart, strict=True) if there))
    T_a_b = pose_of(row)
    best = replace(best, beside=beside(a, b, T_a_b))
    outcome = judge(best, second)
    text = sentence(
        outcome,
        explained_m=best.explained_m,
        conflict_m=best.conflict_m,
        visible_m=best.visible_m,
        fixed_m=best.fixed_m,
        second_m=0.0 if second is None else second.explained_m,
    )
    covariance, middle = spread(a, b, row) if outcome == "committed" else (ZEROS, (0.0, 0.0))
    return Alignment(outcome, T_a_b, covariance, middle, best, second, text)


def hypotheses(a: Walls, b: Walls, prior: Prior | None = None, *, least_m: float = LEAST_RIVAL_M) -> list[Hypothesis]:
    """Places of b in a, the best first: what speaks for each, and its row (x, y, yaw).

    ``least_m`` : those that explain less wall, as it looks from afar, aren't looked at, but for the best one
    """
    if not len(a.points_xy) or not len(b.points_xy):
        return []
    window = None if prior is None else window_of(prior)
    places = candidates(a, b, window)
    if prior is not None:
        places = np.vstack([[row_of(prior.T_a_b)], places])
    stage = ROUGH_CELLS * vote_cell_m(a, b), ROUGH_STEPS, ROUGH_POINTS
    rough = refine(a, b, places, [stage])
    score_m, explained_m = roughly(a, b, rough)
    distinct: list[Floats] = []
    for k in np.argsort(-score_m, kind="stable"):
        is_meant = window is None or window.has(rough[k])
        is_worth_it = not distinct or (explained_m[k] >= least_m and len(distinct) < HYPOTHESES)
        if is_meant and is_worth_it and elsewhere(b, rough[k], np.array(distinct).reshape(-1, 3)).all():
            distinct.append(rough[k])
    return ranked(a, b, refine(a, b, np.array(distinct))) if distinct else []


def window_of(prior: Prior) -> Window:
    """The places that a prior may mean."""
    radius_m, radius_rad = SIGMAS * prior.sigma_m + BESIDE_M, SIGMAS * prior.sigma_rad + BESIDE_RAD
    x, y = prior.T_a_b.apply(prior.pivot_xy)
    return Window(prior.pivot_xy, (float(x), float(y)), prior.T_a_b.yaw_rad, radius_m, radius_rad)


def ranked(a: Walls, b: Walls, rows: Floats) -> list[Hypothesis]:
    """What speaks for each pose, the best first."""
    weighed = [(weigh(a, b, pose_of(row)), row) for row in rows]
    return sorted(weighed, key=lambda each: (*order(each[0]), *each[1].tolist()))


def row_of(pose: Pose2) -> tuple[float, float, float]:
    """A pose as a row (x, y, yaw)."""
    return pose.x_m, pose.y_m, pose.yaw_rad


def pose_of(row: Floats) -> Pose2:
    """A row (x, y, yaw) as a pose."""
    x, y, yaw = (float(value) for value in row)
    return Pose2(x, y, math.remainder(yaw, math.tau))


def elsewhere(b: Walls, one: Floats, others: Floats) -> NDArray[np.bool_]:
    """(n,) whether a pose (x, y, yaw) puts b at another place than each of others (n, 3)."""
    c, s = np.cos(others[:, 2:]), np.sin(others[:, 2:])
    x, y = b.outline_xy.T
    there = pose_of(one).apply(b.outline_xy)
    apart = np.hypot(others[:, :1] + c * x - s * y - there[:, 0], others[:, 1:2] + s * x + c * y - there[:, 1])
    turned = np.abs(np.remainder(others[:, 2] - one[2] + math.pi, math.tau) - math.pi)
    found: NDArray[np.bool_] = (apart.max(axis=1) > ELSEWHERE_M) | (turned > ELSEWHERE_RAD)
    return found


def spread(a: Walls, b: Walls, row: Floats) -> tuple[Matrix, tuple[float, float]]:
    """The covariance about the middle of the common walls, and that middle."""
    known, middle = information(a, b, row)
    matrix = np.linalg.inv(known / (SIGMA_M**2 * ALIKE_OVER_M))
    rows = tuple((float(x), float(y), float(yaw)) for x, y, yaw in matrix)
    return rows, (float(middle[0]), float(middle[1]))
