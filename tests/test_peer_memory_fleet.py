"""Fleets over the memory link: engines and links without an event loop, under scripted loss and a fake clock."""

from __future__ import annotations

import random
from collections.abc import Sequence

import pytest
from exchange import Fleet, Node, life, room, rooms
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetmap.codecs import envelope
from fleetmap.codecs.messages import Heartbeat
from fleetmap.engine import LifeChanged, Message, PeersChanged
from fleetmap.peer.health import problems


def digest_of(node: Node, robot: str, run: int = 1) -> int:
    """The digest of the one submap that a node holds of a robot's run."""
    (stream,) = [s for s in node.engine.holdings.streams() if s.key == (robot, life(robot, run))]
    return stream.submaps["0"].digest


def test_a_record_reaches_every_peer() -> None:
    fleet = Fleet("abc")
    fleet.nodes["a"].publish(room(10))
    fleet.run(0.1)
    fleet.assert_equal()
    assert digest_of(fleet.nodes["b"], "a") == room(10).digest


def test_a_late_joiner_gets_all_streams_also_of_an_absent_robot() -> None:
    fleet = Fleet("abc")
    for size, node in enumerate(fleet.nodes.values(), 10):
        node.publish(room(size))
        node.publish(room(size + 5))
    fleet.run(1.0)
    fleet.kill("c")
    late = fleet.add("d")
    fleet.run(1.0)
    fleet.assert_equal()
    assert late.holds()["c", life("c")][0] == 3
    assert late.engine.neighbours.robots() == {"a", "b"}


def test_a_lost_record_is_repaired_with_records_not_a_snapshot() -> None:
    lost = {"n": 0}

    def fate(sender: str, receiver: str, kind: str) -> Sequence[float]:
        if kind == "delta" and sender == "a":
            lost["n"] += 1
            return () if lost["n"] in (3, 4) else (0.0,)
        return (0.0,)

    fleet = Fleet("ab", fate)
    fleet.run(0.1)
    before = fleet.nodes["a"].engine.own.revision
    lost["n"] = 0
    for size in range(10, 18):
        fleet.nodes["a"].publish(room(size))
        fleet.run(0.3)
    fleet.run(1.0)
    fleet.assert_equal()
    assert lost["n"] == 8
    # A snapshot would have cleared the log.
    records = fleet.nodes["b"].engine.holdings.replicas["a", life("a")].log.since(before)
    assert records is not None
    assert len(records) == 8


def test_the_last_record_lost_is_noticed_by_the_heartbeat() -> None:
    drop = {"delta": False}
    fleet = Fleet("ab", lambda s, r, kind: () if kind == "delta" and drop["delta"] else (0.0,))
    fleet.run(0.2)
    drop["delta"] = True
    fleet.nodes["a"].publish(room(10))
    fleet.run(3.0)
    fleet.assert_equal()


def test_a_killed_robot_stays_in_the_map_and_is_absent() -> None:
    fleet = Fleet("ab")
    fleet.nodes["a"].publish(room(10))
    fleet.run(0.1)
    fleet.kill("a")
    fleet.run(0.1)
    b = fleet.nodes["b"]
    assert PeersChanged("a", False) in b.events
    assert ("a", life("a")) in b.merges()


def test_a_reboot_loses_nothing() -> None:
    """The new life is merged beside the former ones, which nobody asks the robot for."""
    fleet = Fleet("abc")
    fleet.nodes["a"].publish(room(10))
    fleet.run(0.5)
    again = fleet.restart("a")
    again.publish(room(7))
    fleet.run(2.0)
    fleet.assert_equal()
    assert again.merges() == {("a", life("a", 1)), ("a", life("a", 2))}
    assert (digest_of(again, "a", 1), digest_of(again, "a", 2)) == (room(10).digest, room(7).digest)
    assert again.engine.own.names == {life("a", 1)}


def test_a_reboot_out_of_reach_loses_nothing() -> None:
    fleet = Fleet("ab")
    fleet.nodes["a"].publish(room(10))
    fleet.run(0.5)
    fleet.hub.cut("a", "b")
    for size in (11, 12, 13):
        fleet.restart("a").publish(room(size))
        fleet.run(3.0)
    fleet.hub.heal("a", "b")
    fleet.run(5.0)
    fleet.assert_equal()
    # What nobody else has heard is gone with the process: lives 2 and 3.
    assert fleet.nodes["b"].merges() == {("a", life("a", 1)), ("a", life("a", 4))}


