"""The engine alone: bytes in, bytes out, and nothing that comes from the network raises."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from exchange import (
    asks,
    chain,
    deliver,
    dropped,
    engine,
    held,
    life,
    meet,
    query,
    read_record,
    records,
    reply,
    room,
    tell,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetmap.codecs import envelope as env
from fleetmap.codecs import messages as msg
from fleetmap.codecs.facts import Facts, forget, set_anchor, set_level, set_start
from fleetmap.engine import Alive, Engine, Gone, Limits, MapChanged, Message, Query, Reply, ReplyEnd, Stream
from fleetmap.engine.author import Author
from fleetmap.engine.log import MAX_LOG_RECORDS, RecordLog, Snapshots, answer, snapshot_messages
from fleetmap.engine.replica import Outcome, Replica
from fleetmap.engine.stream import advance, change_between
from fleetmap.engine.view import view
from fleetmap.model.errors import ConfigError, WireError
from fleetmap.model.lattice import Lattice
from fleetmap.model.pose import FixedPose, Pose2
from fleetmap.model.vectormap import VectorMap

LINK = life("r")
"""A life that is nobody's but r's."""


def listener(*authors: Engine) -> Engine:
    """An engine that sees these authors' tokens, and has heard all that they have said."""
    me = engine("me", start=FixedPose())
    meet(me, *authors)
    for author in authors:
        deliver(author, me)
    return me


def facts(*steps: object) -> Facts:
    """The facts after these steps."""
    result = Facts()
    for step in steps:
        result = result.after(step)  # type: ignore[arg-type]
    return result


def test_the_digest_tells_robot_life_frame_and_content_apart() -> None:
    base = Stream("a", 1, 1, Facts(), {"0": room(5)})
    moved = FixedPose.from_pose(Pose2(0.0, 0.0, 0.1))
    others = [
        Stream("b", 1, 1, base.facts, base.submaps),
        Stream("a", 2, 1, base.facts, base.submaps),
        Stream("a", 1, 1, facts(set_level("1")), base.submaps),
        Stream("a", 1, 1, facts(set_start(FixedPose())), base.submaps),
        Stream("a", 1, 1, facts(forget({("c", 1): (1, 1)})), base.submaps),
        Stream("a", 1, 1, base.facts, {"1": room(5)}),
        Stream("a", 1, 1, facts(set_anchor("0", moved)), base.submaps),
        Stream("a", 1, 1, base.facts, {"0": room(6)}),
    ]
    assert len({s.digest for s in [base, *others]}) == 9
    assert Stream("a", 1, 9, base.facts, dict(base.submaps), LINK).digest == base.digest


def test_a_moved_anchor_resends_no_geometry() -> None:
    author = engine("a")
    author.publish("0", room(100))
    author.take_outputs()
    assert author.publish("0", room(100), anchor=FixedPose.from_pose(Pose2(1.0, 2.0, 0.3)))
    (record,) = records(author)
    change = read_record(record).change
    assert (change.submaps, len(change.facts)) == ((), 1)
    assert len(record) < 60


def test_an_equal_map_sends_nothing() -> None:
    author = engine("a")
    author.publish("0", room(100))
    author.take_outputs()
    assert not author.publish("0", room(100))
    assert author.take_outputs() == []
    assert author.own.seq == 2


def test_a_map_of_another_resolution_starts_the_submap_anew() -> None:
    author = engine("r")
    for size, um in ((10, 50_000), (12, 20_000)):
        author.publish("0", room(size, resolution_um=um))
    stream = held(listener(author), author)
    assert stream.digest == author.own.digest
    assert stream.submaps["0"].lattice.resolution_um == 20_000


def test_changes_name_the_frame_the_box_and_the_counts() -> None:
    author = engine("r")
    author.publish("s", room(20), anchor=FixedPose.from_pose(Pose2(10.0, 0.0, 0.0)))
    me = listener(author)
    change = [o for o in me.take_outputs() if isinstance(o, MapChanged)][-1]
    assert change.frame == ("r", author.own.life, "s")
    assert change.box_m == pytest.approx((10.0, 0.0, 11.0, 1.0))
    assert (change.edges_added, change.edges_removed) == (4, 0)
    assert change.revision == author.own.revision


def test_the_view_places_frames_by_start_and_anchor() -> None:
    start, anchor = FixedPose.from_pose(Pose2(1.0, 2.0, 0.5)), FixedPose.from_pose(Pose2(0.1, 0.2, 0.3))
    author = engine("r", start=start)
    author.publish("0", room(10), anchor=anchor)
    me = listener(author)
    me.publish("0", room(9))
    sources = {s.frame: s.T_fleet_frame for s in view(me).sources}
    own = ("me", me.own.life, "0")
    assert sources == {own: FixedPose(), ("r", author.own.life, "0"): start @ anchor}
    me.set_start(None)
    assert [s.frame for s in view(me).sources] == [own]


