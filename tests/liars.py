"""Schedules with a byzantine author and a lying mirror among honest robots."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from functools import partial

import numpy as np
from exchange import TICK_S
from schedules import Fleet, Robot, link_later, lossy, numbers_of, squares

from fleetmap.codecs import envelope
from fleetmap.codecs.facts import forget
from fleetmap.codecs.messages import Change, Heartbeat, Record, Revision, RevisionList, SnapshotChunk, Want
from fleetmap.engine import Answer, Chain, Engine, Input, Message, Put, Query
from fleetmap.engine.log import snapshot_messages
from fleetmap.engine.stream import Stream
from fleetmap.model.errors import ConfigError
from fleetmap.model.pose import FixedPose


class Twins:
    """A byzantine author: two copies of one memory, of which each tells some of the others something else."""

    def __init__(self, fleet: Fleet, name: str) -> None:
        self.fleet, self.name, self.rng = fleet, name, fleet.rng
        seed = fleet.rng.bytes(16)
        self.twins = [Engine(name, chain=Chain(seed, revisions=fleet.revisions), start=FixedPose()) for _ in range(2)]
        self.numbers: list[set[int]] = [set(), set()]
        self.link = fleet.hub.link(name)
        self.open = True
        self.link.connect(self)
        self.link.display(self.twins[0].own.life)
        self._tick()

    def deliver(self, item: Input) -> None:
        if not self.open:
            return
        if isinstance(item, Query):
            twin = int(self.rng.integers(2))
            self.twins[twin].receive(item, now_s=self.fleet.clock.now_s)
            for output in self.twins[twin].take_outputs():
                if isinstance(output, Answer):
                    output.reply(output.payloads)

    def leave(self) -> None:
        self.open = False
        self.link.vanish()

    def _tick(self) -> None:
        if not self.open:
            return
        for i, twin in enumerate(self.twins):
            if self.rng.random() < 0.1:
                self.numbers[i] |= set(self.fleet.places(int(self.rng.integers(1, 20))))
                twin.publish("0", squares(self.numbers[i]), now_s=self.fleet.clock.now_s)
            twin.tick(self.fleet.clock.now_s)
            for output in twin.take_outputs():
                if isinstance(output, Put):
                    for j, other in enumerate(self.fleet.hub.others(self.link)):
                        if j % 2 == i or self.rng.random() < 0.2:
                            say(
                                self.fleet,
                                self.name,
                                other,
                                Message(self.name, output.life, output.kind, output.payload),
                            )
        self.fleet.clock.call_later(TICK_S, self._tick)


def say(fleet: Fleet, sender: str, other: object, message: Message) -> None:
    """Put a message under any name."""
    fleet.hub.carry(sender, other.robot, message.kind, len(message.payload), partial(other.receive, message))


class Liar(Robot):
    """A mirror that lies: it listens like an honest robot, and says what it likes."""

    def __init__(self, fleet: Fleet, name: str, *, crowds: int) -> None:
        self.rng = fleet.rng
        self.phantoms: list[tuple[str, int]] = []
        self.crowding: list[Engine] = []
        super().__init__(fleet, name)
        self._crowds = crowds

    def carry_out(self) -> None:
        super().carry_out()
        self.fleet.said.pop(self.engine.own.key, None)

    def deliver(self, item: Input) -> None:
        if self.open and isinstance(item, Query) and self.rng.random() < 0.8:
            item.reply(self._lie(item.kind, item.payload))
        else:
            super().deliver(item)

    def leave(self) -> None:
        self.kill()
        for other in self.fleet.hub.others(self.link):
            for phantom in self.phantoms:
                other.see(phantom, alive=False)

    def _honest(self) -> list[Stream]:
        return [s for s in self.engine.holdings.streams() if s.key in self.fleet.said]

    def _lie(self, kind: str, payload: bytes) -> list[bytes]:
        if kind == "revisions":
            rows = [(s.robot, s.revision) for s in self.engine.holdings.streams()]
            rows = [(name, self._lied(revision)) for name, revision in rows if self.rng.random() < 0.9]
            for _ in range(int(self.rng.choice([0, 0, 3, 60]))):
                name, life = f"ghost{self.rng.integers(1000)}", int(self.rng.integers(1, 1 << 62))
                rows.append((name, Revision(life, int(self.rng.integers(1, 1 << 18)), int(self.rng.integers(1 << 62)))))
            return [envelope.encode(RevisionList(tuple(rows)))]
        if kind in ("snapshot", "mirror"):
            want = envelope.decode(payload, robot="?")
            assert isinstance(want, Want)
            held = self.engine.holdings.held((want.robot, want.revision.life))
            if held.seq == 0 or self.rng.random() < 0.3:
                return [] if self.rng.random() < 0.5 else [self.rng.bytes(40)]
            return self._forged(held)
        return []

    def _forged(self, held: Stream) -> list[bytes]:
        """A snapshot of somebody's stream with other content, of this seq or of a later one."""
        content = squares(set(numbers_of(held)) | set(self.fleet.places(3)))
        later = int(self.rng.choice([0, 0, 1, 5, 100]))
        link = held.link if later == 0 else int(self.rng.integers(1 << 62))
        seq = min(held.seq + later, 1 << 18)
        forged = Stream(held.robot, held.life, seq, held.facts, {"0": content}, link)
        messages = snapshot_messages(forged)
        return messages[: len(messages) if self.rng.random() < 0.7 else 1]

    def _lied(self, revision: Revision) -> Revision:
        match int(self.rng.integers(5)):
            case 0:
                return Revision(revision.life, min(revision.seq + int(self.rng.integers(1, 5)), 1 << 18), 7)
            case 1:
                return Revision(revision.life, revision.seq, int(self.rng.integers(1, 1 << 62)))
            case 2:
                return Revision(revision.life, max(1, revision.seq - 1), revision.digest)
        return revision

    def tick(self) -> None:
        if self.open:
            if self.rng.random() < 0.5 and hasattr(self, "_crowds"):
                self._speak()
            super().tick()

    def _speak(self) -> None:
        honest = self._honest()
        others = self.fleet.hub.others(self.link)
        if not honest or not others:
            return
        victim = honest[int(self.rng.integers(len(honest)))]
        other = others[int(self.rng.integers(len(others)))]
        later = min(victim.seq + int(self.rng.integers(1, 4)), 1 << 18)
        match int(self.rng.integers(8)):
            case 0:  # a record under the victim's very life, with a link of one's own
                record = Record(later, int(self.rng.integers(1 << 62)), 5, Change({}, ()))
                say(self.fleet, self.name, other, Message(*victim.key, "delta", envelope.encode(record)))
            case 1:  # a heartbeat that is ahead
                beat = Heartbeat(later, int(self.rng.integers(1 << 62)))
                say(self.fleet, self.name, other, Message(*victim.key, "digest", envelope.encode(beat)))
            case 2:  # tokens of nobody, and of the victim's name
                name = str(self.rng.choice([victim.robot, "ghost", f"ghost{self.rng.integers(50)}"]))
                phantom = (name, int(self.rng.integers(1, 1 << 62)))
                if len(self.phantoms) < 30:
                    self.phantoms.append(phantom)
                    for each in others:
                        each.see(phantom, alive=True)
            case 3:  # whoever lives is forgotten
                with contextlib.suppress(ConfigError):
                    self.engine._commit(facts=forget({victim.key: victim.state}))
            case 4:  # records whose base never comes
                own = self.engine
                seq = min(own.own.seq + int(self.rng.integers(2, 60)), own.author.chain.revisions)
                record = Record(seq, own.author.chain.link(seq), 5, Change({}, ()))
                say(self.fleet, self.name, other, Message(*own.own.key, "delta", envelope.encode(record)))
            case 5:
                say(self.fleet, self.name, other, Message(*victim.key, "delta", self.rng.bytes(30)))
            case 6:  # a snapshot where none was asked for
                chunk = SnapshotChunk(later, 5, 5, 0, 1, b"\x90")
                say(self.fleet, self.name, other, Message(*victim.key, "delta", envelope.encode(chunk)))
            case 7 if len(self.crowding) < self._crowds:  # another life under the victim's very name
                life = Engine(victim.robot, chain=Chain(self.rng.bytes(16), revisions=64), start=FixedPose())
                self.crowding.append(life)
                life.publish("0", squares(self.fleet.places(400)))
                step = {bytes([4]) + s.life.to_bytes(8, "big"): b"" for s in honest if s.robot == victim.robot}
                life._commit(facts=step)
                for output in life.take_outputs():
                    if isinstance(output, Put):
                        for each in others:
                            message = Message(victim.robot, output.life, output.kind, output.payload)
                            say(self.fleet, self.name, each, message)


