"""Engines that hear each other without a link, and fleets over the memory link at a fake clock's time."""

from __future__ import annotations

from collections.abc import Collection, Iterable

import numpy as np
from format_reader import held_hash

from fleetmap.codecs import envelope
from fleetmap.codecs.facts import FactsStep
from fleetmap.codecs.messages import Record
from fleetmap.engine import (
    Alive,
    Answer,
    Ask,
    Chain,
    Engine,
    Event,
    Input,
    LifeChanged,
    Limits,
    LookAgain,
    Message,
    Put,
    Query,
    Reply,
    ReplyEnd,
    Stream,
)
from fleetmap.engine.quota import Quota
from fleetmap.engine.view import view
from fleetmap.model.lattice import Lattice
from fleetmap.model.pose import FixedPose
from fleetmap.model.vectormap import VectorMap
from fleetmap.peer.link import Token
from fleetmap.peer.memory_link import FakeClock, Fate, MemoryHub, arrives

REVISIONS = 1024
"""Of a life in tests: chains as long as those of robots take 40 ms each to draw."""
TICK_S = 0.1


def room(size: int, *, resolution_um: int = 50_000, thickness: int = 4) -> VectorMap:
    """A square of free space with its lower left corner at the origin."""
    corners = [(0, 0), (0, size), (size, size), (size, 0)]
    rows = [(*a, *b, 1) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
    return VectorMap(Lattice(resolution_um), np.array(rows, np.int32), np.full(4, thickness, np.uint8))


def rooms(count: int, *, size: int = 10) -> VectorMap:
    """So many rooms in a row, four edges each."""
    one = room(size).edges
    along = np.array([0, 1, 0, 1, 0], np.int32) * 2 * size
    rows = np.concatenate([one + k * along for k in range(count)])
    return VectorMap(Lattice(50_000), rows, np.full(len(rows), 4, np.uint8))


def chain(robot: str, run: int = 1, *, revisions: int = REVISIONS) -> Chain:
    """The chain of a robot's n-th run; the same on each call."""
    return Chain(f"{robot} {run}".encode(), revisions=revisions)


def life(robot: str, run: int = 1) -> int:
    """The life of a robot's n-th run."""
    return chain(robot, run).life


def engine(
    robot: str,
    *,
    run: int = 1,
    start: FixedPose | None = None,
    level: str = "0",
    quota: Quota | None = None,
    allow: Collection[str] | None = None,
    limits: Limits | None = None,
    revisions: int = REVISIONS,
) -> Engine:
    """An engine in the robot's n-th run."""
    its_chain = chain(robot, run, revisions=revisions)
    return Engine(robot, chain=its_chain, start=start, level=level, quota=quota, allow=allow, limits=limits)


def said(author: Engine) -> list[Put]:
    """All that an engine has published since its outputs were taken last."""
    return [output for output in author.take_outputs() if isinstance(output, Put)]


def records(author: Engine) -> list[bytes]:
    """The records among that."""
    return [put.payload for put in said(author) if put.kind == "delta"]


def read_record(raw: bytes) -> Record:
    """The record in bytes."""
    message = envelope.decode(raw, robot="?")
    assert isinstance(message, Record)
    return message


def tell(listener: Engine, author: Engine | Token, *payloads: bytes, kind: str = "delta", now_s: float = 0.0) -> None:
    """Let an engine hear payloads of an author."""
    robot, its_life = author.own.key if isinstance(author, Engine) else author
    for payload in payloads:
        listener.receive(Message(robot, its_life, kind, payload), now_s=now_s)


def deliver(author: Engine, *listeners: Engine, now_s: float = 0.0) -> None:
    """Let others hear all that an engine has published since."""
    for put in said(author):
        for listener in listeners:
            listener.receive(Message(author.robot, put.life, put.kind, put.payload), now_s=now_s)


def meet(*engines: Engine, now_s: float = 0.0) -> None:
    """Let each see the tokens of the others."""
    for one in engines:
        for other in engines:
            if one is not other:
                one.receive(Alive(*other.own.key), now_s=now_s)


def held(listener: Engine, author: Engine | Token) -> Stream:
    """What an engine holds of an author."""
    return listener.holdings.held(author.own.key if isinstance(author, Engine) else author)


def asks(asker: Engine, *kinds: str) -> list[Ask]:
    """The questions, of these kinds or any, that an engine has put since its outputs were taken last."""
    asked = [output for output in asker.take_outputs() if isinstance(output, Ask)]
    return [ask for ask in asked if not kinds or ask.kind in kinds]


def query(asked: Engine, kind: str, payload: bytes, *, now_s: float = 0.0) -> list[bytes]:
    """What an engine answers."""
    asked.receive(Query(kind, payload, lambda _: None), now_s=now_s)
    (answer,) = [output for output in asked.take_outputs() if isinstance(output, Answer)]
    return list(answer.payloads)


def reply(asker: Engine, ask: Ask, *payloads: bytes, now_s: float = 0.0) -> None:
    """Answer a question, whole."""
    for payload in payloads:
        asker.receive(Reply(ask.ask_id, payload), now_s=now_s)
    asker.receive(ReplyEnd(ask.ask_id), now_s=now_s)


def dropped(listener: Engine) -> dict[tuple[str, str], int]:
    """(robot, kind/reason) -> how many messages an engine has refused."""
    return {key: count.messages for key, count in listener.ledger.stats().dropped.items()}


def commit(author: Engine, *, facts: FactsStep | None = None, submaps: dict[str, VectorMap] | None = None) -> None:
    """Say something that this version wouldn't, as another program might."""
    author._commit(facts=facts, submaps=submaps)


class Node:
    """An engine on a memory link: what ``Peer`` does, in one thread and at the fake clock's time."""

    def __init__(
        self, hub: MemoryHub, clock: FakeClock, robot: str, *, run: int = 1, revisions: int = REVISIONS
    ) -> None:
        self.clock, self.link = clock, hub.link(robot)
        self.engine = engine(robot, run=run, start=FixedPose(), revisions=revisions)
        self.events: list[Event] = []
        self.open = True
        tokens = self.link.connect(self)
        self.link.display(self.engine.own.life)
        self.carry_out()
        for token in tokens:
            self.deliver(Alive(*token))
        clock.call_later(TICK_S, self.tick)

    def tick(self) -> None:
        """The time, ten times a second."""
        if self.open:
            self.engine.tick(self.clock.now_s)
            self.carry_out()
            self.clock.call_later(TICK_S, self.tick)

    def publish(self, vector_map: VectorMap, submap: str = "0", *, supersedes: bool = False) -> None:
        """Say what a submap is now."""
        self.engine.publish(submap, vector_map, supersedes=supersedes, now_s=self.clock.now_s)
        self.carry_out()

    def forget(self, robot: str, *, everywhere: bool = False) -> None:
        """What an operator does."""
        self.engine.forget(robot, everywhere=everywhere)
        self.carry_out()

    def kill(self) -> None:
        """End without a word."""
        self.open = False
        self.link.vanish()

    def deliver(self, item: Input) -> None:
        """What the link delivers."""
        if self.open:
            self.engine.receive(item, now_s=self.clock.now_s)
            self.carry_out()

    def carry_out(self) -> None:
        """Hand on what came out of the engine."""
        for output in self.engine.take_outputs():
            match output:
                case Put():
                    self.link.put(output.life, output.kind, output.payload)
                case Ask():
                    self._ask(output)
                case Answer():
                    output.reply(output.payloads, last=output.last)
                case event:
                    self.events.append(event)
                    if isinstance(event, LifeChanged):
                        self.link.display(event.life)
                    elif isinstance(event, LookAgain):
                        for other in self.link._hub.others(self.link):
                            if other.token is not None:
                                self.link.see(other.token, alive=True)

    def _ask(self, ask: Ask) -> None:
        self.link.ask(
            (ask.robot, ask.life),
            ask.kind,
            ask.payload,
            on_reply=lambda payload: self.deliver(Reply(ask.ask_id, payload)),
            on_end=lambda: self.deliver(ReplyEnd(ask.ask_id)),
        )

    def holds(self) -> dict[Token, tuple[int, int]]:
        """(robot, life) -> (seq, digest). Their hash, which is kept up to date, is looked at, too."""
        streams = self.engine.holdings.streams()
        assert self.engine.holdings.held_hash() == held_hash([(s.robot, s.life, s.seq, s.digest) for s in streams])
        return {s.key: (s.seq, s.digest) for s in streams}

    def lives_of(self, robot: str) -> set[int]:
        """The lives of a robot that are kept here."""
        return {its_life for name, its_life in self.holds() if name == robot}

    def merges(self) -> set[Token]:
        """The streams whose maps are in the merged one."""
        return {source.frame[:2] for source in view(self.engine).sources}


class Fleet:
    """Nodes on one hub."""

    def __init__(self, names: Iterable[str] = "", fate: Fate = arrives) -> None:
        self.clock = FakeClock()
        self.hub = MemoryHub(self.clock, fate=fate)
        self.nodes: dict[str, Node] = {}
        self.runs: dict[str, int] = {}
        for name in names:
            self.add(name)

    def add(self, robot: str, *, run: int | None = None, revisions: int = REVISIONS) -> Node:
        """A robot starts, in its next run unless one is named."""
        run = run or self.runs.get(robot, 0) + 1
        self.runs[robot] = max(run, self.runs.get(robot, 0))
        self.nodes[robot] = Node(self.hub, self.clock, robot, run=run, revisions=revisions)
        return self.nodes[robot]

    def kill(self, robot: str) -> Node:
        """A robot ends without a word."""
        node = self.nodes.pop(robot)
        node.kill()
        return node

    def restart(self, robot: str, *, revisions: int = REVISIONS) -> Node:
        """A robot ends without a word, and starts anew with nothing."""
        self.kill(robot)
        return self.add(robot, revisions=revisions)

    def run(self, seconds: float) -> None:
        """Let time pass."""
        self.clock.advance(seconds)

    def assert_equal(self, *nodes: Node) -> None:
        """All hold the same, merge the same, and lack nothing."""
        first, *others = nodes or tuple(self.nodes.values())
        for other in others:
            assert other.holds() == first.holds()
            assert view(other.engine).revisions == view(first.engine).revisions
        assert not first.engine.lacking()