def test_another_level_is_held_but_not_viewed() -> None:
    author = engine("r", start=FixedPose(), level="1")
    author.publish("0", room(10))
    me = listener(author)
    assert held(me, author).revision == author.own.revision
    assert [robot for robot, _ in view(me).revisions] == ["me"]


def test_a_record_with_a_wrong_digest_changes_nothing_and_is_asked_for() -> None:
    author = engine("r")
    author.publish("0", room(10))
    first, second = records(author)
    genuine = read_record(second)
    me = listener(author)
    tell(me, author, first, env.encode(msg.Record(2, genuine.link, genuine.check ^ 1, genuine.change)))
    assert held(me, author).seq == 1
    assert dropped(me) == {("r", "delta/the result has another digest than is st"): 1}
    (ask,) = asks(me, "snapshot")
    assert env.decode(ask.payload, robot="me") == msg.Want("r", held(me, author).revision)
    reply(me, ask, *query(author, "snapshot", ask.payload), now_s=0.1)
    assert held(me, author).digest == author.own.digest


def test_who_holds_other_bytes_than_the_author_gets_a_snapshot() -> None:
    author = engine("r")
    author.publish("0", room(10))
    want = msg.Want("r", msg.Revision(author.own.life, 1, 12345))
    (raw,) = query(author, "snapshot", env.encode(want))
    assert isinstance(env.decode(raw, robot="r"), msg.SnapshotChunk)


def test_records_that_come_early_wait_for_the_one_before() -> None:
    author = engine("r")
    for size in range(5, 10):
        author.publish("0", room(size))
    sent, me = records(author), listener(author)
    tell(me, author, sent[0], *sent[:1:-1])
    assert held(me, author).seq == 1
    tell(me, author, sent[1])
    assert held(me, author).digest == author.own.digest


def test_a_large_snapshot_comes_in_chunks_in_any_order() -> None:
    rng = np.random.default_rng(0)
    ends = rng.integers(-(2**20), 2**20, (30_000, 4))
    edges = np.column_stack([ends, np.ones(len(ends), np.int64)]).astype(np.int32)
    big = VectorMap(Lattice(50_000), edges, rng.integers(0, 256, len(edges)).astype(np.uint8))
    links = chain("r")
    stream = Stream("r", links.life, 2, Facts(), {"0": big}, links.link(2))
    chunks = [env.decode(raw, robot="r") for raw in snapshot_messages(stream)]
    assert len(chunks) > 1
    replica, limits = Replica(Stream("r", links.life)), Limits(10**6, 10**6)
    outcomes = [
        replica.offer_chunk(c, limits, speaker=replica.key) for c in chunks[::-1] if isinstance(c, msg.SnapshotChunk)
    ]
    assert outcomes == [Outcome.EARLY] * (len(chunks) - 1) + [Outcome.APPLIED]
    assert replica.stream.digest == stream.digest


def test_the_log_is_bounded_and_falls_back_to_a_snapshot() -> None:
    author, snapshots = Author("r", chain("r")), Snapshots()
    author.commit(facts=set_level("1"))
    first = msg.Want("r", author.stream.revision)
    for size in range(2, MAX_LOG_RECORDS + 5):
        author.commit(submaps={"0": room(size)})
    assert author.log.since(first.revision) is None
    (raw,) = answer(author.stream, author.log, first, snapshots)
    assert isinstance(env.decode(raw, robot="r"), msg.SnapshotChunk)
    assert answer(author.stream, author.log, msg.Want("r", author.stream.revision), snapshots) == []


def test_a_gap_in_the_log_clears_it() -> None:
    log = RecordLog()
    log.append(msg.Revision(1, 0, 0), b"a")
    log.append(msg.Revision(1, 5, 0), b"b")
    assert log.since(msg.Revision(1, 0, 0)) is None
    assert log.since(msg.Revision(1, 5, 0)) == [b"b"]


def test_a_change_that_starts_nothing_is_refused() -> None:
    stream = Stream("r", 1)
    change = msg.Change({}, (msg.SubmapChange("s", None, b"\x00" * 7),))
    with pytest.raises(WireError, match="submap s is unknown"):
        advance(stream, change, seq=1, link=2, digest=0, limits=Limits())


def test_a_snapshot_is_the_change_from_nothing() -> None:
    stream = Stream("r", 1, 4, facts(set_start(FixedPose())), {"0": room(7)}, 9)
    change, _ = change_between(Stream("r", 1), stream)
    step = advance(Stream("r", 1), change, seq=4, link=9, digest=stream.digest, limits=Limits())
    assert step.after.revision == stream.revision
    assert step.after.state == stream.state


def test_what_no_peer_would_read_is_refused_here() -> None:
    author = engine("me")
    author.take_outputs()
    odd = VectorMap(Lattice(50_000), room(5).edges, room(5).thickness, 2000.0)
    with pytest.raises(ConfigError, match="map"):
        author.publish("0", odd)
    with pytest.raises(ConfigError, match="submap"):
        author.publish("a/b", room(5))
    with pytest.raises(ConfigError, match="pose"):
        author.set_pose(1e9, 0.0, 0.0)
    with pytest.raises(ConfigError, match="goal"):
        author.set_goal((float("nan"), 0.0))
    assert author.take_outputs() == []


