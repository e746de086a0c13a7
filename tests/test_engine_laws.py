"""Laws of the exchange, each of which has broken an engine of this kind somewhere."""

from __future__ import annotations

import contextlib
import itertools

import numpy as np
import pytest
from exchange import Fleet as Nodes
from exchange import (
    asks,
    chain,
    deliver,
    engine,
    held,
    meet,
    query,
    read_record,
    records,
    reply,
    room,
    rooms,
    said,
    tell,
)
from schedules import Fleet

from fleetmap.codecs import envelope
from fleetmap.codecs.fmap import load_fmap, save_fmap
from fleetmap.codecs.messages import Record, Revision, RevisionList, Want
from fleetmap.engine import Gone, Limits, holdings
from fleetmap.engine.chain import Chain, before
from fleetmap.engine.log import snapshot_messages
from fleetmap.engine.stream import Stream
from fleetmap.model.errors import ConfigError
from fleetmap.model.lattice import Lattice
from fleetmap.model.pose import FixedPose
from fleetmap.model.vectormap import VectorMap


def scattered(count: int) -> VectorMap:
    """Rectangles of all sizes, which no codec can say in few bytes."""
    rng = np.random.default_rng(0)
    rows = []
    for i in range(count):
        (y, x), (h, w) = np.array(divmod(i, 100)) * 100, rng.integers(1, 90, 2)
        corners = [(y, x), (y, x + w), (y + h, x + w), (y + h, x)]
        rows += [(*a, *b, 1) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
    return VectorMap(Lattice(50_000), np.array(rows, np.int32), rng.integers(1, 30, len(rows)).astype(np.uint8))


def test_whatever_way_a_stream_comes_it_has_one_digest(tmp_path) -> None:
    author, by_record, by_snapshot, by_mirror = (engine(name) for name in ("r", "x", "y", "z"))
    for size in range(5, 12):
        author.publish("0", room(size))
        author.publish("s", rooms(size), anchor=FixedPose(size, 5))
    tell(by_record, author, *records(author))
    for listener, asked, kind in ((by_snapshot, author, "snapshot"), (by_mirror, by_snapshot, "mirror")):
        meet(listener, asked)
        rows = envelope.encode(RevisionList(((author.robot, author.own.revision),)))
        listener.tick(0.0)
        for ask in asks(listener, "revisions"):
            reply(listener, ask, rows)
        listener.tick(1.0)
        (ask,) = asks(listener, kind)
        reply(listener, ask, *query(asked, kind, ask.payload), now_s=1.0)
    paths = [tmp_path / f"{name}.fmap" for name in author.own.submaps]
    for path, vector_map in zip(paths, author.own.submaps.values(), strict=True):
        save_fmap(vector_map, path)
    read = dict(zip(author.own.submaps, map(load_fmap, paths), strict=True))
    by_file = Stream("r", author.own.life, author.own.seq, author.own.facts, read)
    found = [held(listener, author) for listener in (by_record, by_snapshot, by_mirror)]
    assert {s.digest for s in (*found, by_file)} == {author.own.digest}


def test_nobody_can_show_a_later_link_than_he_was_shown() -> None:
    links = Chain(b"secret", revisions=600)
    for seq in (1, 2, 255, 256, 257, 600):
        assert before(links.link(seq), seq, seq) == links.life
        assert before(links.link(seq), seq, 1) == links.link(seq - 1)
        assert before(links.link(seq) ^ 1, seq, seq) != links.life
        # Of another seq: the place is hashed, too.
        assert before(links.link(seq), seq + 1, seq) != links.life
    with pytest.raises(ValueError, match="600 revisions"):
        links.link(601)
    assert Chain(b"secret", revisions=600).life == links.life
    assert Chain(links.next_seed(), revisions=600).life != links.life


def test_a_fork_is_found_and_named_and_the_next_word_decides() -> None:
    """A disk image that was put back: two processes go on from one life."""
    twins = [engine("r") for _ in range(2)]
    a, b = engine("a"), engine("b")
    meet(a, b)
    for peer, twin, size in ((a, twins[0], 5), (b, twins[1], 9)):
        twin.publish("0", room(size))
        tell(peer, twin, *records(twin))
    assert held(a, twins[0]).seq == held(b, twins[0]).seq
    assert held(a, twins[0]).digest != held(b, twins[0]).digest
    asked = [(peer, other, asks(peer, "revisions")) for peer, other in ((a, b), (b, a))]
    for peer, other, (ask,) in asked:
        reply(peer, ask, *query(other, "revisions", b""))
    for peer in (a, b):
        (text,) = peer.disputed().values()
        assert "a: digest" in text
        assert "b: digest" in text
        assert any("disputed" in line for line in peer.lacking())
    # The author is heard: what it says to both decides.
    for peer in (a, b):
        meet(peer, twins[0])
    twins[0].publish("0", room(7))
    deliver(twins[0], a, b)
    for ask in asks(b, "snapshot"):
        reply(b, ask, *query(twins[0], "snapshot", ask.payload))
    assert held(a, twins[0]).revision == held(b, twins[0]).revision == twins[0].own.revision
    assert a.disputed() == b.disputed() == {}


def test_of_an_absent_author_that_was_never_heard_most_names_decide_until_it_is_forgotten() -> None:
    author, me = engine("r", start=FixedPose()), engine("me", start=FixedPose())
    author.publish("0", room(5))
    said(author)
    true = author.own
    lie = Stream("r", true.life, true.seq, true.facts, {"0": rooms(9)}, true.link)
    rows = {"liar": lie, "h1": true, "h2": true, "h3": true}
    peers = [engine(name) for name in rows]
    meet(me, *peers)
    # The liar answers first.
    for now_s in np.arange(0.0, 5.0, 0.1).tolist():
        me.tick(now_s)
        for ask in asks(me):
            if ask.kind == "revisions":
                listed = RevisionList((("r", rows[ask.robot].revision),))
                reply(me, ask, envelope.encode(listed), now_s=now_s)
            else:
                reply(me, ask, *snapshot_messages(rows[ask.robot]), now_s=now_s)
    assert held(me, author).revision == true.revision
    assert "liar" in me.disputed()["r"]
    assert me.lacking()
    me.forget("r")
    assert not me.disputed()
    assert not me.lacking()


def test_what_was_heard_from_its_author_no_mirror_replaces_and_none_blocks() -> None:
    author, me, mirror = (engine(name) for name in ("r", "me", "m"))
    author.publish("0", room(5))
    heard = records(author)
    tell(me, author, *heard)
    meet(me, mirror)
    forged = Stream("r", author.own.life, author.own.seq, author.own.facts, {"0": rooms(9)}, author.own.link)
    me.tick(0.0)
    (ask,) = asks(me, "revisions")
    reply(me, ask, envelope.encode(RevisionList((("r", forged.revision),))))
    for now_s in (0.2, 0.5, 1.0):
        me.tick(now_s)
        for ask in asks(me, "mirror"):
            reply(me, ask, *snapshot_messages(forged), now_s=now_s)
    assert held(me, author).digest == author.own.digest
    author.publish("0", room(6))
    deliver(author, me)
    assert held(me, author).revision == author.own.revision


@pytest.mark.parametrize("order", list(itertools.permutations(["forget", "publish", "heal"])))
@pytest.mark.parametrize("how", ["everywhere", "supersede"])
def test_forgetting_and_publishing_on_two_sides_of_a_cut_end_alike_at_all(order: tuple[str, ...], how: str) -> None:
    fleet = Nodes("abc")
    fleet.run(1.0)
    a, b, c = (fleet.nodes[name] for name in "abc")
    a.publish(room(10))
    b.publish(rooms(2))
    fleet.run(1.0)
    if how == "supersede":
        # A former life of a goes on beside the new one, on the far side of the cut.
        a2 = fleet.add("a", run=2)
        fleet.nodes["a2"] = a2
        fleet.nodes["a"] = a
        fleet.run(1.0)
    for name in "bc":
        fleet.hub.cut("a", name)
    fleet.run(1.0)
    for step in order:
        match step:
            case "forget" if how == "everywhere":
                b.forget("a", everywhere=True)
            case "forget":
                with contextlib.suppress(ConfigError):  # whoever is seen to live is not superseded
                    a2.forget("a")
            case "publish":
                a.publish(room(12))
            case "heal":
                for name in "bc":
                    fleet.hub.heal("a", name)
        fleet.run(2.0)
    for name in "bc":
        fleet.hub.heal("a", name)
    fleet.run(10.0)
    holds = {name: node.holds() for name, node in fleet.nodes.items()}
    assert all(one == holds["b"] for one in holds.values())
    # A robot that lives is in the map in the end, whatever came first.
    assert a.engine.own.key in c.merges()
    assert a.engine.own.key in a.merges()
    assert a.engine.own.key in b.merges()


def test_records_whose_base_never_comes_hold_up_nobody_else() -> None:
    me, honest, bad = (engine(name) for name in ("me", "h", "bad"))
    meet(me, honest, bad)
    links = chain("bad")
    for seq in range(3, 60):
        tell(me, bad, envelope.encode(Record(seq, links.link(seq), 5, read_record(records(engine("bad"))[0]).change)))
    honest.publish("0", room(5))
    deliver(honest, me)
    assert held(me, honest).revision == honest.own.revision


@pytest.mark.parametrize("links_live_s", [2.5, 4.0])
def test_repair_makes_progress_however_short_the_links_live(links_live_s: float) -> None:
    fleet = Fleet(np.random.default_rng(0), rate_Bps=1200.0)
    author = fleet.start("a")
    author.publish(scattered(1500))
    # Long enough for a question and one chunk of 2 kB.
    size_bytes = sum(map(len, snapshot_messages(author.engine.own)))
    reader = fleet.start("b")
    assert size_bytes > 1.5 * 1200 * links_live_s  # one link can't carry it
    for _ in range(60):
        fleet.run(links_live_s)
        if reader.holds() == author.holds():
            break
        fleet.hub.cut("a", "b")
        fleet.run(0.5)
        fleet.hub.heal("a", "b")
    assert reader.holds() == author.holds()


def bytes_for_a_newcomer(names: list[str]) -> int:
    """What three honest peers send, in all, so that a fourth one gets streams of absent authors."""
    fleet = Nodes("abc")
    fleet.run(1.0)
    for i, name in enumerate(names):
        gone = fleet.add(name)
        gone.publish(rooms(5 + i % 3))
        fleet.run(0.1)
        fleet.kill(name)
    fleet.run(10.0)
    fleet.assert_equal()
    before = sum(node.engine.ledger.stats().bytes_vector for node in fleet.nodes.values())
    fleet.add("d")
    fleet.run(20.0)
    fleet.assert_equal()
    return sum(node.engine.ledger.stats().bytes_vector for node in fleet.nodes.values()) - before


def test_names_that_an_attacker_chooses_cost_at_most_twice_the_honest_bytes() -> None:
    honest = bytes_for_a_newcomer([f"r{i:02}" for i in range(20)])
    longest = bytes_for_a_newcomer([f"{'x' * 62}{i:02}" for i in range(20)])
    assert longest <= 2 * honest


def test_a_peer_that_has_more_than_a_part_of_an_answer_gets_the_rest_of_the_same_snapshot() -> None:
    author, me = engine("r"), engine("me")
    author.publish("0", scattered(8000))
    said(author)
    meet(me, author)
    me.tick(0.0)
    (ask,) = asks(me, "revisions")
    reply(me, ask, *query(author, "revisions", b""))
    parts = 0
    for now_s in np.arange(0.2, 30.0, 0.1):
        me.tick(float(now_s))
        for ask in asks(me, "snapshot"):
            want = envelope.decode(ask.payload, robot="me")
            assert isinstance(want, Want)
            assert want.revision == Revision(author.own.life, 0, 0)
            assert (want.partial is None) == (parts == 0)
            parts += 1
            reply(me, ask, *query(author, "snapshot", ask.payload), now_s=float(now_s))
        if held(me, author).revision == author.own.revision:
            break
    assert held(me, author).revision == author.own.revision
    assert parts > 1


def test_who_is_gone_is_not_waited_for() -> None:
    me, other = engine("me"), engine("r")
    meet(me, other)
    assert me.lacking() == ["the list of r"]
    me.receive(Gone(*other.own.key), now_s=1.0)
    assert me.lacking() == []


def test_what_somebody_was_asked_for_who_is_gone_is_asked_of_another() -> None:
    me, author, *mirrors = (engine(name) for name in ("me", "a", "b", "c"))
    author.publish("0", room(5))
    meet(me, *mirrors)
    me.tick(2.0)
    for ask in asks(me, "revisions"):
        reply(me, ask, envelope.encode(RevisionList(((author.robot, author.own.revision),))), now_s=2.0)
    me.tick(3.0)
    (first,) = asks(me, "mirror")
    me.receive(Gone(first.robot, first.life), now_s=3.1)
    me.tick(3.2)
    (second,) = asks(me, "mirror")
    assert {first.robot, second.robot} == {"b", "c"}


def test_the_lives_of_one_name_hold_no_more_together_than_five_of_the_largest() -> None:
    me = engine("me", limits=Limits(edges=400, edges_in_square=400))
    for run in range(9):
        crowd = engine("crowd", run=run + 1)
        crowd.publish("0", rooms(90 + run))
        tell(me, crowd, *records(crowd))
    edges = [s.edges for s in me.holdings.streams() if s.robot == "crowd"]
    assert sorted(edges) == [4 * (90 + run) for run in range(4, 9)]


def test_who_was_dropped_for_want_of_room_is_looked_at_again_when_there_is_room(monkeypatch) -> None:
    me, mirror = engine("me"), engine("mirror")
    meet(me, mirror)
    authors = [engine(f"r{size}") for size in range(2, 7)]
    for size, author in enumerate(authors, 2):
        author.publish("0", rooms(size))
        tell(me, author, *records(author))
    monkeypatch.setattr(holdings, "MAX_STREAMS", 3)
    authors[-1].publish("0", rooms(9))
    tell(me, authors[-1], *records(authors[-1]))
    dropped = [author.robot for author in authors if held(me, author).seq == 0]
    assert dropped == ["r2", "r3"]
    rows = envelope.encode(RevisionList(tuple((author.robot, author.own.revision) for author in authors)))

    def asked_of_mirror(from_s: float) -> list[str]:
        """About whose streams, while it says again what it holds."""
        me.ask_lists(now_s=from_s)
        robots = []
        for now_s in np.arange(from_s, from_s + 3.0, 0.1):
            me.tick(float(now_s))
            for ask in asks(me):
                if ask.kind == "revisions":
                    reply(me, ask, rows, now_s=float(now_s))
                else:
                    want = envelope.decode(ask.payload, robot="me")
                    assert isinstance(want, Want)
                    robots.append(want.robot)
        return robots

    assert asked_of_mirror(1.0) == []
    monkeypatch.setattr(holdings, "MAX_STREAMS", 1024)
    assert asked_of_mirror(20.0) == dropped
