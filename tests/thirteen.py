"""Thirteen attacks on a fleet over real Zenoh, each as strong as the protocol allows, and what becomes of the fleet.

A stranger needs no key to link, so it hears all: lives, links, digests. What it can't do is go on in another's chain.
Each attack says its worst until ``Scene.over``; ``trial`` measures the honest robots meanwhile, and after it has left.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from itertools import count

import numpy as np
from attacks import Fleet, Stranger

from fleetmap.codecs import envelope
from fleetmap.codecs.facts import FactsStep, forget, supersede
from fleetmap.codecs.messages import (
    Change,
    Heartbeat,
    Record,
    Revision,
    RevisionList,
    SnapshotChunk,
    StatsMessage,
    SubmapChange,
    Want,
)
from fleetmap.engine import Chain
from fleetmap.engine.author import Author
from fleetmap.engine.log import Snapshots, answer, snapshot_messages
from fleetmap.engine.stream import Stream, change_between
from fleetmap.model.errors import FleetmapError, WireError
from fleetmap.model.lattice import Lattice
from fleetmap.model.vectormap import VectorMap

RIGHT_S, RECOVERY_S = 5.0, 10.0
GROWTH_BYTES = 64 << 20
MIRRORS = 2
"""Names of lying mirrors, of which all but one tell the same lie. Who has heard the author can't be outvoted. Who comes
later can, as long as they are there, by as many names as hold the truth: whoever has believed a lie counts for it.
``synced`` says that it is disputed."""
CONTEST_S = 1.0
"""A robot whose own word is doubted speaks again at most so often."""
LATTICE = Lattice(50_000)
ALIVE = envelope.encode(StatsMessage(1, 1, 4, 0, (0, 0, 0), {}, {}))


def edges_map(edges_yx: np.ndarray) -> VectorMap:
    """A vector map of (n, 4) edges, each once."""
    rows = np.unique(edges_yx.astype(np.int32), axis=0)
    return VectorMap(LATTICE, np.column_stack([rows, np.ones(len(rows), np.int32)]), np.full(len(rows), 4, np.uint8))


def square(x: int, y: int) -> VectorMap:
    """Four walls."""
    return edges_map(
        np.array([(y, x, y, x + 20), (y, x, y + 20, x), (y, x + 20, y + 20, x + 20), (y + 20, x, y + 20, x + 20)])
    )


def crossing(rng: np.random.Generator, squares: int, each: int) -> VectorMap:
    """As many edges as may be in one square, in each of some; they cross all over."""
    parts = []
    for i in range(squares):
        ends = rng.integers(0, 256, (each, 4)) + np.array([256 * 8, 256 * i, 256 * 8, 256 * i])
        parts.append(ends[(ends[:, 0] < ends[:, 2]) | ((ends[:, 0] == ends[:, 2]) & (ends[:, 1] < ends[:, 3]))])
    return edges_map(np.concatenate(parts))


@dataclass
class Scene:
    """A stranger among honest robots, until it is over."""

    fleet: Fleet
    stranger: Stranger
    rng: np.random.Generator
    ready: threading.Event = field(default_factory=threading.Event)
    """The worst has begun."""
    over: threading.Event = field(default_factory=threading.Event)

    @property
    def under(self) -> str:
        return f"fleetmap/{self.fleet.fleet}"

    def key(self, robot: str, kind: str, life: int) -> str:
        return f"{self.under}/{robot}/{kind}/{life:016x}"

    def life(self, robot: str) -> int:
        return int(self.fleet.lives[robot], 16)

    def each(self, pause_s: float) -> Iterable[int]:
        """0, 1, 2, ... until it is over, with a pause after each."""
        for i in count():
            if self.over.is_set():
                return
            yield i
            self.ready.set()
            self.over.wait(pause_s)

    def last_word(self, robot: str) -> Record | SnapshotChunk:
        """What anybody may ask a robot for: seq, link and digest that it has come to."""
        want = envelope.encode(Want(robot, Revision(self.life(robot), 0, 0)))
        (_, payload), *_ = self.stranger.ask(self.key(robot, "snapshot", self.life(robot)), want)
        word = envelope.decode(payload, robot=robot)
        assert isinstance(word, Record | SnapshotChunk)
        return word

    def on_word(self, robot: str, then: Callable[[Record], None]) -> None:
        """Hear each record of a robot."""

        def hear(_: str, payload: bytes) -> None:
            with suppress(WireError):
                word = envelope.decode(payload, robot=robot)
                if isinstance(word, Record) and not self.over.is_set():
                    then(word)

        self.stranger.react(self.key(robot, "delta", self.life(robot)), hear)


class Voice:
    """A life of the stranger's, under any name; its own chain is valid."""

    def __init__(self, scene: Scene, name: str) -> None:
        self.scene, self.name = scene, name
        self.chain = Chain(scene.rng.bytes(16), revisions=512)
        self.author = Author(name, self.chain)
        self.snapshots = Snapshots()
        self.life = self.chain.life

    def say(self, kind: str, payload: bytes) -> None:
        self.scene.stranger.put(self.scene.key(self.name, kind, self.life), payload)

    def commit(self, *, facts: FactsStep | None = None, submaps: dict[str, VectorMap] | None = None) -> None:
        """Say the next revision, as an honest author does."""
        said = self.author.commit(facts=facts, submaps=submaps, even_if_nothing=True)
        assert said is not None
        self.say("delta", said[0])

    def record(self, seq: int, change: Change, check: int = 5) -> bytes:
        return envelope.encode(Record(seq, self.chain.link(seq), check, change))

    def beat(self, seq: int | None = None) -> None:
        """A heartbeat: whoever has said one is there."""
        held = int(self.scene.rng.integers(1 << 62))
        self.say("digest", envelope.encode(Heartbeat(self.author.stream.seq if seq is None else seq, held)))

    def show(self, **answers: Callable[[bytes], Iterable[bytes]]) -> None:
        """Show a token, and answer the questions of these kinds."""
        for kind, function in answers.items():
            self.scene.stranger.respond(self.scene.key(self.name, kind, self.life), function)
        self.scene.stranger.token(self.scene.key(self.name, "alive", self.life))

    def honest(self) -> dict[str, Callable[[bytes], Iterable[bytes]]]:
        """True answers."""

        def snapshot(payload: bytes) -> list[bytes]:
            want = envelope.decode(payload, robot=self.name)
            assert isinstance(want, Want)
            return answer(self.author.stream, self.author.log, want, self.snapshots)

        return {"snapshot": snapshot, "revisions": lambda _: [self.list_of([])], "stats": lambda _: [ALIVE]}

    def list_of(self, rows: Iterable[tuple[str, Revision]]) -> bytes:
        """A list of what it says that it holds, and of its own stream."""
        own = [(self.name, self.author.stream.revision)] if self.author.stream.seq else []
        return envelope.encode(RevisionList(tuple(sorted([*own, *rows], key=lambda row: (row[0], row[1].life)))))


