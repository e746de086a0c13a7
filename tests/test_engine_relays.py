"""Two peers without a link of their own hear each other by way of a third one."""

from __future__ import annotations

import numpy as np
import pytest
from exchange import Fleet, Node, asks, deliver, engine, held, meet, query, reply, rooms

from fleetmap.codecs import envelope
from fleetmap.codecs.messages import Living, Relay
from fleetmap.engine import RELAY_S, Answer, PeersChanged, Query
from fleetmap.engine.relays import MAX_BY_ONE, MAX_LISTENERS_EACH, Relaying
from fleetmap.engine.stream import Key
from fleetmap.peer.memory_link import arrives

STEP_S = 0.02


def seconds_until_held(fleet: Fleet, author: Node, listener: Node, *, most_s: float = 30.0) -> float:
    """From a publish to where it is held."""
    began_s = fleet.clock.now_s
    while held(listener.engine, author.engine).revision != author.engine.own.revision:
        fleet.run(STEP_S)
        assert fleet.clock.now_s < began_s + most_s
    return fleet.clock.now_s - began_s


def seen(node: Node) -> set[str]:
    return node.engine.living() - {node.engine.robot}


def test_an_update_reaches_whoever_has_no_link_to_its_author_at_once() -> None:
    fleet = Fleet("abc")
    fleet.run(3.0)
    fleet.hub.cut("a", "c")
    a, c = fleet.nodes["a"], fleet.nodes["c"]
    fleet.run(1.0)
    delays = []
    # For longer than an answer stays open.
    for k in range(1, 41):
        for author, listener in ((a, c), (c, a)):
            author.publish(rooms(k))
            delays.append(seconds_until_held(fleet, author, listener))
        fleet.run(0.06 * RELAY_S)
    assert max(delays) <= 0.1
    assert seen(a) == {"b", "c"}
    assert seen(c) == {"a", "b"}
    assert PeersChanged("a", True, "b") in c.events


def test_two_that_never_had_a_link_hear_each_other() -> None:
    fleet = Fleet("ab")
    fleet.hub.cut("a", "c")
    fleet.add("c")
    fleet.run(12.0)
    a, c = fleet.nodes["a"], fleet.nodes["c"]
    assert (seen(a), seen(c)) == ({"b", "c"}, {"a", "b"})
    a.publish(rooms(3))
    assert seconds_until_held(fleet, a, c) <= 0.1


def test_poses_go_by_way_of_others_too() -> None:
    fleet = Fleet("abc")
    fleet.run(1.0)
    fleet.hub.cut("a", "c")
    fleet.run(1.0)
    fleet.nodes["a"].engine.set_pose(1.0, 2.0, 0.5)
    fleet.run(1.0)
    assert fleet.nodes["c"].engine.teammates.by_name["a"].pose == (1000, 2000, 500)


def test_when_the_third_one_goes_a_fourth_one_takes_its_place() -> None:
    fleet = Fleet("abcd")
    fleet.run(1.0)
    fleet.hub.cut("a", "c")
    fleet.run(2.0)
    a, c = fleet.nodes["a"], fleet.nodes["c"]
    (way,) = c.engine.listening.ways.values()
    fleet.kill(way.via[0])
    fleet.run(2.0)
    assert seen(c) == set("abd") - {way.via[0]}
    a.publish(rooms(3))
    assert seconds_until_held(fleet, a, c) <= 0.1


def test_a_robot_that_ends_is_heard_by_nobody_any_more() -> None:
    fleet = Fleet("abc")
    fleet.run(1.0)
    fleet.hub.cut("a", "c")
    fleet.run(2.0)
    fleet.kill("a")
    fleet.run(1.0)
    assert all(seen(node) == {"b", "c"} - {name} for name, node in fleet.nodes.items())
    assert PeersChanged("a", False) in fleet.nodes["c"].events[-2:]


def test_who_is_seen_again_needs_no_third_one() -> None:
    fleet = Fleet("abc")
    fleet.run(1.0)
    fleet.hub.cut("a", "c")
    fleet.run(2.0)
    assert fleet.nodes["c"].engine.listening.ways
    fleet.hub.heal("a", "c")
    fleet.run(2.0)
    a, c = fleet.nodes["a"], fleet.nodes["c"]
    assert not c.engine.listening.ways
    a.publish(rooms(2))
    assert seconds_until_held(fleet, a, c) <= STEP_S
    fleet.run(RELAY_S)
    fleet.assert_equal()


