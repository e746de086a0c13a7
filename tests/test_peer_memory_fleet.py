"""Fleets over the memory link: engines and links without an event loop, under scripted loss and a fake clock."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetmap.engine import Ask, Changed, Engine, EpochChanged, NameTaken, PeersChanged, Put
from fleetmap.engine.view import view
from fleetmap.model.lattice import Lattice
from fleetmap.model.pose import FixedPose
from fleetmap.model.vectormap import VectorMap
from fleetmap.peer.link import Token
from fleetmap.peer.memory_link import FakeClock, MemoryHub, arrives

LATTICE = Lattice(50_000)
TICK_S = 0.1


def room(size: int, *, thickness: int = 4) -> VectorMap:
    """A square of free space with its lower left corner at the origin, walls on three sides."""
    corners = [(0, 0), (0, size), (size, size), (size, 0)]
    rows = [(*a, *b, 1 + (i == 0)) for i, (a, b) in enumerate(zip(corners, corners[1:] + corners[:1], strict=True))]
    edges = np.array(rows, np.int32)
    return VectorMap(LATTICE, edges, np.where(edges[:, 4] == 2, 0, thickness).astype(np.uint8))


class Node:
    """An engine on a memory link: what ``Peer`` does, in one thread and at the fake clock's time."""

    def __init__(self, hub: MemoryHub, clock: FakeClock, robot: str, *, epoch: int = 1, instance: str = "a") -> None:
        self.clock, self.link = clock, hub.link(robot)
        self.engine = Engine(robot, epoch=epoch, instance=instance, start=FixedPose())
        self.events: list[Changed | EpochChanged | NameTaken | PeersChanged] = []
        self.open = True
        self.link.connect(self)
        self.link.show(Token(robot, epoch, instance))
        self.carry_out()
        clock.call_later(TICK_S, self.tick)

    def tick(self) -> None:
        if self.open:
            self.engine.tick(self.clock.now_s)
            self.carry_out()
            self.clock.call_later(TICK_S, self.tick)

    def publish(self, vector_map: VectorMap, submap: str = "0") -> None:
        self.engine.publish(submap, vector_map)
        self.carry_out()

    def kill(self) -> None:
        self.open = False
        self.link.vanish()

    def message(self, robot: str, suffix: str, payload: bytes) -> None:
        self.engine.on_message(robot, suffix, payload, now_s=self.clock.now_s)
        self.carry_out()

    def alive(self, token: Token) -> None:
        self.engine.on_alive(token.robot, token.epoch, token.instance, now_s=self.clock.now_s)
        self.carry_out()

    def gone(self, token: Token) -> None:
        self.engine.on_gone(token.robot, token.epoch, token.instance)
        self.carry_out()

    def query(self, suffix: str, payload: bytes, reply: Callable[[Sequence[bytes]], None]) -> None:
        reply(self.engine.on_query(suffix, payload))

    def carry_out(self) -> None:
        for output in self.engine.take_outputs():
            match output:
                case Put(suffix, payload):
                    self.link.put(suffix, payload)
                case Ask():
                    self._ask(output)
                case EpochChanged(epoch):
                    self.link.show(Token(self.link.robot, epoch, self.engine.instance))
                case event:
                    self.events.append(event)

    def _ask(self, ask: Ask) -> None:
        def replied(payload: bytes) -> None:
            self.engine.on_reply(ask.ask_id, payload, now_s=self.clock.now_s)
            self.carry_out()

        def ended() -> None:
            self.engine.on_reply_end(ask.ask_id, now_s=self.clock.now_s)
            self.carry_out()

        self.link.ask(ask.robot, ask.suffix, ask.payload, on_reply=replied, on_end=ended)

    def holds(self) -> dict[tuple[str, int], tuple[int, int]]:
        return {(s.robot, s.epoch): (s.seq, s.digest) for s in self.engine.holdings.streams()}