def borrowed_tokens(scene: Scene) -> None:
    """1: tokens under each robot's name, some of which answer as if they lived; one shows the robot's very life."""
    for robot in scene.fleet.running:
        Voice(scene, robot).show()
        Voice(scene, robot).show(stats=lambda _: [ALIVE])
        scene.stranger.token(scene.key(robot, "alive", scene.life(robot)))
    for _ in scene.each(1.0):
        pass


def forgotten(scene: Scene) -> None:
    """2: whatever b says is forgotten by a stranger at once, and superseded by another life of its name."""
    stranger, twin, life = Voice(scene, "x2"), Voice(scene, "b"), scene.life("b")
    for voice in (stranger, twin):
        voice.show(**voice.honest())

    def undo(word: Record | SnapshotChunk) -> None:
        state = (word.seq, word.link)
        stranger.commit(facts=forget({("b", life): state}))
        twin.commit(facts=supersede({life: state}), submaps={"0": square(4000, 4000)})

    undo(scene.last_word("b"))
    scene.on_word("b", undo)
    for _ in scene.each(CONTEST_S):
        pass


def forged(scene: Scene) -> None:
    """3: as b, in its very life: the next seq; the same seq with its link and other content; heartbeats far ahead."""
    life, empty = scene.life("b"), Change({}, ())
    delta = scene.key("b", "delta", life)

    def race(word: Record) -> None:
        # The others may hear this first.
        scene.stranger.put(delta, envelope.encode(Record(word.seq, word.link, word.check ^ 1, empty)))

    scene.on_word("b", race)
    for i in scene.each(0.1):
        word = scene.last_word("b")
        race(Record(word.seq, word.link, 0, empty))
        scene.stranger.put(delta, envelope.encode(Record(word.seq + 1, int(scene.rng.integers(1 << 62)), 5, empty)))
        if i % 5 == 0:
            scene.stranger.put(scene.key("b", "digest", life), envelope.encode(Heartbeat(1 << 18, 7)))