def test_of_the_lives_that_are_named_the_four_with_the_most_edges_stay() -> None:
    fleet = Fleet("b")
    for run, count in enumerate((3, 7, 1, 6, 2, 5, 4), 1):
        if run > 1:
            fleet.kill("a")
        fleet.add("a", run=run).publish(rooms(count))
        fleet.run(1.5)
    fleet.run(5.0)
    fleet.assert_equal()
    kept = {life("a", run) for run in (1, 2, 4, 6, 7)}
    assert fleet.nodes["b"].lives_of("a") == kept
    late = fleet.add("c")
    fleet.run(5.0)
    fleet.assert_equal()
    assert late.lives_of("a") == kept


def test_of_lives_that_two_peers_have_met_apart_the_same_ones_stay() -> None:
    fleet = Fleet("bc")
    fleet.hub.cut("b", "c")
    for run in range(1, 9):
        if run > 1:
            fleet.kill("a")
        fleet.add("a", run=run).publish(rooms(9 - run))
        # The odd lives are met by b alone, the even ones by c.
        fleet.hub.cut("a", "bc"[run % 2])
        fleet.hub.heal("a", "cb"[run % 2])
        fleet.run(2.0)
    fleet.hub.heal("b", "c")
    fleet.hub.heal("a", "b")
    fleet.hub.heal("a", "c")
    fleet.run(8.0)
    fleet.assert_equal()
    assert fleet.nodes["b"].lives_of("a") == {life("a", run) for run in (1, 2, 3, 4, 8)}


def test_a_process_that_is_put_back_goes_on_behind_what_it_has_said() -> None:
    """As from an image of a machine: the life is the same one, and its memory older than what others hold."""
    fleet = Fleet("ab")
    fleet.nodes["a"].publish(room(10))
    fleet.nodes["a"].publish(room(11))
    fleet.run(0.5)
    said = fleet.nodes["a"].engine.own.seq
    fleet.kill("a")
    fleet.run(0.1)
    again = fleet.add("a", run=1)
    again.publish(room(20))
    fleet.run(5.0)
    fleet.assert_equal()
    assert again.engine.own.key == ("a", life("a", 1))
    assert again.engine.own.seq > said
    assert digest_of(fleet.nodes["b"], "a") == room(20).digest


def test_a_life_that_has_said_all_goes_on_in_another_one_which_replaces_it() -> None:
    fleet = Fleet("b")
    a = fleet.add("a", revisions=8)
    for size in range(10, 30):
        a.publish(room(size))
        fleet.run(0.3)
    fleet.run(3.0)
    fleet.assert_equal()
    assert sum(isinstance(event, LifeChanged) for event in a.events) >= 2
    assert a.link.token == a.engine.own.key
    assert fleet.nodes["b"].lives_of("a") == {a.engine.own.life}
    assert fleet.nodes["b"].engine.neighbours.robots() == {"a"}


def test_of_two_living_peers_of_one_name_neither_gives_way_and_both_say_so() -> None:
    fleet = Fleet("ab")
    first = fleet.nodes["a"]
    first.publish(room(10))
    fleet.run(1.0)
    second = fleet.add("a")
    second.publish(room(7))
    fleet.run(5.0)
    for size in (11, 12):
        first.publish(room(size))
        second.publish(room(size + 10))
        fleet.run(1.0)
    b = fleet.nodes["b"]
    fleet.assert_equal(first, second, b)
    assert b.merges() == {("a", life("a", 1)), ("a", life("a", 2))}
    assert (digest_of(b, "a", 1), digest_of(b, "a", 2)) == (room(12).digest, room(22).digest)
    for node, other in ((first, 2), (second, 1)):
        assert PeersChanged("a", True) in node.events
        (problem,) = problems(node.engine, (), ())
        assert problem.kind == "namesake"
        assert f"{life('a', other):016x}" in problem.text
    assert problems(b.engine, (), ()) == ()
    second.kill()
    fleet.run(0.2)
    assert problems(first.engine, (), ()) == ()


def test_a_namesake_that_lives_is_never_superseded() -> None:
    fleet = Fleet("ab")
    first = fleet.nodes["a"]
    first.publish(room(10))
    second = fleet.add("a")
    fleet.run(2.0)
    second.publish(room(7), supersedes=True)
    fleet.run(2.0)
    fleet.assert_equal(first, second, fleet.nodes["b"])
    assert fleet.nodes["b"].lives_of("a") == {life("a", 1), life("a", 2)}


