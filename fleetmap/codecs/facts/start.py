"""Kind 2: T_fleet_robot, where the robot's map frame lies in the fleet's; unknown unless it is said."""

from __future__ import annotations

from fleetmap.codecs.facts.facts import Facts, FactsStep
from fleetmap.codecs.facts.pose import pack_pose, unpack_pose
from fleetmap.model.pose import FixedPose

KIND = 2
_KEY = bytes([KIND])


def start_of(facts: Facts) -> FixedPose | None:
    """The start of a stream; None if it is unknown."""
    value = facts.get(_KEY)
    return None if value is None else unpack_pose(value)


def set_start(start: FixedPose | None) -> FactsStep:
    """The step that says a start, or that it is unknown."""
    return {_KEY: None if start is None else pack_pose(start)}


def check(subject: bytes, value: bytes) -> None:
    """``ValueError`` if this is no such fact."""
    if subject:
        raise ValueError("a stream has one start")
    unpack_pose(value)