class Fleet:
    def __init__(self, names: str = "", fate: Callable[[str, str, str], Sequence[float]] = arrives) -> None:
        self.clock = FakeClock()
        self.hub = MemoryHub(self.clock, fate=fate)
        self.nodes = {name: self.add(name) for name in names}

    def add(self, robot: str, **kw: object) -> Node:
        return Node(self.hub, self.clock, robot, **kw)  # type: ignore[arg-type]

    def run(self, seconds: float) -> None:
        self.clock.advance(seconds)

    def assert_equal(self, *nodes: Node) -> None:
        first, *others = nodes or tuple(self.nodes.values())
        for other in others:
            assert other.holds() == first.holds()
            assert view(other.engine).revisions == view(first.engine).revisions
        assert not first.engine.lacking()


def test_a_record_reaches_every_peer() -> None:
    fleet = Fleet("abc")
    fleet.nodes["a"].publish(room(10))
    fleet.run(0.1)
    fleet.assert_equal()
    stream = fleet.nodes["b"].engine.holdings.replicas["a", 1].stream
    assert stream.submaps["0"].vector_map.digest == room(10).digest


def test_a_late_joiner_gets_all_streams_also_of_an_absent_robot() -> None:
    fleet = Fleet("abc")
    for size, node in enumerate(fleet.nodes.values(), 10):
        node.publish(room(size))
        node.publish(room(size + 5))
    fleet.run(1.0)
    fleet.nodes.pop("c").kill()
    late = fleet.nodes["d"] = fleet.add("d")
    fleet.run(1.0)
    fleet.assert_equal()
    assert late.holds()["c", 1][0] == 3
    assert "c" not in late.engine.alive


def test_a_lost_record_is_repaired_with_records_not_a_snapshot() -> None:
    lost = {"n": 0}

    def fate(sender: str, receiver: str, suffix: str) -> Sequence[float]:
        if suffix == "delta" and sender == "a":
            lost["n"] += 1
            return () if lost["n"] in (3, 4) else (0.0,)
        return (0.0,)

    fleet = Fleet("ab", fate)
    fleet.run(0.1)
    before = fleet.nodes["a"].engine.own.revision
    for size in range(10, 18):
        fleet.nodes["a"].publish(room(size))
        fleet.run(0.3)
    fleet.run(1.0)
    fleet.assert_equal()
    assert lost["n"] == 8
    # A snapshot would have cleared the log.
    records = fleet.nodes["b"].engine.holdings.replicas["a", 1].log.since(before)
    assert records is not None
    assert len(records) == 8


def test_the_last_record_lost_is_noticed_by_the_heartbeat() -> None:
    drop = {"delta": False}
    fleet = Fleet("ab", lambda s, r, suffix: () if suffix == "delta" and drop["delta"] else (0.0,))
    fleet.run(0.2)
    drop["delta"] = True
    fleet.nodes["a"].publish(room(10))
    fleet.run(3.0)
    fleet.assert_equal()


def test_a_killed_robot_stays_in_the_map_and_is_absent() -> None:
    fleet = Fleet("ab")
    fleet.nodes["a"].publish(room(10))
    fleet.run(0.1)
    fleet.nodes["a"].kill()
    fleet.run(0.1)
    b = fleet.nodes["b"]
    assert PeersChanged("a", False) in b.events
    assert ("a", 1, "0") in {s.frame for s in view(b.engine).sources}


def test_a_restarted_robot_adds_a_stream_and_keeps_the_map_of_its_earlier_life() -> None:
    fleet = Fleet("abc")
    fleet.nodes["a"].publish(room(10))
    fleet.run(0.5)
    fleet.nodes["a"].kill()
    again = fleet.nodes["a"] = fleet.add("a", epoch=2, instance="b")
    again.publish(room(7))
    fleet.run(2.0)
    fleet.assert_equal()
    assert {("a", 1), ("a", 2)} <= set(again.holds())


def test_only_four_earlier_epochs_are_kept() -> None:
    fleet = Fleet("b")
    for epoch in range(1, 8):
        node = fleet.add("a", epoch=epoch, instance=str(epoch))
        node.publish(room(10 + epoch))
        fleet.run(1.5)
        node.kill()
        fleet.run(0.1)
    assert [e for name, e in fleet.nodes["b"].holds() if name == "a"] == [3, 4, 5, 6, 7]


