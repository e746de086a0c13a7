"""Kind 3: T_robot_submap, where the frame of a submap lies in the robot's map frame; the identity unless it is said."""

from __future__ import annotations

from fleetmap.codecs.facts.facts import Facts, FactsStep
from fleetmap.codecs.facts.pose import pack_pose, unpack_pose
from fleetmap.codecs.names import check_name
from fleetmap.model.pose import FixedPose

KIND = 3


def anchor_of(facts: Facts, submap: str) -> FixedPose:
    """The anchor of a submap."""
    value = facts.of(KIND).get(submap.encode())
    return FixedPose() if value is None else unpack_pose(value)


def set_anchor(submap: str, anchor: FixedPose) -> FactsStep:
    """The step that says an anchor."""
    return {bytes([KIND]) + submap.encode(): None if anchor == FixedPose() else pack_pose(anchor)}


def check(subject: bytes, value: bytes) -> None:
    """``ValueError`` (or ``ConfigError``) if this is no such fact."""
    check_name("submap", subject.decode())
    unpack_pose(value)