def crowded_out(fleet: Fleet, key: tuple[str, int]) -> bool:
    """Whether there are four larger lives of the same name: those are kept of the lives that are named."""
    edges: dict[int, int] = {}
    for robot in fleet.robots.values():
        for replica in robot.engine.holdings.replicas.values():
            if replica.stream.robot == key[0]:
                edges[replica.stream.life] = max(edges.get(replica.stream.life, 0), replica.stream.edges)
    own = edges.pop(key[1], 0)
    return sum((n, life) > (own, key[1]) for life, n in edges.items()) >= 4


def check_authors(fleet: Fleet, heard: dict[tuple[Robot, tuple[str, int]], int], ended: set[tuple[str, int]]) -> None:
    """What an honest robot holds of an honest author is what that has said, and never goes back or is dropped."""
    for robot in fleet.robots.values():
        if not robot.open or isinstance(robot, Liar):
            continue
        kept = robot.holds()
        for key, replica in robot.engine.holdings.replicas.items():
            said, stream = fleet.said.get(key), replica.stream
            if said is None or stream.seq == 0:
                continue
            told = f"{fleet.clock.now_s:.1f} s: {robot.name} holds of {key[0]} seq {stream.seq}"
            if stream.seq > max(said):
                fleet.faults.append(f"{told}, which was never said")
            elif replica.heard:
                if said[stream.seq] != stream.digest:
                    fleet.faults.append(f"{told}, and not as it was said")
                heard[robot, key] = max(heard.get((robot, key), 0), stream.seq)
        for (who, key), seq in heard.items():
            if who is robot and key not in ended and kept.get(key, (0, 0))[0] < seq and not crowded_out(fleet, key):
                fleet.faults.append(f"{fleet.clock.now_s:.1f} s: {robot.name} held {key[0]} at {seq}, and no more")