def test_a_robot_that_forgot_its_epoch_goes_on_under_a_higher_one() -> None:
    fleet = Fleet("ab")
    fleet.nodes["a"].publish(room(10))
    fleet.nodes["a"].publish(room(11))
    fleet.run(0.5)
    fleet.nodes["a"].kill()
    fleet.run(0.1)
    again = fleet.nodes["a"] = fleet.add("a", epoch=1, instance="b")
    again.publish(room(20))
    fleet.run(5.0)
    fleet.assert_equal()
    assert again.engine.own.epoch == 2
    assert again.engine.own.submaps["0"].vector_map.digest == room(20).digest
    assert again.link.token == Token("a", 2, "b")


def test_of_two_living_peers_of_one_name_the_later_one_learns_of_it() -> None:
    fleet = Fleet("a")
    later = fleet.add("a", epoch=2, instance="b")
    fleet.run(0.1)
    assert NameTaken() in later.events
    assert NameTaken() not in fleet.nodes["a"].events


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
    assert "a" not in fleet.nodes["b"].engine.alive


def test_a_forgotten_robot_is_dropped_everywhere_and_not_repaired() -> None:
    fleet = Fleet("abc")
    fleet.nodes["c"].publish(room(10))
    fleet.run(0.5)
    fleet.nodes.pop("c").kill()
    fleet.run(0.1)
    fleet.nodes["a"].engine.forget("c")
    fleet.nodes["a"].carry_out()
    fleet.run(5.0)
    fleet.nodes["d"] = fleet.add("d")
    fleet.run(5.0)
    fleet.assert_equal()
    assert all(name != "c" for name, _ in fleet.nodes["b"].holds())


def test_a_living_robot_that_is_forgotten_comes_back() -> None:
    fleet = Fleet("ab")
    fleet.nodes["b"].publish(room(10))
    fleet.run(0.5)
    fleet.nodes["a"].engine.forget("b")
    fleet.nodes["a"].carry_out()
    fleet.run(3.0)
    fleet.assert_equal()
    assert fleet.nodes["a"].holds()["b", 2][0] >= 1


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
def test_any_schedule_of_loss_delay_and_duplication_converges(data: st.DataObject) -> None:
    lossy = {"on": True}
    delays = st.lists(st.sampled_from([0.0, 0.0, 0.05, 0.4, 1.2]), max_size=2)

    def fate(sender: str, receiver: str, suffix: str) -> Sequence[float]:
        return data.draw(delays) if lossy["on"] else (0.0,)

    fleet = Fleet("abc", fate)
    for _ in range(data.draw(st.integers(1, 8))):
        name = data.draw(st.sampled_from("abc"))
        action = data.draw(st.sampled_from(["publish", "publish", "publish", "cut", "heal", "restart"]))
        other = data.draw(st.sampled_from([n for n in "abc" if n != name]))
        if action == "publish":
            fleet.nodes[name].publish(room(data.draw(st.integers(2, 40))), data.draw(st.sampled_from("01")))
        elif action == "restart":
            epoch = fleet.nodes[name].engine.own.epoch
            fleet.nodes[name].kill()
            fleet.nodes[name] = fleet.add(name, epoch=epoch + data.draw(st.integers(0, 1)), instance=str(fleet.clock()))
        else:
            getattr(fleet.hub, action)(name, other)
        fleet.run(data.draw(st.sampled_from([0.0, 0.1, 0.7])))
    lossy["on"] = False
    for a, b in ("ab", "ac", "bc"):
        fleet.hub.heal(a, b)
    fleet.run(30.0)
    fleet.assert_equal()


@pytest.mark.parametrize("suffix", ["delta", "digest", "pose", "goal", "other"])
def test_a_namesake_is_never_listened_to(suffix: str) -> None:
    fleet = Fleet("a")
    before = fleet.nodes["a"].holds()
    fleet.nodes["a"].message("a", suffix, b"\x91\x01")
    assert fleet.nodes["a"].holds() == before
    assert fleet.nodes["a"].engine.ledger.stats().dropped["a", f"{suffix}/namesake"].messages == 1
