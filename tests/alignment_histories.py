"""Fleets of robots with unknown starts that say where others lie: honest alignments, false ones, verdicts, revocations.

Each robot has a true place; its map is one square. What is true, and what a fold that never had a fact would give, is
known by construction.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from exchange import Node, room
from schedules import lossy

from fleetmap.codecs.facts import (
    AlignmentFact,
    FactsStep,
    Verdict,
    Weight,
    drop_alignment,
    set_alignment,
    set_start,
    set_verdict,
)
from fleetmap.codecs.facts.alignment import subject_of
from fleetmap.engine.components import Components, components_of
from fleetmap.engine.stream import Key, Stream
from fleetmap.engine.view import view
from fleetmap.merge import fold
from fleetmap.model.pose import FixedPose, Pose2
from fleetmap.peer.memory_link import FakeClock, MemoryHub

ROOM = room(20)


def place(rng: np.random.Generator) -> Pose2:
    """Somewhere, turned anyhow."""
    return Pose2(*rng.uniform(-20, 20, 2), rng.uniform(-math.pi, math.pi))


def noisy(pose: Pose2, rng: np.random.Generator, off_m: float = 0.01, off_rad: float = 0.001) -> Pose2:
    """About there."""
    return pose @ Pose2(*rng.normal(0, off_m, 2), rng.normal(0, off_rad))


def says(
    own_pose: Pose2, other_pose: Pose2, other: Key, *, explained_m: float = 30.0, outcome: str = "committed"
) -> AlignmentFact:
    """That another robot's map lies where these poses put it."""
    T_own_other = FixedPose.from_pose(own_pose.inverse() @ other_pose)
    return AlignmentFact("0", (*other, "0"), outcome, T_own_other, weight=Weight(explained=round(explained_m * 1e3)))


def confirms(author: Key, fact: AlignmentFact, *, holds: bool = True) -> FactsStep:
    """A verdict on an alignment."""
    explained_mm = fact.weight.explained if holds else 0
    return set_verdict(Verdict((*author, fact.subject), fact.T_own_other, explained_mm))


@dataclass
class Said:
    """Streams by hand: what each robot says, as facts.

    Parameters
    ----------
    poses : T_world_robot of each
    """

    poses: dict[Key, Pose2]
    facts: dict[Key, dict[bytes, bytes | None]] = field(default_factory=dict)

    def say(self, key: Key, *steps: FactsStep) -> None:
        """Facts of one robot."""
        for step in steps:
            self.facts.setdefault(key, {}).update(step)

    def align(
        self, a: Key, b: Key, *, confirmed: bool = True, explained_m: float = 30.0, off: Pose2 | None = None
    ) -> None:
        """a says where b lies, b confirms it; ``off``: it isn't true."""
        fact = says(self.poses[a], self.poses[b] @ (off or Pose2()), b, explained_m=explained_m)
        self.say(a, set_alignment(fact))
        if confirmed:
            self.say(b, confirms(a, fact))

    def streams(self, *, without: Sequence[Key] = ()) -> list[Stream]:
        """All that was said."""
        empty: dict[bytes, bytes | None] = {}
        return [
            Stream(*key, 1, Stream(*key).facts.after(self.facts.get(key, empty)), {"0": ROOM})
            for key in self.poses
            if key not in without
        ]

    def components(self, *, without: Sequence[Key] = ()) -> Components:
        """Where they lie."""
        return components_of(self.streams(without=without))

    def is_true(self, found: Components, a: Key, b: Key, *, most_m: float = 0.001) -> bool:
        """Whether two robots of one component lie as they really do."""
        pose_a, pose_b = found.pose(a), found.pose(b)
        assert pose_a is not None
        assert pose_b is not None
        T_a_b = pose_a.to_pose().inverse() @ pose_b.to_pose()
        truth = self.poses[a].inverse() @ self.poses[b]
        return math.dist((T_a_b.x_m, T_a_b.y_m), (truth.x_m, truth.y_m)) <= most_m


class Robot(Node):
    """A robot that doesn't know its start, on a link."""

    def __init__(self, hub: MemoryHub, clock: FakeClock, name: str, pose: Pose2) -> None:
        self.name, self.pose = name, pose
        super().__init__(hub, clock, name, revisions=256)
        self.engine.set_start(None)
        self.publish(ROOM)

    def say(self, *steps: FactsStep) -> None:
        """Facts of its own."""
        self.engine.say(*steps)
        self.carry_out()

    def merged(self) -> str:
        """The digest of what it merges."""
        return fold(view(self.engine).sources).digest


