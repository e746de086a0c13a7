"""What a hostile robot may send costs others neither their merged map nor their memory."""

import numpy as np
import pytest
from exchange import asks, commit, deliver, engine, held, life, meet, query, reply, room, tell

from fleetmap.codecs import envelope
from fleetmap.codecs.facts import forget, set_anchor, supersede
from fleetmap.codecs.messages import Change, Heartbeat, Record, Revision, RevisionList, SubmapChange
from fleetmap.engine import Alive, MapChanged
from fleetmap.engine.catchup import (
    MAX_STRANGERS_LISTING,
    MAX_STRANGERS_UNDER_WAY,
    MAX_UNDER_WAY,
    MAX_UNDER_WAY_EACH,
)
from fleetmap.engine.holdings import SPARED_S
from fleetmap.engine.neighbours import MAX_NEIGHBOURS
from fleetmap.engine.view import view
from fleetmap.model.errors import ConfigError
from fleetmap.model.lattice import Lattice
from fleetmap.model.pose import MAX_UM, FixedPose
from fleetmap.model.vectormap import VectorMap

SQUARE = np.array([[0, 0, 0, 5, 1], [0, 5, 5, 5, 1], [0, 0, 5, 0, 3], [5, 0, 5, 5, 3]], np.int32)


def test_a_start_and_an_anchor_too_far_together_leave_that_submap_out() -> None:
    me, bad = engine("me", start=FixedPose()), engine("bad", start=FixedPose(MAX_UM, 0))
    square = VectorMap(Lattice(50_000), SQUARE, np.zeros(4, np.uint8))
    with pytest.raises(ConfigError, match="together"):
        bad.publish("far", square, anchor=FixedPose(MAX_UM, 0))
    # Another program may say it all the same.
    anchors = {**set_anchor("far", FixedPose(MAX_UM, 0)), **set_anchor("near", FixedPose(-MAX_UM, 0))}
    commit(bad, facts=anchors, submaps={"far": square, "near": square})
    deliver(bad, me)
    assert [source.frame for source in view(me).sources] == [("bad", life("bad"), "near")]
    ((frame, reason),) = view(me).left_out
    assert (frame, "together" in reason) == (("bad", life("bad"), "far"), True)


def test_lives_that_are_invented_leave_room_for_others() -> None:
    me, good = engine("me"), engine("good")
    for its_life in range(1, 1100):
        tell(me, ("bad", its_life), envelope.encode(Record(2, 5, 5, Change({}, ()))))
    deliver(good, me)
    assert held(me, good).revision == good.own.revision
    assert len(me.holdings.replicas) == 1


def test_streams_that_a_peer_lists_no_more_are_forgotten() -> None:
    """Also what came of asking for them."""
    me, bad = engine("me"), engine("bad")
    meet(me, bad)
    now_s = 0.0
    for turn in range(1, 7):
        me.ask_lists(now_s=now_s)
        for _ in range(20):
            now_s += 0.2
            me.tick(now_s)
            for ask in asks(me):
                rows = tuple((f"ghost{turn}-{i}", Revision(1, 1, 1)) for i in range(20))
                answers = [envelope.encode(RevisionList(rows))] if ask.kind == "revisions" else []
                reply(me, ask, *answers, now_s=now_s)
    assert {key for n in me.neighbours.by_key.values() for key, r in n.rows.items() if r.seq} == {
        (f"ghost6-{i}", 1) for i in range(20)
    }
    assert len(me._asking.catchup._due_s) == 20
    # But for the questions that were under way when the list came.
    assert sum(map(len, me._asking.catchup._pairs.values())) <= 20 + MAX_UNDER_WAY_EACH


def test_who_lists_what_it_does_not_hold_keeps_nobody_else_waiting() -> None:
    me, bad, good = engine("me"), engine("bad"), engine("good")
    meet(me, bad, good)
    me.tick(0.1)
    rows = tuple((f"ghost-{i:04}", Revision(1, 1, 1)) for i in range(4000))
    for ask in asks(me, "revisions"):
        if ask.robot == "bad":
            reply(me, ask, envelope.encode(RevisionList(rows)), now_s=0.1)
    me.tick(0.5)
    tell(me, good, envelope.encode(Heartbeat(1, 0)), kind="digest", now_s=0.6)
    now_s = 0.6
    while held(me, good).seq == 0 and now_s < 60.0:
        for ask in asks(me, "snapshot"):
            reply(me, ask, *query(good, ask.kind, ask.payload), now_s=now_s)
        now_s += 0.1
        me.tick(now_s)
    assert held(me, good).revision == good.own.revision
    assert now_s < 10.0


def test_nobody_can_leave_a_robot_that_lives_out_of_the_map() -> None:
    me, victim, bad = (engine(name, start=FixedPose()) for name in ("me", "v", "bad"))
    meet(me, victim, bad)
    victim.publish("0", room(5))
    deliver(victim, me, bad)
    deliver(me, victim, bad)
    twin = engine("v", run=2, start=FixedPose())
    meet(me, twin)
    twin.publish("0", room(3))
    # Twice a second, for much longer than anybody is spared: all that it has said by then.
    for now_s in np.arange(0.0, 3 * SPARED_S, 0.5):
        for ahead in (1, 0):
            commit(bad, facts=forget({s.key: (s.seq + ahead, s.link) for s in (me.own, victim.own)}))
            deliver(bad, me, victim, now_s=now_s)
        commit(twin, facts=supersede({victim.own.life: victim.own.state}))
        deliver(twin, me, victim, now_s=now_s)
        for one in (me, victim):
            one.tick(now_s)
            assert victim.own.key in {source.frame[:2] for source in view(one).sources}
        deliver(victim, me, now_s=now_s)
        deliver(me, victim, now_s=now_s)
    assert victim.own.seq > 2 * SPARED_S


