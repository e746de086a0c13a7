"""Between what an aligner finds, in floats, and what is said of it, in whole numbers."""

from __future__ import annotations

import math

import numpy as np

from fleetmap.align.protocol import Alignment, Prior
from fleetmap.codecs.facts import AlignmentFact, Seen, Weight, landmarks_of, sightings_of
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
    """Where the other submap lies in the own one by what both robots have seen: each other, or one landmark.

    The most exact one counts; None if there is none.
    """
    told = []
    if (seen := sightings_of(own.facts).get(other.key)) is not None:
        told.append((seen.pose, seen.theirs, (seen,)))
    if (seen := sightings_of(other.facts).get(own.key)) is not None:
        told.append((seen.theirs, seen.pose, (seen,)))
    mine, others = landmarks_of(own.facts), landmarks_of(other.facts)
    both: list[tuple[FixedPose, FixedPose, tuple[Seen, ...]]] = [
        *told,
        *((mine[k].pose, others[k].pose, (mine[k], others[k])) for k in sorted(mine.keys() & others.keys())),
    ]
    found = []
    for T_own_it, T_other_it, by in both:
        try:
            T_a_it, T_b_it = own.anchor(submap).inverse() @ T_own_it, other.anchor(theirs).inverse() @ T_other_it
            T_a_b = (T_a_it @ T_b_it.inverse()).to_pose()
        except ConfigError:
            continue
        sigma_m = math.hypot(*(seen.sigma[0] for seen in by)) / 1e6
        sigma_rad = math.hypot(*(seen.sigma[1] for seen in by)) / 1e6
        found.append(Prior(T_a_b, sigma_m, sigma_rad, (T_b_it.x_um / 1e6, T_b_it.y_um / 1e6)))
    return min(found, key=lambda prior: prior.sigma_m, default=None)


def prior_of_starts(own: Stream, submap: str, other: Stream, theirs: str) -> Prior | None:
    """Where it lies by the starts of both robots; None if either has none."""
    if own.start is None or other.start is None:
        return None
    try:
        T_own_other = own.start.inverse() @ other.start
        T_a_b = own.anchor(submap).inverse() @ T_own_other @ other.anchor(theirs)
        T_b_other = other.anchor(theirs).inverse()
    except ConfigError:
        return None
    # An error of the own yaw moves the other map's origin by more, the farther that is.
    by_yaw_m = own.start_sigma[1] / 1e6 * math.hypot(T_own_other.x_um, T_own_other.y_um) / 1e6
    sigma_m = math.hypot(own.start_sigma[0] / 1e6, other.start_sigma[0] / 1e6, by_yaw_m)
    sigma_rad = math.hypot(own.start_sigma[1], other.start_sigma[1]) / 1e6
    return Prior(T_a_b.to_pose(), sigma_m, sigma_rad, (T_b_other.x_um / 1e6, T_b_other.y_um / 1e6))


def exact(own: Stream, other: Stream) -> bool:
    """Whether both starts are to be believed whatever the maps say."""
    return None not in (own.start, other.start) and own.start_sigma == other.start_sigma == (0, 0)


def _mm(metres: float) -> int:
    return round(max(metres, 0.0) * 1e3)
