"""What an aligner says of two maps: where one lies in the other, how sure that is, and why."""

from __future__ import annotations

from dataclasses import dataclass

from fleetmap.align.evidence import Evidence
from fleetmap.model.pose import Pose2

Matrix = tuple[tuple[float, float, float], ...]
"""Three rows of three."""


@dataclass(frozen=True, slots=True)
class Prior:
    """About where b lies in a, told by somebody: a rough start, a landmark that both saw, a sighting.

    Parameters
    ----------
    T_a_b : the place
    sigma_m, sigma_rad : standard deviations of where it puts ``pivot_xy``, along each axis, and of its yaw
    pivot_xy : metres in b: what it tells most about, as the landmark that both saw
    """

    T_a_b: Pose2
    sigma_m: float
    sigma_rad: float
    pivot_xy: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Alignment:
    """One outcome.

    Parameters
    ----------
    outcome : ``committed``: b lies there; ``ambiguous``: it fits at several places, or slides along one; ``conflict``:
        where it fits best, walls stand in space that the other saw as free; ``too_small``: hardly any wall is in both
    T_a_b : p_a = T_a_b p_b of the best hypothesis, whatever the outcome; None if there is none
    covariance : rows of the 3 x 3 matrix of (x, y, yaw), metres and radians, of an error on the left of ``T_a_b`` about
        ``middle_xy``; zeros unless committed
    middle_xy : in a: the middle of the walls that both have
    evidence : of that hypothesis; None if there is none
    second : of the best one that lies elsewhere; None if there is none
    text : the same in a sentence
    """

    outcome: str
    T_a_b: Pose2 | None
    covariance: Matrix
    middle_xy: tuple[float, float]
    evidence: Evidence | None
    second: Evidence | None
    text: str
