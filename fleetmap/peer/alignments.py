"""What a user sees of alignments."""

from __future__ import annotations

import math
from dataclasses import dataclass

from fleetmap.align.accept import sentence
from fleetmap.engine import Engine
from fleetmap.engine.alignments import Said
from fleetmap.engine.components import Components
from fleetmap.engine.stream import Stream
from fleetmap.model.frame import Frame
from fleetmap.model.pose import Pose2

WHAT_NEXT = {
    "committed": "; waits for another robot to confirm it",
    "provisional": "",
    "ambiguous": "; saw_landmark() of what both have seen, or saw() of each other, would tell",
    "conflict": "",
    "too_small": "; when both have seen more of the same, it is looked at again",
}
"""What a user may do, or wait for."""
STARTS_DIFFER_M, STARTS_DIFFER_RAD = 0.05, math.radians(0.5)


@dataclass(frozen=True, slots=True)
class AlignmentInfo:
    """What was found of a pair of frames.

    Parameters
    ----------
    a, b : (robot, life, submap); the robot of a has looked
    outcome : ``committed``: b lies there; ``provisional``: it may, once it is found again in maps that have grown;
        ``ambiguous``, ``conflict``, ``too_small``: it can't be told
    T_a_b : p_a = T_a_b p_b at the best place, None if there is none
    sigma_m, sigma_rad : standard deviations of that in the middle of what both have, 0 unless it is committed
    explained_m, conflict_m, second_m : wall that the other has, too; wall in the other's free space; and what the best
        place elsewhere explains
    confirmed_by : other robots that have looked at it, and found that it holds
    text : the same in a sentence
    """

    a: Frame
    b: Frame
    outcome: str
    T_a_b: Pose2 | None
    sigma_m: float
    sigma_rad: float
    explained_m: float
    conflict_m: float
    second_m: float
    confirmed_by: tuple[str, ...]
    text: str


def alignment_infos(engine: Engine) -> list[AlignmentInfo]:
    """All pairs that somebody has looked at, by name."""
    components = engine.components()
    lost = {(edge.a, edge.b) for edge in components.lost}
    return [alignment_info(said, lost=(said.author, said.other) in lost) for said in components.said]


def alignment_info(said: Said, *, lost: bool) -> AlignmentInfo:
    """One of them."""
    fact = said.fact
    weight = fact.weight
    explained_m, conflict_m, second_m = weight.explained / 1e3, weight.conflict / 1e3, weight.second / 1e3
    outcome, text = fact.outcome, sentence(
        fact.outcome,
        explained_m=explained_m,
        conflict_m=conflict_m,
        visible_m=weight.visible / 1e3,
        fixed_m=weight.fixed / 1e3,
        second_m=second_m,
    )  # fmt: skip
    if outcome == "committed" and said.refused:
        outcome, text = "conflict", f"{said.other[0]} has looked, and found that it doesn't hold ({text})"
    elif outcome == "committed" and lost:
        outcome, text = "conflict", f"it contradicts other alignments around a loop ({text})"
    xx, _, _, yy, _, turn = fact.covariance
    return AlignmentInfo(
        (*said.author, fact.submap),
        fact.other,
        outcome,
        fact.T_own_other.to_pose() if weight.explained else None,
        math.sqrt((xx + yy) / 2) / 1e6,
        math.sqrt(turn) / 1e6,
        explained_m,
        conflict_m,
        second_m,
        said.confirmed_by,
        text,
    )


def not_merged(engine: Engine) -> dict[str, str]:
    """Robots that are there, on the own level, and not in the own component: why."""
    components, own = engine.components(), engine.own
    together = {robot for robot, _ in components.members(own.key)}
    there = [s for s in engine.placed_streams() if s.level == own.level and s.edges and engine.is_there(s.key)]
    apart = {stream.robot for stream in there} - together
    lost = {(edge.a, edge.b) for edge in components.lost}
    found: dict[str, str] = {}
    for said in components.said:
        pair = {said.author[0], said.other[0]}
        if own.robot in pair and (other := pair - {own.robot}) <= apart and other:
            info = alignment_info(said, lost=(said.author, said.other) in lost)
            found[other.pop()] = f"{info.outcome} ({info.text}){WHAT_NEXT[info.outcome]}"
    return found


def contradicted_starts(engine: Engine) -> dict[str, str]:
    """Robots of the own component that lie elsewhere than their starts say: how far."""
    components = engine.components()
    members = set(components.members(engine.own.key))
    found = {}
    for stream in engine.placed_streams():
        if stream.key in members and (off := off_start(stream, components)) is not None:
            off_m, off_rad = off
            if off_m > STARTS_DIFFER_M or off_rad > STARTS_DIFFER_RAD:
                found[stream.robot] = f"{off_m:.1f} m, {math.degrees(off_rad):.1f}°"
    return found


def off_start(stream: Stream, components: Components) -> tuple[float, float] | None:
    """How far a robot's map frame lies from where its start puts it: metres at its origin, and radians."""
    placed = components.pose(stream.key)
    if stream.start is None or placed is None:
        return None
    off = stream.start.to_pose().inverse() @ placed.to_pose()
    return math.hypot(off.x_m, off.y_m), abs(off.yaw_rad)
