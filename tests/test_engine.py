"""The engine alone: bytes in, bytes out, and nothing that comes from the network raises."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetmap.codecs import envelope as env
from fleetmap.codecs import messages as msg
from fleetmap.engine import Ask, Changed, Engine, Put
from fleetmap.engine.author import Author
from fleetmap.engine.log import MAX_LOG_RECORDS, RecordLog, answer, snapshot_messages
from fleetmap.engine.replica import Outcome, Replica
from fleetmap.engine.stream import Stream, Submap, advance, change_between
from fleetmap.engine.view import view
from fleetmap.model.errors import ConfigError, WireError
from fleetmap.model.lattice import Lattice
from fleetmap.model.pose import FixedPose, Pose2
from fleetmap.model.vectormap import VectorMap


def room(size: int, *, resolution_um: int = 50_000) -> VectorMap:
    corners = [(0, 0), (0, size), (size, size), (size, 0)]
    rows = [(*a, *b, 1) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
    return VectorMap(Lattice(resolution_um), np.array(rows, np.int32), np.full(4, 4, np.uint8))


def records(engine: Engine) -> list[bytes]:
    return [o.payload for o in engine.take_outputs() if isinstance(o, Put) and o.suffix == "delta"]


def told(*messages: tuple[str, str, bytes]) -> Engine:
    engine = Engine("me", start=FixedPose())
    engine.on_alive("r", 1, "x", now_s=0.0)
    for robot, suffix, payload in messages:
        engine.on_message(robot, suffix, payload, now_s=0.0)
    return engine


def test_the_digest_tells_robot_epoch_frame_and_content_apart() -> None:
    base = Stream("a", 1, 1, msg.Header(), {"0": Submap(room(5), FixedPose())})
    moved = FixedPose.from_pose(Pose2(0.0, 0.0, 0.1))
    others = [
        Stream("b", 1, 1, base.header, base.submaps),
        Stream("a", 2, 1, base.header, base.submaps),
        Stream("a", 1, 1, msg.Header("1"), base.submaps),
        Stream("a", 1, 1, msg.Header(start=FixedPose()), base.submaps),
        Stream("a", 1, 1, msg.Header(forgets=(("c", 1),)), base.submaps),
        Stream("a", 1, 1, base.header, {"1": base.submaps["0"]}),
        Stream("a", 1, 1, base.header, {"0": Submap(room(5), moved)}),
        Stream("a", 1, 1, base.header, {"0": Submap(room(6), FixedPose())}),
    ]
    assert len({s.digest for s in [base, *others]}) == 9
    assert Stream("a", 1, 9, base.header, dict(base.submaps)).digest == base.digest


def test_a_moved_anchor_resends_no_geometry() -> None:
    engine = Engine("a")
    engine.publish("0", room(100))
    engine.take_outputs()
    assert engine.publish("0", room(100), anchor=FixedPose.from_pose(Pose2(1.0, 2.0, 0.3)))
    (record,) = records(engine)
    message = env.decode(record, robot="a")
    assert isinstance(message, msg.Record)
    assert message.change.submaps[0].payload is None
    assert len(record) < 60


def test_an_equal_map_sends_nothing() -> None:
    engine = Engine("a")
    engine.publish("0", room(100))
    engine.take_outputs()
    assert not engine.publish("0", room(100))
    assert engine.take_outputs() == []
    assert engine.own.seq == 2


def test_a_map_of_another_resolution_starts_the_submap_anew() -> None:
    author, replica = Engine("r"), told()
    for size, um in ((10, 50_000), (12, 20_000)):
        author.publish("0", room(size, resolution_um=um))
    for record in records(author):
        replica.on_message("r", "delta", record, now_s=0.0)
    held = replica.holdings.replicas["r", 1].stream
    assert held.digest == author.own.digest
    assert held.submaps["0"].vector_map.lattice.resolution_um == 20_000


def test_changes_name_the_frame_the_box_and_the_counts() -> None:
    author, replica = Engine("r"), told()
    author.publish("s", room(20), anchor=FixedPose.from_pose(Pose2(10.0, 0.0, 0.0)))
    for record in records(author):
        replica.on_message("r", "delta", record, now_s=0.0)
    change = [o for o in replica.take_outputs() if isinstance(o, Changed)][-1]
    assert change.frame == ("r", 1, "s")
    assert change.box_m == pytest.approx((10.0, 0.0, 11.0, 1.0))
    assert (change.edges_added, change.edges_removed) == (4, 0)
    assert change.revision == author.own.revision


def test_the_view_places_frames_by_start_and_anchor() -> None:
    start, anchor = FixedPose.from_pose(Pose2(1.0, 2.0, 0.5)), FixedPose.from_pose(Pose2(0.1, 0.2, 0.3))
    author, replica = Engine("r", start=start), told()
    author.publish("0", room(10), anchor=anchor)
    replica.publish("0", room(9))
    for record in records(author):
        replica.on_message("r", "delta", record, now_s=0.0)
    sources = {s.frame: s.T_fleet_frame for s in view(replica).sources}
    assert sources == {("me", 1, "0"): FixedPose(), ("r", 1, "0"): start @ anchor}
    replica.set_start(None)
    assert [s.frame for s in view(replica).sources] == [("me", 1, "0")]


def test_another_level_is_held_but_not_viewed() -> None:
    author, replica = Engine("r", start=FixedPose(), level="1"), told()
    author.publish("0", room(10))
    for record in records(author):
        replica.on_message("r", "delta", record, now_s=0.0)
    assert ("r", 1) in replica.holdings.replicas
    assert [robot for robot, _ in view(replica).revisions] == ["me"]


def test_a_record_with_a_wrong_digest_changes_nothing_and_asks_for_everything() -> None:
    author = Engine("r")
    author.publish("0", room(10))
    first, second = records(author)
    message = env.decode(second, robot="r")
    assert isinstance(message, msg.Record)
    forged = msg.Record(1, 2, message.check ^ 1, message.change)
    engine = told(("r", "delta", first), ("r", "delta", env.encode(forged)))
    replica = engine.holdings.replicas["r", 1]
    assert replica.stream.seq == 1
    asked = [o for o in engine.take_outputs() if isinstance(o, Ask) and o.suffix == "snapshot"]
    want = env.decode(asked[-1].payload, robot="r")
    assert want == msg.Want(msg.Revision(1, 0, 0))
    for reply in author.on_query("snapshot", asked[-1].payload):
        engine.on_reply(asked[-1].ask_id, reply, now_s=0.1)
    assert replica.stream.digest == author.own.digest
    assert not replica.suspect


def test_records_that_come_early_wait_for_the_one_before() -> None:
    author = Engine("r")
    for size in range(5, 10):
        author.publish("0", room(size))
    sent = records(author)
    engine = told(*(("r", "delta", record) for record in [sent[0], *sent[:1:-1]]))
    assert engine.holdings.replicas["r", 1].stream.seq == 1
    engine.on_message("r", "delta", sent[1], now_s=0.0)
    assert engine.holdings.replicas["r", 1].stream.digest == author.own.digest


def test_a_large_snapshot_comes_in_chunks_in_any_order() -> None:
    rng = np.random.default_rng(0)
    ends = rng.integers(-(2**20), 2**20, (30_000, 4))
    edges = np.column_stack([ends, np.ones(len(ends), np.int64)]).astype(np.int32)
    big = VectorMap(Lattice(50_000), edges, rng.integers(0, 256, len(edges)).astype(np.uint8))
    stream = Stream("r", 1, 2, msg.Header(), {"0": Submap(big, FixedPose())})
    chunks = [env.decode(raw, robot="r") for raw in snapshot_messages(stream)]
    assert len(chunks) > 1
    replica = Replica(Stream("r", 1))
    outcomes = [replica.offer_chunk(c) for c in chunks[::-1] if isinstance(c, msg.SnapshotChunk)]
    assert outcomes == [Outcome.EARLY] * (len(chunks) - 1) + [Outcome.APPLIED]
    assert replica.stream.digest == stream.digest


def test_the_log_is_bounded_and_falls_back_to_a_snapshot() -> None:
    author = Author(Stream("r", 1))
    author.commit(header=msg.Header("1"))
    first = author.stream.revision
    for size in range(2, MAX_LOG_RECORDS + 5):
        author.commit(submaps={"0": Submap(room(size), FixedPose())})
    assert author.log.since(first) is None
    (message,) = [env.decode(raw, robot="r") for raw in answer(author.stream, author.log, first)]
    assert isinstance(message, msg.SnapshotChunk)
    assert answer(author.stream, author.log, author.stream.revision) == []


def test_a_gap_in_the_log_clears_it() -> None:
    log = RecordLog()
    log.append(msg.Revision(1, 0, 0), b"a")
    log.append(msg.Revision(1, 5, 0), b"b")
    assert log.since(msg.Revision(1, 0, 0)) is None
    assert log.since(msg.Revision(1, 5, 0)) == [b"b"]


def test_a_change_that_starts_nothing_is_refused() -> None:
    stream = Stream("r", 1)
    for part in (
        msg.SubmapChange("0", FixedPose(), None, b"\x00"),
        msg.SubmapChange("0", None, msg.MapHeader(Lattice(50_000)), b"\x00" * 7),
    ):
        with pytest.raises(WireError, match="submap 0"):
            advance(stream, msg.Change(None, (part,)), seq=1, digest=0)


def test_a_snapshot_is_the_change_from_nothing() -> None:
    stream = Stream("r", 1, 4, msg.Header(start=FixedPose()), {"0": Submap(room(7), FixedPose())})
    change = change_between(Stream("r", 1), stream)
    assert advance(Stream("r", 1), change, seq=stream.seq, digest=stream.digest).revision == stream.revision


def test_what_no_peer_would_read_is_refused_here() -> None:
    engine = Engine("me")
    engine.take_outputs()
    odd = VectorMap(Lattice(50_000), room(5).edges, room(5).thickness, 2000.0)
    with pytest.raises(ConfigError, match="map"):
        engine.publish("0", odd)
    with pytest.raises(ConfigError, match="submap"):
        engine.publish("a/b", room(5))
    with pytest.raises(ConfigError, match="pose"):
        engine.set_pose(1e9, 0.0, 0.0)
    with pytest.raises(ConfigError, match="goal"):
        engine.set_goal((float("nan"), 0.0))
    assert engine.take_outputs() == []


def test_a_whole_number_as_error_bound_and_any_yaw_are_understood() -> None:
    author, replica = Engine("r"), told()
    author.publish("0", VectorMap(Lattice(50_000), room(5).edges, room(5).thickness, 1))
    author.set_pose(1.0, 2.0, 7.0)
    for output in author.take_outputs():
        if isinstance(output, Put):
            replica.on_message("r", output.suffix, output.payload, now_s=0.0)
    assert replica.holdings.replicas["r", 1].stream.digest == author.own.digest
    mate = replica.teammates.by_name["r"]
    assert mate.pose == msg.PoseMessage(1, 1000, 2000, 717)


def test_forgetting_an_unknown_robot_is_an_error() -> None:
    with pytest.raises(ConfigError, match="ghost"):
        Engine("me").forget("ghost")


def test_every_refusal_is_counted_by_robot_and_kind() -> None:
    engine = told(("r", "delta", b"junk"), ("r", "pose", env.encode(msg.Heartbeat(1, 1, 1))), ("a b", "pose", b""))
    dropped = engine.ledger.stats().dropped
    assert {robot for robot, _ in dropped} == {"r", "a b"}
    assert sum(c.messages for c in dropped.values()) == 3


_AUTHOR = Engine("r")
for _size in range(5, 9):
    _AUTHOR.publish("0", room(_size))
_GENUINE = [
    *records(_AUTHOR),
    *snapshot_messages(_AUTHOR.own),
    env.encode(msg.Heartbeat(1, 9, 9)),
    env.encode(msg.RevisionList((("me", msg.Revision(1, 5, 5)), ("q", msg.Revision(2, 2, 2))))),
    env.encode(msg.Want(msg.Revision(1, 0, 0))),
    env.encode(msg.PoseMessage(1, 1, 1, 1)),
]


@settings(max_examples=100)
@given(st.data())
def test_whatever_the_network_says_the_engine_goes_on(data: st.DataObject) -> None:
    engine = told()
    now_s = 0.0
    for _ in range(data.draw(st.integers(1, 8))):
        payload = bytearray(
            data.draw(st.sampled_from(_GENUINE)) if data.draw(st.booleans()) else data.draw(st.binary())
        )
        if payload and data.draw(st.booleans()):
            payload[data.draw(st.integers(0, len(payload) - 1))] = data.draw(st.integers(0, 255))
        robot = data.draw(st.sampled_from(["r", "q", "me", "", "*", "é"]))
        match data.draw(st.integers(0, 5)):
            case 0:
                engine.on_query(data.draw(st.sampled_from(["snapshot", "revisions", "mirror/r", "x"])), bytes(payload))
            case 1:
                engine.on_reply(data.draw(st.integers(0, 4)), bytes(payload), now_s=now_s)
            case 2:
                engine.on_reply_end(data.draw(st.integers(0, 4)), now_s=now_s)
            case 3:
                engine.on_alive(robot, data.draw(st.integers(0, 9)), "i", now_s=now_s)
            case _:
                suffix = data.draw(st.sampled_from(["delta", "digest", "pose", "goal", "other"]))
                engine.on_message(robot, suffix, bytes(payload), now_s=now_s)
        now_s += data.draw(st.sampled_from([0.0, 0.2, 4.0]))
        engine.tick(now_s)
        engine.take_outputs()
    assert engine.own.submaps == {}
    for replica in engine.holdings.replicas.values():
        assert replica.stream.seq <= _AUTHOR.own.seq or replica.stream.robot != "r"
