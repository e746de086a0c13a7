"""Kind 8: where a frame of another life lies in one of the author's own, or why that can't be told.

A stream names an alignment by the hash of its two frames, so that long names fit into a key.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass
from functools import lru_cache

import msgpack

from fleetmap.codecs.facts.facts import Facts, FactsStep
from fleetmap.codecs.facts.pose import pack_pose, unpack_pose
from fleetmap.codecs.names import check_name
from fleetmap.model.frame import Frame
from fleetmap.model.hashing import hash_bytes
from fleetmap.model.pose import FixedPose

KIND = 8
SUBJECT_BYTES = 8
SALT_SUBJECT = 20
MAX_MM = 1 << 31
MAX_UM = 1 << 44
MAX_VARIANCE = 1 << 62
"""Of micrometres and microradians: two kilometres, squared."""
OUTCOMES = ("committed", "provisional", "ambiguous", "conflict", "too_small")
"""In this order on the wire."""


@dataclass(frozen=True, slots=True)
class Weight:
    """What speaks for and against an alignment, in whole millimetres of wall.

    Parameters
    ----------
    explained, conflict, visible, fixed : as ``align.Evidence`` has them
    second : explained by the best place elsewhere that could be true, too
    """

    explained: int = 0
    conflict: int = 0
    visible: int = 0
    fixed: int = 0
    second: int = 0


@dataclass(frozen=True, slots=True)
class AlignmentFact:
    """What a stream says of one of its submaps and another frame.

    Parameters
    ----------
    submap : of the author's own
    other : the other frame
    outcome : one of ``OUTCOMES``
    T_own_other : of the best hypothesis, from the other submap's frame to the own one's
    covariance : xx, xy, x yaw, yy, y yaw, yaw yaw of an error on the left of ``T_own_other`` about ``middle_um``, in
        micrometres and microradians; zeros unless committed or provisional
    middle_um : (x, y) in the own submap
    weight : the evidence
    """

    submap: str
    other: Frame
    outcome: str
    T_own_other: FixedPose = FixedPose()
    covariance: tuple[int, int, int, int, int, int] = (0,) * 6
    middle_um: tuple[int, int] = (0, 0)
    weight: Weight = Weight()

    @property
    def subject(self) -> bytes:
        """What it is about, as the key of the fact has it."""
        return subject_of(self.submap, self.other)

    def pack(self) -> bytes:
        """The value of the fact."""
        robot, life, submap = self.other
        rest = (*self.covariance, *self.middle_um, *astuple(self.weight))
        outcome = OUTCOMES.index(self.outcome)
        packed: bytes = msgpack.packb([self.submap, robot, life, submap, outcome, pack_pose(self.T_own_other), *rest])
        return packed


@lru_cache(4096)
def subject_of(submap: str, other: Frame) -> bytes:
    """The subject of an alignment between an own submap and another frame."""
    robot, life, theirs = other
    return hash_bytes(f"{submap}/{robot}/{life}/{theirs}".encode(), SALT_SUBJECT).to_bytes(SUBJECT_BYTES, "big")


def alignments_of(facts: Facts) -> list[AlignmentFact]:
    """All that a stream says, in the order of their keys."""
    return [unpack(value) for value in facts.of(KIND).values()]


def alignment_of(facts: Facts, submap: str, other: Frame) -> AlignmentFact | None:
    """What is said of an own submap and another frame."""
    value = facts.of(KIND).get(subject_of(submap, other))
    return None if value is None else unpack(value)


def set_alignment(fact: AlignmentFact) -> FactsStep:
    """The step that says an alignment."""
    return {bytes([KIND]) + fact.subject: fact.pack()}


def drop_alignment(submap: str, other: Frame) -> FactsStep:
    """The step that takes back what was said of two frames."""
    return {bytes([KIND]) + subject_of(submap, other): None}


@lru_cache(4096)
def unpack(value: bytes) -> AlignmentFact:
    """The alignment in a value; ``ValueError`` (or ``ConfigError``) if it is none, or not as ``pack`` writes it."""
    try:
        row = msgpack.unpackb(value, max_map_len=0, max_ext_len=0, max_array_len=19)
    except (ValueError, msgpack.exceptions.UnpackException) as error:
        raise ValueError(f"expected an alignment: {error}") from None
    if not isinstance(row, list) or [type(field) for field in row] != [str, str, int, str, int, bytes, *[int] * 13]:
        raise ValueError("expected an alignment of 19 fields")
    submap, robot, life, theirs, outcome, pose = row[:6]
    if not 0 <= life < 1 << 64 or not 0 <= outcome < len(OUTCOMES):
        raise ValueError("a life or an outcome is out of bounds")
    for what, name in (("submap", submap), ("robot", robot), ("submap", theirs)):
        check_name(what, name)
    covariance, middle, weight = row[6:12], row[12:14], row[14:]
    if max(map(abs, covariance)) > MAX_VARIANCE or min(covariance[0], covariance[3], covariance[5]) < 0:
        raise ValueError("a covariance is out of bounds")
    if max(map(abs, middle)) > MAX_UM or not all(0 <= number <= MAX_MM for number in weight):
        raise ValueError("a number is out of bounds")
    fact = AlignmentFact(
        submap, (robot, life, theirs), OUTCOMES[outcome], unpack_pose(pose), tuple(covariance), tuple(middle),
        Weight(*weight),
    )  # fmt: skip
    if fact.pack() != value:
        raise ValueError("expected an alignment in its shortest form")
    return fact


def check(subject: bytes, value: bytes) -> None:
    """``ValueError`` (or ``ConfigError``) if this is no such fact."""
    if unpack(value).subject != subject:
        raise ValueError("an alignment isn't about what its key says")
