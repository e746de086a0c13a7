"""Fleets on the memory link that live through seeded schedules of reboots, cuts and lies.

A robot is an engine on a link; a process that is killed leaves nothing behind but what the others hold. Maps are sets
of small squares that only ever grow, so that what a peer has held of a robot must be contained in what it holds later.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial

import numpy as np
from exchange import Node

from fleetmap.engine import Stream
from fleetmap.model.lattice import Lattice
from fleetmap.model.vectormap import VectorMap
from fleetmap.peer.memory_link import FakeClock, MemoryHub, arrives

CORNERS = np.array([(0, 0), (0, 5), (5, 5), (5, 0), (0, 0)])
LATTICE = Lattice(50_000)
ROW = 1000
"""Squares in a row of the plane."""


def squares(numbers: Iterable[int]) -> VectorMap:
    """A map of closed squares, each 5 cells wide, at places of their own."""
    low = np.array([(number // ROW * 10, number % ROW * 10) for number in sorted(numbers)], np.int64).reshape(-1, 1, 2)
    points = low + CORNERS
    rows = np.concatenate([points[:, :-1], points[:, 1:], np.ones((len(low), 4, 1), np.int64)], axis=2).reshape(-1, 5)
    return VectorMap(LATTICE, rows.astype(np.int32), np.full(len(rows), 4, np.uint8))


@lru_cache(4096)
def _numbers_of(vector_map: VectorMap) -> frozenset[int]:
    edges = vector_map.edges
    low = np.minimum(edges[:, :2], edges[:, 2:4]) // 10
    return frozenset((low[:, 0].astype(np.int64) * ROW + low[:, 1]).tolist())


def numbers_of(stream: Stream) -> frozenset[int]:
    """The squares of a stream."""
    return frozenset().union(*(_numbers_of(vector_map) for vector_map in stream.submaps.values()))


class Robot(Node):
    """One process of a robot: it ticks by itself until it is killed.

    Attributes
    ----------
    seen : what it has ever merged of each robot
    """

    def __init__(self, fleet: Fleet, name: str) -> None:
        self.fleet, self.name = fleet, name
        self.numbers: set[int] = set()
        self.seen: dict[str, frozenset[int]] = {}
        super().__init__(fleet.hub, fleet.clock, name, run=fleet.next_run(name), revisions=fleet.revisions)

    def grow(self, count: int) -> None:
        """Say so many squares more."""
        self.numbers |= set(self.fleet.places(count))
        self.publish(squares(self.numbers))

    def carry_out(self) -> None:
        """Hand on what came out of the engine, and note what was said."""
        own = self.engine.own
        self.fleet.said.setdefault(own.key, {})[own.seq] = own.digest
        super().carry_out()

    def merged(self) -> dict[str, frozenset[int]]:
        """The squares of each robot that are merged here."""
        found: dict[str, frozenset[int]] = {}
        for stream in self.engine.merged_streams():
            found[stream.robot] = found.get(stream.robot, frozenset()) | numbers_of(stream)
        return found


@dataclass
class Fleet:
    """Robots on one medium.

    Attributes
    ----------
    said : what honest authors have said: (robot, life) -> seq -> digest
    faults : laws that were broken, in words
    """

    rng: np.random.Generator
    fate: Callable[[str, str, str], Sequence[float]] = arrives
    rate_Bps: float | None = None
    revisions: int = 512
    clock: FakeClock = field(default_factory=FakeClock)
    robots: dict[str, Robot] = field(default_factory=dict)
    said: dict[tuple[str, int], dict[int, int]] = field(default_factory=dict)
    faults: list[str] = field(default_factory=list)
    runs: dict[str, int] = field(default_factory=dict)
    _place: int = 0

    def __post_init__(self) -> None:
        self.hub = MemoryHub(self.clock, fate=self.fate, rate_Bps=self.rate_Bps)

    def start(self, name: str) -> Robot:
        """Begin a process of a robot."""
        self.robots[name] = Robot(self, name)
        return self.robots[name]

    def next_run(self, name: str) -> int:
        """Which run of a robot begins now."""
        self.runs[name] = self.runs.get(name, 0) + 1
        return self.runs[name]

    def places(self, count: int) -> range:
        """Places where no square is yet."""
        self._place += count
        return range(self._place - count, self._place)

    def living(self) -> list[Robot]:
        return [robot for robot in self.robots.values() if robot.open]

    def run(self, seconds: float, *, look: Callable[[], None] | None = None, each_s: float = 1.0) -> None:
        """Let time pass, and look in between."""
        until_s = self.clock.now_s + seconds
        while self.clock.now_s < until_s:
            self.clock.advance(min(each_s, until_s - self.clock.now_s))
            if look is not None:
                look()

    def run_until_equal(self, limit_s: float, *, look: Callable[[], None] | None = None) -> bool:
        """Let time pass until all that live hold the same, and miss nothing."""
        until_s = self.clock.now_s + limit_s
        while self.clock.now_s < until_s:
            self.run(1.0, look=look)
            living = self.living()
            if all(r.holds() == living[0].holds() and not r.engine.lacking() for r in living):
                return True
        return False

    def check_nothing_is_lost(self) -> None:
        """What a process has merged of a robot stays merged as long as it lives."""
        for robot in self.living():
            seen, merged = robot.seen, robot.merged()
            for name, numbers in seen.items():
                lost = numbers - merged.get(name, frozenset())
                if lost:
                    self.faults.append(f"{self.clock.now_s:.1f} s: {robot.name} lost {len(lost)} squares of {name}")
            for name, numbers in merged.items():
                seen[name] = seen.get(name, frozenset()) | numbers


def link_later(fleet: Fleet, robot: Robot, longest_s: float) -> None:
    """A process that has just begun: each of its links comes up by itself."""
    for other in fleet.living():
        if other is not robot and longest_s > 0:
            fleet.hub.cut(robot.name, other.name)
            delay_s = float(fleet.rng.uniform(0, longest_s))
            fleet.clock.call_later(delay_s, partial(fleet.hub.heal, robot.name, other.name))


def lossy(rng: np.random.Generator, loss: float, longest_s: float) -> Callable[[str, str, str], Sequence[float]]:
    """Payloads are lost, late, doubled and overtaken."""

    def fate(sender: str, receiver: str, kind: str) -> Sequence[float]:
        copies = 0 if rng.random() < loss else 2 if rng.random() < loss else 1
        return tuple(float(rng.uniform(0, longest_s)) for _ in range(copies))

    return fate


def run_reboots(seed: int, *, most: int = 4) -> list[str]:
    """A fleet whose robots reboot at any moment, at most so often each; returns the laws that were broken."""
    rng = np.random.default_rng(seed)
    narrow = seed % 5 == 4
    fate = arrives if narrow else lossy(rng, float(rng.choice([0.0, 0.02, 0.1])), float(rng.choice([0.0, 0.05, 0.5])))
    fleet = Fleet(rng, fate, 1200.0 if narrow else None)
    names = [f"r{i}" for i in range(rng.integers(2, 4 if narrow else 6))]
    largest = 40 if narrow else 300
    for name in names:
        link_later(fleet, fleet.start(name), float(rng.choice([0.0, 3.0])))
    reboots = dict.fromkeys(names, 0)
    down: dict[str, float] = {}

    def reboot(name: str) -> None:
        if name in down or reboots[name] >= most:
            return
        fleet.check_nothing_is_lost()
        reboots[name] += 1
        fleet.robots[name].kill()
        down[name] = fleet.clock.now_s + float(rng.choice([0.5, 2.0, 10.0, 60.0]) * rng.uniform(0.5, 1.0))

    for _ in range(rng.integers(8, 25)):
        match rng.integers(0, 8):
            case 0 | 1:
                reboot(str(rng.choice(names)))
            case 2:
                reboot(names[0])
            case 3 if rng.random() < 0.3:
                spared = str(rng.choice(names))
                for name in names:
                    if name != spared:
                        reboot(name)
            case 4 if len(fleet.living()) > 1:
                a, b = rng.choice([r.name for r in fleet.living()], 2, replace=False)
                fleet.hub.cut(str(a), str(b))
                fleet.clock.call_later(float(rng.uniform(0.5, 20)), partial(fleet.hub.heal, str(a), str(b)))
            case _:
                for robot in fleet.living():
                    if rng.random() < 0.5:
                        robot.grow(int(rng.integers(1, largest)))
        for name, due_s in list(down.items()):
            if due_s <= fleet.clock.now_s:
                del down[name]
                link_later(fleet, fleet.start(name), float(rng.choice([0.0, 1.0, 8.0])))
        fleet.run(float(rng.choice([0.05, 0.3, 1.0, 5.0])), look=fleet.check_nothing_is_lost)
    fleet.run(61.0, look=fleet.check_nothing_is_lost, each_s=5.0)
    for name in down:
        fleet.start(name)
    if not fleet.run_until_equal(900.0 if narrow else 60.0, look=fleet.check_nothing_is_lost):
        lacking = {robot.name: robot.engine.lacking() for robot in fleet.living()}
        fleet.faults.append(f"not equal in the end: {lacking}")
    # Whatever anybody who lives has ever merged, all have.
    ever: dict[str, frozenset[int]] = {}
    for robot in fleet.living():
        for name, numbers in robot.seen.items():
            ever[name] = ever.get(name, frozenset()) | numbers
    for robot in fleet.living():
        merged = robot.merged()
        for name, numbers in ever.items():
            if lost := numbers - merged.get(name, frozenset()):
                fleet.faults.append(f"in the end {robot.name} lacks {len(lost)} squares of {name}")
    return fleet.faults


def run_many_reboots(seed: int, *, reboots: int) -> list[str]:
    """A robot that reboots often, sometimes out of reach; returns the laws that were broken."""
    rng = np.random.default_rng(seed)
    fleet = Fleet(rng, lossy(rng, 0.02, 0.05))
    names = [f"r{i}" for i in range(rng.integers(2, 5))]
    for name in names:
        fleet.start(name).grow(int(rng.integers(1, 50)))
    fleet.run(3.0)
    best: tuple[int, int] = (0, 0)
    for _ in range(reboots):
        fleet.robots["r0"].kill()
        fleet.run(float(rng.uniform(0.5, 3.0)))
        robot = fleet.start("r0")
        link_later(fleet, robot, float(rng.choice([0.0, 2.0, 10.0])))
        robot.grow(int(rng.integers(1, 200)))
        fleet.run(float(rng.uniform(0.0, 6.0)))
        for other in fleet.living():
            if other is not robot:  # as far as somebody has heard of it who lives on
                streams = other.engine.holdings.streams()
                best = max([best, *((s.edges, s.life) for s in streams if s.robot == "r0")])
    if not fleet.run_until_equal(60.0):
        fleet.faults.append("not equal in the end")
    for robot in fleet.living():
        kept = {life for name, life in robot.holds() if name == "r0"}
        if best[0] and best[1] not in kept:
            fleet.faults.append(f"{robot.name} dropped the life with the most edges")
    return fleet.faults