def test_who_is_there_and_says_nothing_to_being_forgotten_is_left_out_after_a_while() -> None:
    me, silent, operator = (engine(name, start=FixedPose()) for name in ("me", "s", "o"))
    meet(me, silent, operator)
    silent.publish("0", room(5))
    deliver(silent, me, operator)
    me.tick(1.0)
    commit(operator, facts=forget({silent.own.key: silent.own.state}))
    deliver(operator, me, now_s=1.0)
    me.take_outputs()
    for now_s, there in ((1.1, True), (0.9 + SPARED_S, True), (1.1 + SPARED_S, False)):
        me.tick(now_s)
        assert (silent.own.key in {source.frame[:2] for source in view(me).sources}) == there
    assert any(isinstance(output, MapChanged) for output in me.take_outputs())


def test_a_revision_that_the_author_has_not_come_to_is_not_waited_for_long() -> None:
    me, author, bad = (engine(name) for name in ("me", "r", "bad"))
    meet(me, author, bad)
    deliver(author, me)
    forged = envelope.encode(Record(2, 12345, 7, Change({}, ())))
    rows = {"r": (("r", author.own.revision),), "bad": (("r", Revision(author.own.life, 999, 7)),)}
    now_s, waited_for = 0.0, set()
    while now_s < 1.0 or me.lacking():
        now_s += 0.1
        assert now_s < 10.0
        me.tick(now_s)
        for ask in asks(me):
            reply(
                me,
                ask,
                envelope.encode(RevisionList(rows[ask.robot])) if ask.kind == "revisions" else forged,
                now_s=now_s,
            )
        waited_for.update(me.lacking())
    assert f"r life {author.own.life:016x}" in waited_for
    assert held(me, author).revision == author.own.revision


def test_who_speaks_as_another_does_not_use_up_that_ones_budget() -> None:
    me, author = engine("me"), engine("r")
    meet(me, author)
    author.publish("0", room(5))
    deliver(author, me)
    word, junk = author.own, Change({}, (SubmapChange("0", None, bytes(4_000_000)),))
    for later, link in ((0, word.link), (1, word.link), (1, 12345)) * 4:
        tell(me, word.key, envelope.encode(Record(word.seq + later, link, 5, junk)))
    author.publish("0", room(7))
    deliver(author, me)
    assert held(me, author).revision == author.own.revision


def test_who_came_before_a_thousand_tokens_of_nobody_is_there_when_it_speaks() -> None:
    me, good = engine("me"), engine("good")
    good.publish("0", room(5))
    deliver(good)  # nobody hears it
    meet(me, good)
    for i in range(1, 1000):
        me.receive(Alive(f"nobody{i}", i), now_s=0.0)
    assert good.own.key not in me.neighbours
    good.tick(0.0)
    deliver(good, me)
    assert good.own.key in me.neighbours
    for i in range(1000, 2000):
        me.receive(Alive(f"nobody{i}", i), now_s=0.0)
    for now_s in np.arange(0.0, 3.0, 0.1):
        me.tick(now_s)
        for ask in asks(me):
            if ask.robot == "good":
                reply(me, ask, *query(good, ask.kind, ask.payload), now_s=now_s)
    assert held(me, good).revision == good.own.revision


def test_who_only_says_records_gives_its_seat_to_who_comes() -> None:
    """A thousand tokens that each say one record leave no seat to a robot that comes after them, otherwise."""
    me, good = engine("me"), engine("good")
    first = engine("first")
    meet(me, first)
    first.tick(0.0)
    deliver(first, me)
    for i in range(1, MAX_NEIGHBOURS + 10):
        me.receive(Alive(f"r{i}", i), now_s=0.0)
        tell(me, (f"r{i}", i), envelope.encode(Record(1, 5, 5, Change({}, ()))))
    assert len(me.neighbours.by_key) == MAX_NEIGHBOURS
    meet(me, good)
    assert good.own.key in me.neighbours
    # Who acts as a peer does keeps its seat.
    assert first.own.key in me.neighbours


def test_questions_about_streams_of_strangers_leave_room_for_those_of_peers() -> None:
    me, good = engine("me"), engine("good")
    now_s = 0.0
    for i in range(100):
        me.receive(Alive(f"s{i}", i + 1), now_s=now_s)
        tell(me, (f"s{i}", i + 1), envelope.encode(Record(2, 5, 5, Change({}, ()))))
    asked = []
    for now_s in np.arange(0.0, 1.0, 0.1):
        me.tick(now_s)
        asked += asks(me)
    assert len(asked) <= MAX_STRANGERS_LISTING + MAX_STRANGERS_UNDER_WAY < MAX_UNDER_WAY
    good.publish("0", room(5))
    deliver(good)  # nobody hears it
    meet(me, good)
    good.tick(now_s)
    deliver(good, me, now_s=now_s)
    while held(me, good).revision != good.own.revision:
        now_s += 0.1
        assert now_s < 1.4
        me.tick(now_s)
        for ask in asks(me):
            if ask.robot == "good":
                reply(me, ask, *query(good, ask.kind, ask.payload), now_s=now_s)