def run_liars(seed: int) -> list[str]:
    """Honest robots that publish, reboot, are cut and forget, beside a byzantine author and a lying mirror.

    Returns the laws that were broken.
    """
    rng = np.random.default_rng(seed)
    fleet = Fleet(rng, lossy(rng, float(rng.choice([0.0, 0.05])), float(rng.choice([0.0, 0.1]))))
    names = [f"h{i}" for i in range(rng.integers(2, 5))]
    for name in names:
        fleet.start(name).grow(int(rng.integers(1, 100)))
    twins = Twins(fleet, "bad")
    liar = fleet.robots["liar"] = Liar(fleet, "liar", crowds=int(rng.choice([0, 2, 4])))
    heard: dict[tuple[Robot, tuple[str, int]], int] = {}
    ended: set[tuple[str, int]] = set()

    def look() -> None:
        check_authors(fleet, heard, ended)

    def honest() -> list[Robot]:
        return [robot for robot in fleet.robots.values() if robot.open and robot is not liar]

    def may(work: Callable[[], object]) -> None:
        with contextlib.suppress(ConfigError):  # nothing of that robot is held
            work()

    for _ in range(rng.integers(5, 20)):
        robot = honest()[int(rng.integers(len(honest())))]
        match int(rng.integers(9)):
            case 0:
                robot.kill()
                fleet.run(float(rng.uniform(0.1, 3.0)), look=look)
                link_later(fleet, fleet.start(robot.name), float(rng.choice([0.0, 3.0])))
            case 1:
                other = str(rng.choice([n for n in fleet.robots if n != robot.name] + ["bad"]))
                fleet.hub.cut(robot.name, other)
                fleet.clock.call_later(float(rng.uniform(0.5, 10)), partial(fleet.hub.heal, robot.name, other))
            case 2:
                other, everywhere = str(rng.choice([*names, "bad", "liar"])), bool(rng.random() < 0.5)
                may(partial(robot.forget, other, everywhere=everywhere))
                if other == robot.name:
                    ended |= {key for key in fleet.said if key[0] == other and key != robot.engine.own.key}
            case _:
                for each in honest():
                    if rng.random() < 0.6:
                        each.grow(int(rng.integers(1, 60)))
        fleet.run(float(rng.choice([0.1, 0.5, 2.0])), look=look)

    def unequal() -> set[str]:
        told = set()
        disputed = {name for robot in honest() for name in robot.engine.disputed()} | {"bad", "liar"}
        first, *rest = honest()
        for other in rest:
            a, b = first.holds(), other.holds()
            # What both leave out of the merged map as it is, an operator has dealt with.
            settled = first.engine.left_out() & other.engine.left_out()
            for key in sorted((a.keys() | b.keys()) - settled):
                if key[0] not in disputed and not key[0].startswith("ghost") and a.get(key) != b.get(key):
                    told.add(f"{first.name} and {other.name} differ in {key[0]} {key[1]:x}")
        return told

    def never_equal(limit_s: float) -> list[str]:
        """What differs at every look: records may be on their way at any one."""
        told, until_s = unequal(), fleet.clock.now_s + limit_s
        while told and fleet.clock.now_s < until_s:
            fleet.run(0.3, look=look)
            told &= unequal()
        return sorted(told)

    fleet.run(20.0, look=look)
    if told := never_equal(10.0):
        fleet.faults.append(f"beside the liars, in the quiet: {told[:3]}")
    # Both go, and within 10 s nobody misses anything.
    twins.leave()
    liar.leave()
    del fleet.robots["liar"]
    if told := never_equal(10.0):
        fleet.faults.append(f"after the liars: {told[:3]}")
    missing: dict[str, list[str]] = {robot.name: ["?"] for robot in honest()}
    for _ in range(20):
        for robot in honest():
            said = {*robot.engine.disputed(), "bad", "liar"}
            told = [text for text in robot.engine.lacking() if not any(name in text for name in said)]
            missing[robot.name] = told and missing[robot.name] and told
        if not any(missing.values()):
            break
        fleet.run(0.5, look=look)
    else:
        fleet.faults.append(f"after the liars: {missing}")
    # Nothing goes round in circles.
    before = {robot: robot.engine.ledger.stats().sent.get("want") for robot in honest()}
    fleet.run(30.0, look=look)
    for robot, count in before.items():
        now = robot.engine.ledger.stats().sent.get("want")
        asked = (now.messages if now else 0) - (count.messages if count else 0)
        if asked > 20 * len(before):
            fleet.faults.append(f"{robot.name} asked {asked} questions in 30 s of quiet")
    return fleet.faults
