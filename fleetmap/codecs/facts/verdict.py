"""Kind 9: what a peer finds when it looks at an alignment that another one has said: it holds, or it doesn't.

It states the place that was looked at: of another place it says nothing, and of one nearby the same.
"""

from __future__ import annotations

from dataclasses import dataclass

from fleetmap.codecs.facts.alignment import SUBJECT_BYTES
from fleetmap.codecs.facts.facts import Facts, FactsStep
from fleetmap.codecs.facts.pose import pack_pose, unpack_pose
from fleetmap.codecs.names import check_name
from fleetmap.model.pose import FixedPose

KIND = 9
LIFE_BYTES, LENGTH_BYTES = 8, 4

About = tuple[str, int, bytes]
"""(robot, life, subject) of an alignment."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """On one alignment.

    Parameters
    ----------
    about : whose alignment, and its subject
    T_own_other : the place that was looked at, as its author has it
    explained_mm : how much wall it explains; 0: it doesn't hold
    """

    about: About
    T_own_other: FixedPose
    explained_mm: int


def verdicts_of(facts: Facts) -> list[Verdict]:
    """All that a stream says."""
    found = []
    for subject, value in facts.of(KIND).items():
        life, rest = int.from_bytes(subject[:LIFE_BYTES], "big"), subject[LIFE_BYTES:]
        about = rest[SUBJECT_BYTES:].decode(), life, rest[:SUBJECT_BYTES]
        explained_mm = int.from_bytes(value[:LENGTH_BYTES], "big")
        found.append(Verdict(about, unpack_pose(value[LENGTH_BYTES:]), explained_mm))
    return found


def set_verdict(verdict: Verdict) -> FactsStep:
    """The step that says a verdict."""
    value = verdict.explained_mm.to_bytes(LENGTH_BYTES, "big") + pack_pose(verdict.T_own_other)
    return {_key(verdict.about): value}


def drop_verdict(about: About) -> FactsStep:
    """The step that takes one back."""
    return {_key(about): None}


def check(subject: bytes, value: bytes) -> None:
    """``ValueError`` (or ``ConfigError``) if this is no such fact."""
    if len(subject) <= LIFE_BYTES + SUBJECT_BYTES or len(value) < LENGTH_BYTES:
        raise ValueError("expected a life, an alignment and a robot, and a length and a pose")
    check_name("robot", subject[LIFE_BYTES + SUBJECT_BYTES :].decode())
    unpack_pose(value[LENGTH_BYTES:])


def _key(about: About) -> bytes:
    robot, life, subject = about
    return bytes([KIND]) + life.to_bytes(LIFE_BYTES, "big") + subject + robot.encode()
