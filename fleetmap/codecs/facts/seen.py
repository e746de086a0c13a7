"""Kind 11: where a landmark is, or was another robot, in the author's map frame; and where that one took itself to be.

Each comes with its standard deviations: aligners look nearby (``peer.align_facts.prior_of``).
"""

from __future__ import annotations

from dataclasses import dataclass

from fleetmap.codecs.facts.facts import Facts, FactsStep
from fleetmap.codecs.facts.pose import pack_pose, unpack_pose
from fleetmap.codecs.facts.sigma import BYTES
from fleetmap.codecs.names import check_name
from fleetmap.model.pose import FixedPose

KIND = 11
LANDMARK, ROBOT = b"l", b"r"
LIFE_BYTES = 8


@dataclass(frozen=True, slots=True)
class Seen:
    """Where something is.

    Parameters
    ----------
    pose : in the author's map frame
    sigma : standard deviations along each axis and of the yaw: micrometres and microradians
    theirs : of a robot: in its own map frame, as it had announced
    """

    pose: FixedPose
    sigma: tuple[int, int]
    theirs: FixedPose = FixedPose()


def landmarks_of(facts: Facts) -> dict[str, Seen]:
    """Landmarks by name."""
    return {key[1:].decode(): _unpack(value) for key, value in facts.of(KIND).items() if key[:1] == LANDMARK}


def sightings_of(facts: Facts) -> dict[tuple[str, int], Seen]:
    """Other robots: (robot, life) -> where each was."""
    return {
        (key[1 + LIFE_BYTES :].decode(), int.from_bytes(key[1 : 1 + LIFE_BYTES], "big")): _unpack(value)
        for key, value in facts.of(KIND).items()
        if key[:1] == ROBOT
    }


def set_landmark(name: str, seen: Seen | None) -> FactsStep:
    """The step that says where a landmark is, or takes that back."""
    return {bytes([KIND]) + LANDMARK + check_name("landmark", name).encode(): None if seen is None else _pack(seen)}


def set_sighting(robot: str, life: int, seen: Seen) -> FactsStep:
    """The step that says where another robot was."""
    return {bytes([KIND]) + ROBOT + life.to_bytes(LIFE_BYTES, "big") + robot.encode(): _pack(seen)}


def check(subject: bytes, value: bytes) -> None:
    """``ValueError`` (or ``ConfigError``) if this is no such fact."""
    if subject[:1] not in (LANDMARK, ROBOT) or len(value) <= 2 * BYTES:
        raise ValueError("expected a landmark or a robot, and where it was seen")
    name = subject[1:] if subject[:1] == LANDMARK else subject[1 + LIFE_BYTES :]
    check_name("landmark" if subject[:1] == LANDMARK else "robot", name.decode())
    _unpack(value)


def _pack(seen: Seen) -> bytes:
    pose = pack_pose(seen.pose)
    sigmas = b"".join(sigma.to_bytes(BYTES, "big") for sigma in seen.sigma)
    return sigmas + bytes([len(pose)]) + pose + pack_pose(seen.theirs)


def _unpack(value: bytes) -> Seen:
    sigma = int.from_bytes(value[:BYTES], "big"), int.from_bytes(value[BYTES : 2 * BYTES], "big")
    end = 2 * BYTES + 1 + value[2 * BYTES]
    return Seen(unpack_pose(value[2 * BYTES + 1 : end]), sigma, unpack_pose(value[end:]))