def lying_mirror(scene: Scene) -> None:
    """4: of an absent b, mirrors hold later revisions, and another one of its last seq, which they show."""
    said = scene.last_word("b")
    robot, life = "b", scene.life("b")
    scene.fleet.kill("b")
    lie = Stream(robot, life, said.seq, submaps={"0": square(4000, 4000)}, link=said.link)
    later = Revision(life, said.seq + 50, 7)
    forged_chunks = snapshot_messages(lie)
    ahead = snapshot_messages(Stream(robot, life, said.seq + 50, submaps=lie.submaps, link=5))
    voices = [Voice(scene, f"x4{i}") for i in range(MIRRORS)]
    for i, voice in enumerate(voices):
        row, chunks = (later, ahead) if i == MIRRORS - 1 else (lie.revision, forged_chunks)
        listed = voice.list_of([(robot, row)])
        voice.show(revisions=lambda _, listed=listed: [listed], mirror=lambda _, chunks=chunks: chunks)
    for _ in scene.each(0.5):
        for voice in voices:
            voice.beat()
    # Back, in another life.


def unseen(scene: Scene) -> None:
    """5: records of new names, none of whom shows a token."""
    for i in scene.each(0.2):
        Voice(scene, f"x5{i}").commit(submaps={"0": square(4000 + 40 * i, 4000)})


def wrong_checks(scene: Scene) -> None:
    """6: small records that don't fit, under the own name; then large ones in b's very life, to use its budget up."""
    voice = Voice(scene, "x6")
    voice.show(**voice.honest())
    voice.commit(submaps={"0": square(4000, 4000)})
    large = Change({}, (SubmapChange("0", None, scene.rng.bytes(4_000_000)),))
    as_b = scene.key("b", "delta", scene.life("b"))
    for i in scene.each(0.02):
        voice.say("delta", voice.record(2 + i % 2, Change({}, (SubmapChange("0", None, b"\x00"),))))
        if i % 15 == 0:
            word = scene.last_word("b")
            forged_seq = envelope.encode(Record(word.seq + 1 - i % 2, word.link, 1, large))
            scene.stranger.put(as_b, forged_seq)