@pytest.mark.parametrize("seed", range(5))
def test_with_a_third_of_all_pairs_without_a_link_all_see_all_and_hold_the_same(seed: int) -> None:
    rng = np.random.default_rng(seed)
    fleet, names = Fleet(), [f"r{i}" for i in range(12)]
    # Each pair has at least one neighbour in common.
    for i, a in enumerate(names):
        for b in names[i + 1 :]:
            if "r0" not in (a, b) and rng.random() < 1 / 3:
                fleet.hub.cut(a, b)
    for name in names:
        fleet.add(name)
        fleet.run(0.2)
    fleet.run(15.0)
    for name, node in fleet.nodes.items():
        assert seen(node) == set(names) - {name}
    fleet.nodes["r5"].publish(rooms(9))
    fleet.run(1.0)
    fleet.assert_equal()


def test_a_few_that_come_and_go_cost_few_questions() -> None:
    fleet = Fleet([f"r{i}" for i in range(20)], fate=arrives)
    fleet.run(30.0)
    before = {name: node.engine.ledger.stats().sent["want"].messages for name, node in fleet.nodes.items()}
    fleet.kill("r3")
    fleet.run(30.0)
    for name, node in fleet.nodes.items():
        assert node.engine.ledger.stats().sent["want"].messages <= before[name] + 3


class Silent(Relaying):
    """Takes questions, and says nothing."""

    def hand_on(self, key: Key, payload: bytes, now_s: float) -> int:
        return 0


def test_a_neighbour_that_hands_nothing_on_gives_way_to_another_one() -> None:
    fleet = Fleet("abcd")
    fleet.run(1.0)
    fleet.hub.cut("a", "c")
    liar = fleet.nodes["b"]
    # It says that it sees a, and is silent about it.
    liar.engine._relaying = Silent(liar.engine._outputs)
    for node in fleet.nodes.values():
        for neighbour in node.engine.neighbours.by_key.values():
            neighbour.said = b""
    fleet.run(60.0)
    assert seen(fleet.nodes["c"]) == {"a", "b", "d"}


def test_who_invents_whom_it_sees_leaves_room_for_others() -> None:
    fleet = Fleet("abc")
    fleet.run(1.0)
    c, b = fleet.nodes["c"].engine, fleet.nodes["b"].engine
    c.listening.told(b.own.key, [(f"ghost{i}", i) for i in range(200)], fleet.clock.now_s)
    assert len(c.listening.ways) == MAX_BY_ONE


def test_one_life_is_handed_on_to_so_many_and_no_more() -> None:
    fleet = Fleet("ab")
    fleet.run(1.0)
    b, a = fleet.nodes["b"].engine, fleet.nodes["a"].engine.own.key
    payload = envelope.encode(Relay(*a))
    for _ in range(MAX_LISTENERS_EACH + 5):
        b.receive(Query("relay", payload, lambda payloads, last=True: None), now_s=fleet.clock.now_s)
    ended = [output for output in b.take_outputs() if isinstance(output, Answer) and output.last]
    assert len(ended) == 5
    fleet.nodes["a"].publish(rooms(2))
    fleet.run(0.1)
    assert b.ledger.stats().sent["relay"].messages == MAX_LISTENERS_EACH


def test_a_robot_is_not_told_that_its_former_process_lives() -> None:
    """Its neighbour may not have noticed yet that it ended."""
    me, other = engine("a", run=2), engine("b")
    meet(me, other)
    me.tick(0.0)
    (ask,) = asks(me, "revisions")
    reply(me, ask, envelope.encode(Living((engine("a").own.key, ("z", 5)))))
    assert me.listening.ways.keys() == {("z", 5)}


def test_a_lost_part_of_an_answer_is_asked_for_again() -> None:
    """A heartbeat came, and the list behind it was lost."""
    me, other = engine("me"), engine("other")
    meet(me, other)
    other.set_pose(1.0, 0.0, 0.0)
    third = engine("third")
    deliver(third, other)
    me.tick(0.0)
    (ask,) = asks(me, "revisions")
    beat, *_ = query(other, "revisions", ask.payload)
    reply(me, ask, beat, now_s=0.1)
    assert "the list of other" in me.lacking()
    again = [ask for k in range(20) for ask in (me.tick(0.2 + 0.1 * k), asks(me, "revisions"))[1]]
    assert again
    reply(me, again[0], *query(other, "revisions", again[0].payload), now_s=3.0)
    assert "the list of other" not in me.lacking()
