"""What a stranger without any key can do to four honest robots, on the memory link: thirteen attacks."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest
from exchange import Fleet, Node, chain, commit, engine, said

from fleetmap.codecs import envelope
from fleetmap.codecs.facts import forget
from fleetmap.codecs.messages import (
    MAX_MESSAGE_BYTES,
    Change,
    MapHeader,
    Record,
    Revision,
    RevisionList,
    SubmapChange,
    Want,
)
from fleetmap.codecs.protocol import encode_snapshot
from fleetmap.engine import Alive, Engine, Gone, Message, Query
from fleetmap.engine.holdings import MAX_STREAMS, MAX_WAITING_BYTES
from fleetmap.engine.log import snapshot_messages
from fleetmap.engine.neighbours import MAX_LIVES, MAX_NEIGHBOURS
from fleetmap.engine.stream import Stream
from fleetmap.model.lattice import Lattice
from fleetmap.model.vectormap import VectorMap


def boxes(count: int, *, side: int = 5) -> VectorMap:
    """So many closed squares, each at a place of its own."""
    places = np.arange(count)
    low = np.stack([places // 100 * 10, places % 100 * 10], axis=1).reshape(-1, 1, 2)
    points = low + np.array([(0, 0), (0, side), (side, side), (side, 0), (0, 0)])
    rows = np.concatenate([points[:, :-1], points[:, 1:], np.ones((count, 4, 1), np.int64)], axis=2)
    return VectorMap(Lattice(50_000), rows.reshape(-1, 5).astype(np.int32), np.full(4 * count, 4, np.uint8))


@dataclass
class Stranger:
    """Says what it likes to all, under any name; answers as it is told to."""

    fleet: Fleet
    shown: list[tuple[str, int]] = field(default_factory=list)
    answered: list[bytes] = field(default_factory=list)

    def say(self, robot: str, life: int, payload: bytes, *, kind: str = "delta") -> None:
        for node in self.fleet.nodes.values():
            node.deliver(Message(robot, life, kind, payload))

    def show(self, robot: str, life: int) -> None:
        self.shown.append((robot, life))
        for node in self.fleet.nodes.values():
            node.deliver(Alive(robot, life))

    def ask(self, robot: str, kind: str, payload: bytes) -> None:
        self.fleet.nodes[robot].deliver(Query(kind, payload, lambda replies, last=True: self.answered.extend(replies)))

    def publish(self, author: Engine) -> None:
        for put in said(author):
            self.say(author.robot, put.life, put.payload, kind=put.kind)

    def answers(self, name: str, answer: Callable[[str, bytes], list[bytes]]) -> int:
        """Take part in the medium under a name; returns its life."""
        link = self.fleet.hub.link(name)

        class Receiver:
            def deliver(self, item) -> None:
                if isinstance(item, Query):
                    item.reply(answer(item.kind, item.payload))

        link.connect(Receiver())
        link.display(chain(name).life)
        self.links = [*getattr(self, "links", []), link]
        return chain(name).life

    def leave(self) -> None:
        for link in getattr(self, "links", []):
            link.vanish()
        for node in self.fleet.nodes.values():
            for token in self.shown:
                node.deliver(Gone(*token))


def victim(fleet: Fleet) -> Engine:
    return fleet.nodes["b"].engine


def tokens_of_the_victim(fleet: Fleet, stranger: Stranger) -> None:
    for i in range(40):
        stranger.show("b", i)


def a_record_that_forgets_the_victim(fleet: Fleet, stranger: Stranger) -> None:
    bad = engine("bad")
    stranger.publish(bad)
    for ahead in (0, 1, 200_000):
        own = victim(fleet).own
        commit(bad, facts=forget({own.key: (own.seq + ahead, own.link)}))
        stranger.publish(bad)


def records_under_the_victims_very_life(fleet: Fleet, stranger: Stranger) -> None:
    own = victim(fleet).own
    for ahead in (1, 2, 50, 5000):
        stranger.say("b", own.life, envelope.encode(Record(own.seq + ahead, 12345, 7, Change({}, ()))))
    # Other bytes beside the last link that the victim has shown.
    stranger.say("b", own.life, envelope.encode(Record(own.seq, own.link, own.revision.check ^ 1, Change({}, ()))))


def a_mirror_that_lies_of_an_absent_robot(fleet: Fleet, stranger: Stranger) -> None:
    gone = fleet.kill("d").engine.own
    ahead = Stream("d", gone.life, gone.seq + 1000, gone.facts, {"0": boxes(1)}, 12345)
    other = Stream("d", gone.life, gone.seq, gone.facts, {"0": boxes(2)}, gone.link)

    def answer(kind: str, payload: bytes) -> list[bytes]:
        if kind == "revisions":
            return [envelope.encode(RevisionList((("d", ahead.revision),)))]
        return [*snapshot_messages(ahead), *snapshot_messages(other)]

    stranger.answers("mirror", answer)


def a_record_of_a_new_name(fleet: Fleet, stranger: Stranger) -> None:
    bad = engine("bad")
    bad.publish("0", boxes(3))
    stranger.publish(bad)


def short_records_with_a_wrong_check(fleet: Fleet, stranger: Stranger) -> None:
    before = {name: node.engine.ledger.stats().bytes_vector for name, node in fleet.nodes.items()}
    for name, node in fleet.nodes.items():
        own = node.engine.own
        for _ in range(50):
            raw = envelope.encode(Record(own.seq, own.link ^ 5, own.revision.check ^ 1, Change({}, ())))
            stranger.say(name, own.life, raw)
    fleet.run(0.2)
    # Nobody sends a map for it.
    after = {name: node.engine.ledger.stats().bytes_vector for name, node in fleet.nodes.items()}
    assert all(after[name] - before[name] < 300 for name in after)


def large_records_with_a_gap(fleet: Fleet, stranger: Stranger) -> None:
    for i in range(5):
        name = f"gap{i}"
        links = chain(name)
        stranger.say(name, links.life, envelope.encode(Record(1, links.link(1), 0, Change({}, ()))))
        for seq in range(3, 67):
            facts = {bytes([200, seq, i]) + bytes([n]): bytes(1000) for n in range(250)}
            large = envelope.encode(Record(seq, links.link(seq), 5, Change(facts, ())))
            assert len(large) < MAX_MESSAGE_BYTES
            stranger.say(name, links.life, large)
    for node in fleet.nodes.values():
        assert sum(r.waiting_bytes for r in node.engine.holdings.replicas.values()) <= MAX_WAITING_BYTES


def a_table_full_of_streams(fleet: Fleet, stranger: Stranger) -> None:
    for i in range(1100):
        links = chain(f"tiny{i}", revisions=2)
        digest = Stream(f"tiny{i}", links.life, 1).digest
        record = Record(1, links.link(1), digest & 0xFFFF, Change({}, ()))
        stranger.say(f"tiny{i}", links.life, envelope.encode(record))
    newcomer = fleet.add("e")
    newcomer.publish(boxes(4))
    fleet.run(4.0)
    for node in fleet.nodes.values():
        assert len(node.engine.holdings.replicas) <= MAX_STREAMS
        assert newcomer.engine.own.key in node.holds()


def a_crowd_of_tokens(fleet: Fleet, stranger: Stranger) -> None:
    for i in range(1000):
        stranger.show(f"t{i}", i)
    for i in range(1000):
        stranger.show("one", i)
    newcomer = fleet.add("e")
    fleet.run(4.0)
    for name, node in fleet.nodes.items():
        neighbours = node.engine.neighbours
        assert len(neighbours.by_key) <= MAX_NEIGHBOURS
        assert sum(robot == "one" for robot, _ in neighbours.by_key) <= MAX_LIVES
        assert name == "e" or newcomer.engine.own.key in neighbours


def one_who_answers_nothing_and_one_who_lists_ghosts(fleet: Fleet, stranger: Stranger) -> None:
    stranger.show("silent", 7)
    rows = tuple((f"ghost{i}", Revision(i + 1, 5, i)) for i in range(1000))
    stranger.answers("ghosts", lambda kind, _: [envelope.encode(RevisionList(rows))] if kind == "revisions" else [])


def snapshot_questions(fleet: Fleet, stranger: Stranger) -> None:
    node = fleet.nodes["a"]
    want = envelope.encode(Want("a", Revision(node.engine.own.life, 0, 0)))
    before = node.engine.ledger.stats().bytes_vector
    for _ in range(2000):
        stranger.ask("a", "snapshot", want)
    # What is sent is bounded, whoever asks; and each answer was the same bytes, encoded once.
    assert node.engine.ledger.stats().bytes_vector - before < 40 << 20
    assert len(set(stranger.answered)) <= 2


def a_record_that_takes_long_to_read(fleet: Fleet, stranger: Stranger) -> None:
    payload = encode_snapshot(boxes(15_000))
    parts = tuple(SubmapChange(f"s{i}", MapHeader(Lattice(50_000)), payload) for i in range(60))
    links = chain("slow")
    for _ in range(3):
        stranger.say("slow", links.life, envelope.encode(Record(1, links.link(1), 5, Change({}, parts))))


def as_many_edges_as_fit(fleet: Fleet, stranger: Stranger) -> None:
    for i in range(6):
        bad = Engine(f"many{i}", chain=chain(f"many{i}", revisions=8))
        everything = {f"s{n}": boxes(19_000) for n in range(8)}
        commit(bad, submaps=everything)
        stranger.publish(bad)
    for node in fleet.nodes.values():
        for replica in node.engine.holdings.replicas.values():
            assert replica.stream.edges <= node.engine.limits.edges


ATTACKS = [
    tokens_of_the_victim,
    a_record_that_forgets_the_victim,
    records_under_the_victims_very_life,
    a_mirror_that_lies_of_an_absent_robot,
    a_record_of_a_new_name,
    short_records_with_a_wrong_check,
    large_records_with_a_gap,
    a_table_full_of_streams,
    a_crowd_of_tokens,
    one_who_answers_nothing_and_one_who_lists_ghosts,
    snapshot_questions,
    a_record_that_takes_long_to_read,
    as_many_edges_as_fit,
]


@pytest.mark.parametrize("attack", ATTACKS, ids=lambda attack: attack.__name__)
def test_an_attack_neither_stops_nor_splits_nor_changes_what_honest_robots_hold(attack) -> None:
    fleet = Fleet("abcd")
    fleet.run(1.0)
    for i, node in enumerate(fleet.nodes.values()):
        node.publish(boxes(10 + i))
    fleet.run(2.0)
    honest = {node.engine.own.key: node.engine.own for node in fleet.nodes.values()}

    def right(node: Node) -> list[str]:
        """What a peer does not hold, or merge, as its author has said it."""
        streams = {s.key: s for s in node.engine.merged_streams()}
        wrong = []
        for name, life in honest:
            author = fleet.nodes.get(name)
            true = author.engine.own if author is not None else honest[name, life]
            held = streams.get((name, life))
            if held is None or held.revision != true.revision:
                wrong.append(f"{name} at {node.link.robot}")
        return wrong

    def equal() -> bool:
        keys = {key for key in honest if key[0] in fleet.nodes}
        holds = [{k: v for k, v in node.holds().items() if k in keys} for node in fleet.nodes.values()]
        return all(one == holds[0] for one in holds)

    stranger = Stranger(fleet)
    attack(fleet, stranger)
    fleet.run(5.0)
    for node in fleet.nodes.values():
        assert right(node) == []
    assert equal()
    # A change is held everywhere at once, beside the attack.
    fleet.nodes["b"].publish(boxes(30))
    fleet.run(1.5)
    assert victim(fleet).own.edges == 120
    for node in fleet.nodes.values():
        assert right(node) == []
    stranger.leave()
    for _ in range(100):
        fleet.run(0.1)
        if not any(node.engine.lacking() for node in fleet.nodes.values()):
            break
    else:
        pytest.fail(str({name: node.engine.lacking() for name, node in fleet.nodes.items()}))
    first, *others = fleet.nodes.values()
    for other in others:
        assert other.holds() == first.holds()
    assert sys.getsizeof(first.engine.neighbours.by_key) < 1 << 20