def test_a_cut_is_repaired_after_it_heals() -> None:
    fleet = Fleet("abc")
    fleet.run(0.5)
    fleet.hub.cut("a", "b")
    fleet.hub.cut("a", "c")
    fleet.nodes["a"].publish(room(10))
    fleet.nodes["b"].publish(room(12))
    fleet.run(3.0)
    assert fleet.nodes["a"].holds() != fleet.nodes["b"].holds()
    fleet.hub.heal("a", "b")
    fleet.hub.heal("a", "c")
    fleet.run(3.0)
    fleet.assert_equal()


def test_two_robots_that_are_cut_from_each_other_meet_through_a_third() -> None:
    fleet = Fleet("abc")
    fleet.run(0.5)
    fleet.hub.cut("a", "b")
    fleet.nodes["a"].publish(room(10))
    fleet.run(6.0)
    fleet.assert_equal()
    assert "a" not in fleet.nodes["b"].engine.neighbours.robots()


def absent_c() -> Fleet:
    """a and b live, and hold the map of c, which has ended."""
    fleet = Fleet("abc")
    fleet.nodes["c"].publish(room(10))
    fleet.run(0.5)
    fleet.kill("c")
    fleet.run(0.1)
    return fleet


C = ("c", life("c"))


def test_a_robot_that_is_forgotten_here_is_merged_elsewhere_and_held_by_all() -> None:
    fleet = absent_c()
    a, b = fleet.nodes["a"], fleet.nodes["b"]
    a.forget("c")
    fleet.run(5.0)
    assert (C in a.merges(), C in b.merges()) == (False, True)
    assert a.holds() == b.holds()
    assert C in a.holds()
    late = fleet.add("d")
    fleet.run(5.0)
    assert C in late.merges()


def test_a_robot_that_is_forgotten_everywhere_is_merged_nowhere_also_by_late_joiners() -> None:
    fleet = absent_c()
    fleet.nodes["a"].forget("c", everywhere=True)
    fleet.run(5.0)
    fleet.kill("a")
    late = fleet.add("d")
    fleet.run(5.0)
    fleet.assert_equal()
    for node in (fleet.nodes["b"], late):
        assert C in node.holds()
        assert C not in node.merges()


def test_who_forgets_the_robot_that_forgot_has_it_back() -> None:
    fleet = absent_c()
    a, b = fleet.nodes["a"], fleet.nodes["b"]
    a.forget("c", everywhere=True)
    fleet.run(1.0)
    assert C not in b.merges()
    b.forget("a")
    assert C in b.merges()
    assert C not in a.merges()


def test_a_forgotten_robot_that_starts_anew_is_merged() -> None:
    fleet = absent_c()
    fleet.nodes["a"].forget("c", everywhere=True)
    fleet.run(1.0)
    fleet.add("c").publish(room(8))
    fleet.run(5.0)
    fleet.assert_equal()
    assert {key for key in fleet.nodes["b"].merges() if key[0] == "c"} == {("c", life("c", 2))}


def test_a_living_robot_that_one_peer_forgets_comes_back_with_its_next_word() -> None:
    fleet = Fleet("ab")
    a, b = fleet.nodes["a"], fleet.nodes["b"]
    b.publish(room(10))
    fleet.run(0.5)
    a.forget("b")
    assert a.merges() == set()
    fleet.run(3.0)  # the robot isn't told
    assert a.merges() == set()
    b.publish(room(11))
    fleet.run(3.0)
    fleet.assert_equal()
    assert a.merges() == {("b", life("b"))}


@pytest.mark.parametrize("by", ["forget", "publish"])
def test_the_own_former_lives_end_at_every_peer_when_their_robot_says_so(by: str) -> None:
    fleet = Fleet("abc")
    for size in (10, 11, 12):
        fleet.nodes["a"].publish(room(size))
        fleet.run(2.0)
        fleet.restart("a")
    again = fleet.nodes["a"]
    again.publish(room(7))
    fleet.run(3.0)
    fleet.kill("c")
    assert len(fleet.nodes["b"].lives_of("a")) == 4
    if by == "forget":
        again.forget("a")
    else:
        again.publish(room(8), supersedes=True)
    fleet.run(3.0)
    # Whoever was away and still holds them takes them no more for current.
    away = fleet.add("c")
    fleet.run(5.0)
    fleet.assert_equal()
    for node in (again, fleet.nodes["b"], away):
        assert node.lives_of("a") == {life("a", 4)}