def gaps(scene: Scene) -> None:
    """7: 120 of the largest records behind a gap, of valid chains of 8 names; and parts of snapshots."""
    voices = [Voice(scene, f"x7{i}") for i in range(8)]
    large = Change({}, (SubmapChange("0", None, scene.rng.bytes(4_000_000)),))
    for voice in voices:
        chunks = [SnapshotChunk(9, 5, voice.chain.link(9), i, 2048, scene.rng.bytes(2048)) for i in range(2, 16)]
        replies = [envelope.encode(chunk) for chunk in chunks]
        voice.show(**{**voice.honest(), "snapshot": lambda _, replies=replies: replies})
        voice.commit(submaps={"0": square(4000, 4000)})
    for i in scene.each(0.05):
        if i < 120:
            voice = voices[i % len(voices)]
            voice.say("delta", voice.record(3 + i // len(voices), large))


def many_names(scene: Scene) -> None:
    """8: 1100 names say a record each; half of them show a token."""
    for i in range(1100):
        voice = Voice(scene, f"x8{i}")
        if i % 2:
            voice.show()
        voice.commit(submaps={"0": square(4000 + 40 * (i % 30), 4000 + 40 * (i // 30))})
        if scene.over.is_set():
            return
    for _ in scene.each(1.0):
        pass


def many_tokens(scene: Scene) -> None:
    """9: 2000 tokens of as many names, and 1000 of one."""
    for i in range(3000):
        scene.stranger.token(scene.key("x9" if i % 3 == 0 else f"x9{i}", "alive", i + 1))
        if scene.over.is_set():
            return
    for _ in scene.each(1.0):
        pass


def false_lists(scene: Scene) -> None:
    """10: somebody who answers nothing; and one who lists 1000 streams that nobody has."""
    Voice(scene, "x10").show()
    liar = Voice(scene, "x10l")
    for i in scene.each(0.5):
        rows = [(f"ghost{j}", Revision(j + 1, 5 + i, 7)) for j in range(1000)]
        listed = liar.list_of(rows)
        if i == 0:
            liar.show(revisions=lambda _, listed=listed: [listed], mirror=lambda _: [])
        liar.beat()


def many_questions(scene: Scene) -> None:
    """11: 200 questions a second for whole snapshots, of b's and through b."""
    want = {r: envelope.encode(Want(r, Revision(scene.life(r), 0, 0))) for r in ("a", "b")}
    keys = [
        (scene.key("b", "snapshot", scene.life("b")), want["b"]),
        (scene.key("b", "mirror", scene.life("b")), want["a"]),
    ]
    for i in scene.each(0.005):
        key, payload = keys[i % 2]
        scene.stranger.session.get(key, lambda _: None, payload=payload, timeout=1.0)


def heavy_records(scene: Scene) -> None:
    """12: a record of 200 submaps, with as many edges as one robot may have, whose digest is wrong; again and again."""
    header = change_between(Stream("x", 1), Stream("x", 1, 1, submaps={"0": crossing(scene.rng, 1, 800)}))[0].submaps[0]
    parts = tuple(SubmapChange(f"s{i}", header.map_header, header.payload) for i in range(200))
    heavy = Change({}, parts)
    for i in scene.each(0.2):
        voice = Voice(scene, f"x12{i % 6}")
        voice.show()
        voice.beat()
        voice.say("delta", voice.record(1, heavy))


def crossings(scene: Scene) -> None:
    """13: six records of edges that cross all over, as dense as one robot may have them; of one name, then of six."""
    maps = [crossing(scene.rng, 3, 16_000) for _ in range(6)]
    voice = Voice(scene, "x13")
    voice.commit(submaps={str(i): maps[i] for i in range(2)})
    for i in scene.each(0.2):
        if i < 6:
            Voice(scene, f"x13{i}").commit(submaps={"0": maps[i]})


@dataclass(frozen=True)
class Attack:
    """An attack, and who else takes part in it.

    Parameters
    ----------
    newcomer : joins while it lasts
    returns : was killed in it, and starts anew while it lasts
    """

    say: Callable[[Scene], None]
    newcomer: str | None = None
    returns: str | None = None


ATTACKS = {
    1: Attack(borrowed_tokens),
    2: Attack(forgotten),
    3: Attack(forged),
    5: Attack(unseen),
    6: Attack(wrong_checks),
    7: Attack(gaps),
    10: Attack(false_lists),
    11: Attack(many_questions),
    12: Attack(heavy_records),
    4: Attack(lying_mirror, newcomer="e", returns="b"),
    9: Attack(many_tokens, newcomer="f"),
    8: Attack(many_names, newcomer="g"),
    13: Attack(crossings),
}
"""By number, in an order in which one fleet can have them all: the last ones leave most behind."""


@dataclass
class Outcome:
    """What an attack did to the fleet.

    Parameters
    ----------
    quiet_s, under_s : from publish to held, of each change at each other robot, before and meanwhile
    right_s : until all honest maps were right everywhere after the last change, with the stranger still speaking
    came_s : until the newcomer's map was held everywhere, from its start on; with the stranger still speaking
    recovered_s : until all saw all, and ``synced()`` returned one digest, after it had left
    looks : whose map was wrong at whom, at each look meanwhile
    growth_bytes : of the process that grew most
    lies : where ``synced()`` returned, and a map was wrong
    faults : what took too long to be measured
    """

    quiet_s: list[float] = field(default_factory=list)
    under_s: list[float] = field(default_factory=list)
    right_s: float = float("inf")
    came_s: float = 0.0
    recovered_s: float = float("inf")
    looks: list[list[str]] = field(default_factory=list)
    growth_bytes: int = 0
    lies: list[str] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)


def trial(fleet: Fleet, attack: Attack, *, seconds: float, rng: np.random.Generator, factor: float = 1.0) -> Outcome:
    """Attack a fleet for some seconds, leave, and see. The fleet is whole afterwards, if it can be."""
    outcome = Outcome(quiet_s=fleet.latencies_s(len(fleet.running)))
    before = fleet.rss_bytes()

    @contextmanager
    def noted(what: str) -> Iterable[None]:
        try:
            yield
        except (TimeoutError, RuntimeError, FleetmapError) as error:
            outcome.faults.append(f"{what}: {error}")

    def weigh() -> None:
        growth = [size - before[robot] for robot, size in fleet.rss_bytes().items() if robot in before]
        outcome.growth_bytes = max(outcome.growth_bytes, *growth)

    failures: list[BaseException] = []

    def say() -> None:
        try:
            attack.say(scene)
        except BaseException as error:
            failures.append(error)
        finally:
            scene.ready.set()

    with Stranger(connect=[fleet.endpoints[robot] for robot in fleet.running]) as stranger:
        scene = Scene(fleet, stranger, rng)
        thread = threading.Thread(target=say, daemon=True)
        thread.start()
        scene.ready.wait()
        until_s = time.monotonic() + seconds
        if attack.newcomer is not None:
            began_s = time.monotonic()
            with noted(f"{attack.newcomer} comes"):
                fleet.start(attack.newcomer)
                fleet.joined(attack.newcomer)
                fleet.publish(attack.newcomer)
                fleet.held_s(attack.newcomer, timeout_s=RIGHT_S * factor)
                outcome.came_s = time.monotonic() - began_s
        if attack.returns is not None:
            with noted(f"{attack.returns} returns"):
                stranger.token(scene.key(attack.returns, "alive", 77))
                fleet.start(attack.returns)
                fleet.joined(attack.returns)
        with noted("publish to held"):
            while time.monotonic() < until_s or not outcome.under_s:
                outcome.under_s += fleet.latencies_s(len(fleet.running))
                outcome.looks.append(fleet.wrong())
                weigh()
        with noted("right under attack"):
            outcome.right_s = fleet.until_none(fleet.wrong, timeout_s=2 * RIGHT_S * factor)
        with noted("synced under attack"):
            outcome.lies += fleet.synced_lies(timeout_s=0.5)
        weigh()
        scene.over.set()
        thread.join(60.0)
    with noted("recovery"):
        outcome.recovered_s = fleet.until_none(
            lambda: fleet.unseen() or fleet.wrong() or fleet.missing(timeout_s=RIGHT_S),
            timeout_s=2 * RECOVERY_S * factor,
        )
    weigh()
    outcome.faults += [f"the attack itself: {error!r}" for error in failures]
    return outcome