def test_a_whole_number_as_error_bound_and_any_yaw_are_understood() -> None:
    author = engine("r")
    author.publish("0", VectorMap(Lattice(50_000), room(5).edges, room(5).thickness, 1))
    author.set_pose(1.0, 2.0, 7.0)
    author.tick(0.0)
    me = listener(author)
    assert held(me, author).digest == author.own.digest
    mate = me.teammates.by_name["r"]
    assert (mate.life, mate.pose) == (author.own.life, (1000, 2000, 717))


def test_forgetting_an_unknown_robot_is_an_error() -> None:
    with pytest.raises(ConfigError, match="robot='ghost': no map of that robot is held"):
        engine("me").forget("ghost")
    with pytest.raises(ConfigError, match="no former life of this robot is held"):
        engine("me").forget("me")


def test_every_refusal_is_counted_by_robot_and_kind() -> None:
    me = listener(engine("r"))
    tell(me, ("r", LINK), b"junk")
    tell(me, ("r", LINK), env.encode(msg.Heartbeat(1, 1)), kind="pose")
    tell(me, ("a b", 1), b"", kind="pose")
    assert {robot for robot, _ in dropped(me)} == {"r", "a b"}
    assert sum(dropped(me).values()) == 3


def test_a_token_alone_is_nobody() -> None:
    """Anybody can show one: who has never spoken is no peer, and not waited for longer than two questions last."""
    me = engine("me")
    me.receive(Alive("ghost", 7), now_s=0.0)
    assert me.neighbours.robots() == set()
    assert me.lacking() == ["the list of ghost"]
    for k in range(1, 4):
        for ask in asks(me, "revisions"):
            me.receive(ReplyEnd(ask.ask_id), now_s=5.0 * k)
        me.tick(5.0 * k + 2.0)
    assert me.lacking() == []


_AUTHOR = engine("r")
for _size in range(5, 9):
    _AUTHOR.publish("0", room(_size))
_GENUINE = [
    *records(_AUTHOR),
    *snapshot_messages(_AUTHOR.own),
    env.encode(msg.Heartbeat(9, 9)),
    env.encode(msg.RevisionList((("me", msg.Revision(1, 5, 5)), ("q", msg.Revision(2, 2, 2))))),
    env.encode(msg.Want("r", msg.Revision(LINK, 0, 0))),
    env.encode(msg.Heartbeat(9, 9, 9, (1, 1, 1), (1, 1))),
    env.encode(msg.Ranges((msg.Range(0, 2**64 - 1, 7), msg.Range(3, 9, rows=())))),
    env.encode(msg.Living((("q", 2),))),
    env.encode(msg.Relay("r", LINK)),
]
_KINDS = st.sampled_from(["delta", "digest", "other"])
_ASKED = st.sampled_from(["snapshot", "revisions", "mirror", "relay", "x"])


@settings(max_examples=100)
@given(st.data())
def test_whatever_the_network_says_the_engine_goes_on(data: st.DataObject) -> None:
    me = engine("me", start=FixedPose())
    meet(me, _AUTHOR)
    answers: list[Sequence[bytes]] = []
    now_s = 0.0
    for _ in range(data.draw(st.integers(1, 8))):
        payload = bytearray(
            data.draw(st.sampled_from(_GENUINE)) if data.draw(st.booleans()) else data.draw(st.binary())
        )
        if payload and data.draw(st.booleans()):
            payload[data.draw(st.integers(0, len(payload) - 1))] = data.draw(st.integers(0, 255))
        robot = data.draw(st.sampled_from(["r", "q", "me", "", "*", "é"]))
        its_life = data.draw(st.sampled_from([LINK, me.own.life, 0, 2**64 - 1]))
        match data.draw(st.integers(0, 6)):
            case 0:
                me.receive(Query(data.draw(_ASKED), bytes(payload), answers.append), now_s=now_s)
            case 1:
                me.receive(Reply(data.draw(st.integers(0, 4)), bytes(payload)), now_s=now_s)
            case 2:
                me.receive(ReplyEnd(data.draw(st.integers(0, 4))), now_s=now_s)
            case 3:
                me.receive(Alive(robot, its_life), now_s=now_s)
            case 4:
                me.receive(Gone(robot, its_life), now_s=now_s)
            case _:
                me.receive(Message(robot, its_life, data.draw(_KINDS), bytes(payload)), now_s=now_s)
        now_s += data.draw(st.sampled_from([0.0, 0.2, 4.0]))
        me.tick(now_s)
        me.take_outputs()
    assert me.own.submaps == {}
    for replica in me.holdings.replicas.values():
        # Nobody can be brought to hold a revision that no author has come to.
        assert replica.key == _AUTHOR.own.key
        assert replica.stream.seq <= _AUTHOR.own.seq