def test_who_was_away_with_a_life_that_has_ended_brings_nobody_back() -> None:
    fleet = Fleet("abc")
    fleet.nodes["a"].publish(room(10))
    fleet.run(1.0)
    fleet.hub.cut("a", "c")
    fleet.hub.cut("b", "c")
    again = fleet.restart("a")
    again.publish(room(7))
    fleet.run(3.0)
    again.forget("a")
    fleet.run(3.0)
    fleet.hub.heal("a", "c")
    fleet.hub.heal("b", "c")
    fleet.run(8.0)
    fleet.assert_equal()
    assert fleet.nodes["c"].lives_of("a") == {life("a", 2)}


def test_a_fleet_that_is_in_step_asks_nothing() -> None:
    fleet = Fleet("abc")
    for node in fleet.nodes.values():
        node.publish(room(10))
    fleet.run(3.0)
    asked = [n.engine.ledger.stats().sent["want"].messages for n in fleet.nodes.values()]
    fleet.run(20.0)
    assert [n.engine.ledger.stats().sent["want"].messages for n in fleet.nodes.values()] == asked


@settings(max_examples=40)
@given(st.data())
def test_any_schedule_of_loss_delay_duplication_and_reboots_converges(data: st.DataObject) -> None:
    lossy = {"on": True}
    delays = st.lists(st.sampled_from([0.0, 0.0, 0.05, 0.4, 1.2]), max_size=2)

    def fate(sender: str, receiver: str, kind: str) -> Sequence[float]:
        return data.draw(delays) if lossy["on"] else (0.0,)

    fleet = Fleet("abc", fate)
    for _ in range(data.draw(st.integers(1, 8))):
        name = data.draw(st.sampled_from("abc"))
        actions = ["publish", "publish", "publish", "cut", "heal", "restart", "put back", "end former"]
        action = data.draw(st.sampled_from(actions))
        other = data.draw(st.sampled_from([n for n in "abc" if n != name]))
        size = data.draw(st.integers(2, 40))
        match action:
            case "publish":
                fleet.nodes[name].publish(room(size), data.draw(st.sampled_from("01")))
            case "end former":
                fleet.nodes[name].publish(room(size), supersedes=True)
            case "restart":
                fleet.restart(name)
            case "put back":
                run = data.draw(st.integers(1, fleet.runs[name]))
                fleet.kill(name)
                fleet.add(name, run=run)
            case _:
                getattr(fleet.hub, action)(name, other)
        fleet.run(data.draw(st.sampled_from([0.0, 0.1, 0.7])))
    lossy["on"] = False
    for a, b in ("ab", "ac", "bc"):
        fleet.hub.heal(a, b)
    fleet.run(30.0)
    fleet.assert_equal()


@pytest.mark.parametrize("seed", [*range(9), 46])
def test_a_fleet_whose_robots_reboot_again_and_again_converges(seed: int) -> None:
    """Lives of few and of many edges, more of them than are kept, told in any order and only in part."""
    rng, lossy = random.Random(seed), {"on": True}

    def fate(sender: str, receiver: str, kind: str) -> Sequence[float]:
        if not lossy["on"]:
            return (0.0,)
        return [rng.choice([0.0, 0.0, 0.05, 0.4, 1.2]) for _ in range(rng.choice([0, 1, 1, 1, 2]))]

    fleet = Fleet("abc", fate)
    for _ in range(rng.randint(8, 24)):
        name = rng.choice("abc")
        other = rng.choice([n for n in "abc" if n != name])
        match rng.choice([*["publish"] * 4, *["restart"] * 4, "cut", "heal", "heal", "end former"]):
            case "publish":
                fleet.nodes[name].publish(rooms(rng.randint(1, 9)))
            case "end former":
                fleet.nodes[name].publish(rooms(rng.randint(1, 9)), supersedes=True)
            case "restart":
                fleet.restart(name, revisions=256)
            case action:
                getattr(fleet.hub, action)(name, other)
        fleet.run(rng.choice([0.0, 0.1, 0.7, 2.0]))
    lossy["on"] = False
    for a, b in ("ab", "ac", "bc"):
        fleet.hub.heal(a, b)
    fleet.run(20.0)
    fleet.assert_equal()


@pytest.mark.parametrize("kind", ["delta", "digest", "pose", "goal", "other"])
def test_who_speaks_in_the_own_name_is_never_listened_to(kind: str) -> None:
    fleet = Fleet("a")
    before = fleet.nodes["a"].holds()
    fleet.nodes["a"].deliver(Message("a", life("a"), kind, envelope.encode(Heartbeat(9, 9))))
    assert fleet.nodes["a"].holds() == before
    assert fleet.nodes["a"].engine.ledger.stats().dropped["a", f"{kind}/claimed: the own life"].messages == 1