def run_schedule(seed: int) -> list[str]:
    """Robots find each other, confirm, revoke, lie and are forgotten, over a bad link; returns what was broken."""
    rng = np.random.default_rng(seed)
    clock = FakeClock()
    hub = MemoryHub(clock, fate=lossy(rng, float(rng.choice([0.0, 0.1, 0.3])), float(rng.choice([0.0, 0.1, 0.5]))))
    names = [f"r{k}" for k in range(int(rng.integers(3, 6)))]
    robots = {name: Robot(hub, clock, name, place(rng)) for name in names}
    liar = str(rng.choice(names)) if rng.random() < 0.5 else None
    clock.advance(1.0)
    for _ in range(int(rng.integers(6, 16))):
        a, b = (robots[str(name)] for name in rng.choice(names, 2, replace=False))
        other = b.engine.own.key
        match int(rng.integers(0, 6)):
            case 0:
                a.say(drop_alignment("0", (*other, "0")))
            case 1:
                cut = str(rng.choice(names))
                hub.cut(cut, b.name) if cut != b.name else None
                clock.call_later(float(rng.uniform(0.5, 4)), lambda cut=cut, b=b: hub.heal(cut, b.name))
            case 2:
                about = *other, subject_of("0", (*a.engine.own.key, "0"))
                a.say(set_verdict(Verdict(about, FixedPose.from_pose(place(rng)), int(rng.integers(0, 2)))))
            case _:
                there = place(rng) if a.name == liar else noisy(b.pose, rng)
                fact = says(a.pose, there, other, explained_m=float(rng.uniform(10, 60)))
                a.say(set_alignment(fact))
                if a.name != liar and rng.random() < 0.8:
                    b.say(confirms(a.engine.own.key, fact))
        clock.advance(float(rng.choice([0.0, 0.1, 1.0])))
    for a in names:
        for b in names:
            hub.heal(a, b) if a < b else None
    if liar is not None:
        clock.advance(30.0)  # nobody forgets a robot that it hasn't heard of
        robots[next(name for name in names if name != liar)].forget(liar, everywhere=True)
    faults = []
    clock.advance(30.0)  # who is forgotten, and lives, has its time to say so
    for _ in range(120):
        clock.advance(1.0)
        if len({str(sorted(robot.holds().items())) for robot in robots.values()}) == 1:
            break
    else:
        faults.append("the robots don't hold the same in the end")
    views = {}
    for name, robot in robots.items():
        components = robot.engine.components()
        views[name] = [(key, components.poses[key]) for key in sorted(components.poses)]
    if len({str(v) for v in views.values()}) != 1 and not faults:
        faults.append(f"the robots place each other differently: {views}")
    by_component: dict[str, set[str]] = {}
    for name, robot in robots.items():
        component = str(robot.engine.components().poses.get(robot.engine.own.key, (name,))[0])
        by_component.setdefault(component, set()).add(robot.merged())
    if any(len(digests) != 1 for digests in by_component.values()) and not faults:
        faults.append("robots of one component merge different maps")
    return faults


def run_revocation(seed: int) -> list[str]:
    """Facts come and go: what is taken back leaves the bytes of a fold that never had it; returns what was broken."""
    rng = np.random.default_rng(seed)
    keys = [(f"r{k}", int(rng.integers(1, 1 << 63))) for k in range(int(rng.integers(3, 7)))]
    said = Said({key: place(rng) for key in keys})
    if rng.random() < 0.3:
        for key in keys[: int(rng.integers(1, 3))]:
            said.say(key, set_start(FixedPose.from_pose(noisy(said.poses[key], rng))))
    pairs = [(a, b) for k, a in enumerate(keys) for b in keys[k + 1 :]]
    for a, b in pairs:
        if rng.random() < 0.5:
            said.align(a, b, confirmed=rng.random() < 0.8, explained_m=float(rng.uniform(10, 60)))
    before = digests(said)
    faults = []
    a, b = pairs[int(rng.integers(len(pairs)))]
    kept = {key: dict(facts) for key, facts in said.facts.items()}
    undo: Callable[[], None]
    match int(rng.integers(0, 3)):
        case 0:  # another alignment, then taken back
            fact = says(said.poses[a], place(rng), b, explained_m=float(rng.uniform(10, 90)))
            said.say(a, set_alignment(fact))
            said.say(b, confirms(a, fact))
            undo = lambda: said.facts.clear() or said.facts.update(kept)  # noqa: E731
        case 1:  # a better one for the same pair, which the other robot refuses: the fold never had either
            fact = says(said.poses[a], place(rng), b, explained_m=90.0)
            without = {**kept, a: {**kept.get(a, {}), **drop_alignment("0", (*b, "0"))}}
            said.facts = without
            before = digests(said)
            said.facts = {key: dict(facts) for key, facts in without.items()}
            said.say(a, set_alignment(fact))
            undo = lambda: said.say(b, confirms(a, fact, holds=False))  # noqa: E731
        case _:  # a stranger comes, lies about itself, and is forgotten
            stranger = ("a-stranger" if rng.random() < 0.5 else "stranger", 7)
            said.poses[stranger] = place(rng)
            for key in keys:
                fact = says(said.poses[stranger], place(rng), key, explained_m=1000.0)
                said.say(stranger, set_alignment(fact))
            faults += costs_its_own_place(said, keys, stranger)

            def undo() -> None:
                del said.poses[stranger]

    undo()
    if digests(said) != before:
        faults.append(f"other bytes than before ({a}, {b})")
    return faults


def costs_its_own_place(said: Said, keys: Sequence[Key], stranger: Key) -> list[str]:
    """Whether the others lie to each other as they do without a stranger."""
    found, without = said.components(), said.components(without=[stranger])
    faults = []
    for a in keys:
        for b in keys:
            together = found.poses[a][0] == found.poses[b][0]
            if together != (without.poses[a][0] == without.poses[b][0]):
                faults.append(f"a stranger brought {a} and {b} together, or apart")
            elif together and found.poses[a][1] != without.poses[a][1]:
                faults.append(f"a stranger moved {a}")
    return faults


def digests(said: Said) -> dict[Key, str]:
    """The merged map of each robot."""
    from fleetmap.engine.view import sources_of

    streams, components = said.streams(), said.components()
    found: dict[Key, str] = {}
    for stream in streams:
        members = set(components.members(stream.key))
        sources, _ = sources_of([other for other in streams if other.key in members], components)
        found[stream.key] = fold(sources).digest
    return found
