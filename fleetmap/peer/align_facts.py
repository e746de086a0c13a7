"""Between what an aligner finds, in floats, and what is said of it, in whole numbers."""

from __future__ import annotations

import math

import numpy as np

from fleetmap.align.protocol import Alignment, Prior
from fleetmap.codecs.facts import AlignmentFact, Weight
from fleetmap.engine.stream import Stream
from fleetmap.model.errors import ConfigError
from fleetmap.model.frame import Frame
from fleetmap.model.pose import FixedPose, Pose2

AROUND_M = 3.0


def as_fact(submap: str, other: Frame, found: Alignment, outcome: str) -> AlignmentFact:
    """What is said of a pair."""
    if found.T_a_b is None or found.evidence is None:
        return AlignmentFact(submap, other, outcome)
    scale = np.outer([1e6, 1e6, 1e6], [1e6, 1e6, 1e6])
    (xx, xy, xt), (_, yy, yt), (_, _, tt) = np.rint(np.array(found.covariance) * scale).astype(np.int64).tolist()
    x, y = found.middle_xy
    explained, conflict, visible, fixed = (
        _mm(value) for value in (found.evidence.explained_m, found.evidence.conflict_m, found.evidence.visible_m,
                                 found.evidence.fixed_m)
    )  # fmt: skip
    second = _mm(found.second.explained_m) if found.second is not None else 0
    return AlignmentFact(
        submap,
        other,
        outcome,
        FixedPose.from_pose(found.T_a_b),
        (xx, xy, xt, yy, yt, tt),
        (round(x * 1e6), round(y * 1e6)),
        Weight(explained, conflict, visible, fixed, second),
    )


def moved_m(found: Alignment, T_a_b: Pose2) -> tuple[float, float]:
    """How far a place lies from another one within a few metres of what both have, and a standard deviation of that."""
    if found.T_a_b is None:
        return 0.0, 0.0
    x, y = found.middle_xy
    around = np.array([(x, y), (x + AROUND_M, y), (x - AROUND_M, y), (x, y + AROUND_M), (x, y - AROUND_M)])
    away = T_a_b.apply(found.T_a_b.inverse().apply(around)) - around
    (xx, _, _), (_, yy, _), (_, _, turn) = found.covariance
    return float(np.hypot(*away.T).max()), math.sqrt(xx + yy + AROUND_M**2 * turn)


def prior_of(own: Stream, submap: str, other: Stream, theirs: str) -> Prior | None:
    """Where the other submap lies in the own one by the starts of both robots; None if either has none."""
    if own.start is None or other.start is None:
        return None
    try:
        T_a_b = (own.start @ own.anchor(submap)).inverse() @ (other.start @ other.anchor(theirs))
    except ConfigError:
        return None
    sigma_m = math.hypot(own.start_sigma[0], other.start_sigma[0]) / 1e6
    sigma_rad = math.hypot(own.start_sigma[1], other.start_sigma[1]) / 1e6
    away_m = math.hypot(T_a_b.x_um, T_a_b.y_um) / 1e6
    return Prior(T_a_b.to_pose(), math.hypot(sigma_m, sigma_rad * away_m), sigma_rad)


def exact(own: Stream, other: Stream) -> bool:
    """Whether both starts are to be believed whatever the maps say."""
    return None not in (own.start, other.start) and own.start_sigma == other.start_sigma == (0, 0)


def _mm(metres: float) -> int:
    return round(max(metres, 0.0) * 1e3)
