"""Of an absent robot others say what it said, and some of them lie: it costs time, and nothing else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from exchange import Fleet, Node, chain, commit, life, room, rooms, said

from fleetmap.codecs import envelope
from fleetmap.codecs.messages import Heartbeat, Revision, RevisionList, SnapshotChunk
from fleetmap.engine import Alive, Engine, Input, Limits, Message, Query
from fleetmap.engine.engine import LARGEST_LIVES
from fleetmap.engine.log import snapshot_messages
from fleetmap.engine.stream import Stream
from fleetmap.model.vectormap import VectorMap

LONG_S = 20.0


class Mirror:
    """Takes part in the medium under a name, and answers as it is told to."""

    def __init__(self, fleet: Fleet, name: str, answer: Callable[[str], list[bytes]]) -> None:
        self.answer = answer
        self.link = fleet.hub.link(name)
        self.link.connect(self)
        self.link.display(chain(name).life)

    def deliver(self, item: Input) -> None:
        if isinstance(item, Query):
            item.reply(self.answer(item.kind))


def mirror(fleet: Fleet, name: str, claimed: Stream, messages: list[bytes]) -> Mirror:
    """One that claims a state of somebody's, and answers with these messages."""
    rows = envelope.encode(RevisionList(((claimed.robot, claimed.revision),)))
    return Mirror(fleet, name, lambda kind: [rows] if kind == "revisions" else messages)


def uneven(count: int) -> VectorMap:
    """So many rooms with walls of any thickness: a snapshot of them takes several chunks."""
    even = rooms(count)
    return VectorMap(even.lattice, even.edges, np.random.default_rng(1).integers(1, 200, 4 * count).astype(np.uint8))


def absent(fleet: Fleet, robot: str) -> Stream:
    """What a robot has said, which is gone."""
    fleet.nodes[robot].publish(uneven(1500))
    fleet.run(2.0)
    return fleet.kill(robot).engine.own


def until_held(fleet: Fleet, node: Node, true: Stream) -> float:
    """How long it takes until a peer holds what was said."""
    before_s = fleet.clock.now_s
    while node.engine.holdings.revision(true.key) != true.revision:
        assert fleet.clock.now_s < before_s + LONG_S, node.engine.lacking()
        fleet.run(0.1)
    return fleet.clock.now_s - before_s


def test_a_lie_is_outvoted_though_somebody_claims_a_later_revision_that_nobody_can_show() -> None:
    fleet = Fleet("bcd")
    fleet.run(1.0)
    true = absent(fleet, "d")
    lie = Stream("d", true.life, true.seq, true.facts, {"0": room(9)}, true.link)
    later = Stream("d", true.life, true.seq + 7, true.facts, {"0": room(9)}, 12345)
    mirror(fleet, "liar", lie, snapshot_messages(lie))
    # It meets the liar alone.
    for name in "bc":
        fleet.hub.cut("e", name)
    newcomer = fleet.add("e")
    fleet.run(3.0)
    assert newcomer.engine.holdings.revision(true.key) == lie.revision
    mirror(fleet, "stranger", later, snapshot_messages(later))
    fleet.run(3.0)
    for name in "bc":
        fleet.hub.heal("e", name)
    until_held(fleet, newcomer, true)


@pytest.mark.parametrize("spoilt", ["bytes of a chunk", "the digest", "the last chunk is missing"])
def test_a_mirror_whose_parts_do_not_fit_spoils_none_of_those_of_others(spoilt: str) -> None:
    fleet = Fleet("bcd")
    fleet.run(1.0)
    true = absent(fleet, "d")
    honest = snapshot_messages(true)
    assert len(honest) > 3
    chunks = [chunk for raw in honest if isinstance(chunk := envelope.decode(raw, robot="d"), SnapshotChunk)]
    match spoilt:
        case "bytes of a chunk":
            chunks[0] = replace(chunks[0], data=bytes(len(chunks[0].data)))
        case "the digest":
            chunks = [replace(chunk, digest=chunk.digest ^ 1) for chunk in chunks]
        case _:
            chunks.pop()
    # Its name comes first where nothing else decides, and there are more of it than of honest ones.
    for name in ("a1", "a2", "a3"):
        mirror(fleet, name, true, [envelope.encode(chunk) for chunk in chunks])
    assert until_held(fleet, fleet.add("e"), true) < 10.0


def test_whoever_invents_lives_of_a_robot_that_runs_does_not_crowd_it_out() -> None:
    fleet = Fleet("abc")
    limits = Limits(400)
    for node in fleet.nodes.values():
        node.engine.limits = limits
        node.engine.holdings.most_edges_of_a_name = LARGEST_LIVES * limits.edges
    fleet.run(1.0)
    fleet.nodes["b"].publish(rooms(2))
    fleet.run(1.0)
    runs = fleet.nodes["b"].engine.own
    twins = [Engine("b", chain=chain("b", 10 + i)) for i in range(LARGEST_LIVES + 1)]
    for twin in twins:
        commit(twin, submaps={"0": rooms(100)})
        for node in fleet.nodes.values():
            node.deliver(Alive(*twin.own.key))
    for _ in range(3):
        for twin in twins:
            for node in fleet.nodes.values():
                node.deliver(Message("b", twin.own.life, "digest", envelope.encode(Heartbeat(twin.own.seq, 7))))
        for twin in twins:
            for put in said(twin):
                for node in fleet.nodes.values():
                    node.deliver(Message("b", put.life, put.kind, put.payload))
        fleet.run(1.0)
        for node in fleet.nodes.values():
            assert node.holds()[runs.key] == (runs.seq, runs.digest)
            assert runs.key in node.merges()
    assert fleet.nodes["b"].open


def test_what_was_dropped_is_not_asked_for_again_and_again() -> None:
    """Its author's heartbeat says its seq, and no digest."""
    fleet = Fleet("ab")
    fleet.run(1.0)
    holdings = fleet.nodes["a"].engine.holdings
    holdings.drop(("b", life("b")))
    own = fleet.nodes["b"].engine.own
    assert holdings.was_dropped(own.key, own.revision)
    assert holdings.was_dropped(own.key, Revision(own.life, own.seq, 0))
    assert not holdings.was_dropped(own.key, Revision(own.life, own.seq + 1, 0))
    assert not holdings.was_dropped(own.key, Revision(own.life, own.seq, own.digest ^ 1))
