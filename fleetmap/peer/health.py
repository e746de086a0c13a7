"""What is wrong, in words that say what to do."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from fleetmap.codecs.envelope import VERSION
from fleetmap.engine import Engine
from fleetmap.model.frame import Frame
from fleetmap.peer.alignments import contradicted_starts, not_merged

MAX_NAMED = 5
UNKNOWN_REASON = (
    "something listens there, but no link comes up: it is no fleetmap, or lets this robot not in, or is hung or very "
    "busy"
)


@dataclass(frozen=True, slots=True)
class Problem:
    """Something that a user should know of.

    Parameters
    ----------
    kind : ``disputed``: what a robot has said is contradicted, and nobody can tell who is right; ``fleet``: robots of
        other fleets are there, and none of the own; ``left out``: a map is not in the merged one; ``namesake``: another
        living peer has the own name; ``not merged``: a robot is there, and where its map lies can't be told yet;
        ``router``: robots can't be heard through a router; ``start``: a robot lies elsewhere than its start says;
        ``unreachable``: nobody was reached at an endpoint; ``version``: a robot speaks another version of the protocol
    robot : whom it is about; or the endpoint
    text : what was found, and what to do
    """

    kind: str
    robot: str
    text: str


def problems(engine: Engine, left_out: Iterable[tuple[Frame, str]], network: Iterable[Problem]) -> tuple[Problem, ...]:
    """All problems of now, by kind and whom they are about.

    Parameters
    ----------
    left_out : (frame, reason) of maps that the last fold left out
    network : what the link found
    """
    found = [
        Problem("disputed", robot, f"{text}. forget({robot!r}) leaves it out of the merged map")
        for robot, text in engine.disputed().items()
    ]
    beside = [n for n in list(engine.neighbours.by_key.values()) if n.key[0] == engine.robot and n.spoke]
    if beside:
        lives = ", ".join(f"{n.key[1]:016x}" for n in beside)
        text = (
            f"another living peer is named {engine.robot} too (life {lives}): both maps are merged. Give each robot a "
            "name of its own, or end the other process"
        )
        found.append(Problem("namesake", engine.robot, text))
    found += [other_version(robot, version) for robot, version in list(engine.other_versions.items())]
    reasons: dict[str, list[str]] = {}
    for (robot, life, submap), reason in left_out:
        reasons.setdefault(robot, []).append(f"submap {submap} (life {life:016x}): {reason}")
    for robot, (first, *more) in reasons.items():
        whose = "the own map" if robot == engine.robot else f"the map of {robot}"
        rest = f"; and {len(more)} more" if more else ""
        found.append(Problem("left out", robot, f"left out of the merged map: {whose}, {first}{rest}"))
    found += [
        Problem("not merged", robot, f"not merged with {robot}: {why}") for robot, why in not_merged(engine).items()
    ]
    found += [
        Problem("start", robot, f"the start of {robot} contradicts the map by {off}; the map is believed")
        for robot, off in contradicted_starts(engine).items()
    ]
    return tuple(sorted([*found, *network], key=lambda problem: (problem.kind, problem.robot)))


def other_version(robot: str, version: int) -> Problem:
    """A robot speaks another version of the protocol, 0 where it isn't said which."""
    speaks = f"version {version}" if version else "another version"
    text = f"{robot} speaks {speaks} of the protocol, and this one version {VERSION}: neither understands the other"
    return Problem("version", robot, f"{text}. Install the same fleetmap on both")


def unreachable(endpoint: str, reason: str | None) -> Problem:
    """Nobody was reached at an endpoint that is dialled; ``reason``: None if it can't be told."""
    return Problem("unreachable", endpoint, f"no link to {endpoint}: {reason or UNKNOWN_REASON}")


def other_fleets(fleet: str, others: Sequence[str]) -> Problem:
    """Nobody of the own fleet is there, but robots of others."""
    names = ", ".join(others[:MAX_NAMED])
    text = f"no robot of fleet {fleet!r} there, but robots of {names}: join one of these, if that is meant"
    return Problem("fleet", names, text)


def only_router(endpoints: Sequence[str]) -> Problem:
    """A router answers where a robot was to be, and no robot of the fleet is heard."""
    names = ", ".join(endpoints[:MAX_NAMED])
    text = (
        f"a router listens at {names}, and no robot of the fleet is there: is it that of ROS? Robots listen elsewhere"
    )
    return Problem("router", names, text)


def behind_router(robots: Sequence[str]) -> Problem:
    """Robots that a client hears by way of a router, and a peer doesn't."""
    names = ", ".join(robots[:MAX_NAMED]) + (f" and {len(robots) - MAX_NAMED} more" if len(robots) > MAX_NAMED else "")
    text = (
        f"{names} and this robot are behind a router, which passes nothing on between peers: join with "
        'config={"mode": "client"}, or give connect= the address of a robot'
    )
    return Problem("router", names, text)
