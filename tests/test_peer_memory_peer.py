"""``Peer`` and its sync facade over the memory link: the shell around the engine."""

from __future__ import annotations

import asyncio
import logging
import time
from functools import partial

import numpy as np
import pytest

import fleetmap
import fleetmap.sync
from fleetmap.accounting import Ledger
from fleetmap.codecs import baselines
from fleetmap.engine import Alive, Engine, Message, Query
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN
from fleetmap.model.pose import Pose2
from fleetmap.peer import inbox as inbox_module
from fleetmap.peer.inbox import Inbox
from fleetmap.peer.memory_link import LoopClock, MemoryHub
from fleetmap.peer.profiles import zenoh_settings


def grid(width: int = 60, *, resolution_m: float = 0.05) -> OccupancyGrid:
    states = np.full((50, width), UNKNOWN, np.uint8)
    states[8:40, 8:-8] = OCCUPIED
    states[10:38, 10:-10] = FREE
    return OccupancyGrid.from_states(states, resolution_m)


async def test_a_grid_is_vectorized_shared_and_counted() -> None:
    hub = MemoryHub(LoopClock())
    async with (
        fleetmap.join("a", start=Pose2(), link=hub.link("a")) as a,
        fleetmap.join("b", start=Pose2(), link=hub.link("b")) as b,
    ):
        assert await a.publish(grid())
        assert not await a.publish(grid())
        assert await a.publish(grid(64))
        merged = await b.synced(20.0, at_least=1)
        assert merged.digest == (await a.synced(20.0)).digest
        assert len(merged) >= 4
        stats = a.stats()
        assert stats.baselines["grid_gzip_full"] > stats.baselines["grid_gzip_updates"] > 0
        assert 0 < stats.bytes_deltas < stats.baselines["grid_gzip_full"]
        assert len(stats.series) == 3
        assert b.plan((0.7, 0.7), (1.8, 1.5), radius_m=0.1).length_m == pytest.approx(1.36, abs=0.05)


async def test_a_baseline_that_fails_is_counted_as_missing_and_fails_no_publish(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(*_: object) -> int:
        raise ValueError("expected at most 7 cells")

    monkeypatch.setattr(baselines, "exact_changed_rectangle", fail)
    async with fleetmap.join("a", start=Pose2(), link=MemoryHub(LoopClock()).link("a")) as a:
        with caplog.at_level(logging.WARNING):
            assert await a.publish(grid())
            assert await a.publish(grid(64))
        stats = a.stats()
    assert stats.baselines_missing == {"grid_exact_updates": 2}
    assert stats.to_json()["baselines_missing"] == {"grid_exact_updates": 2}
    assert sorted(stats.baselines) == ["grid_gzip_full", "grid_gzip_updates"]
    assert len(stats.series) == 2
    told = [record.getMessage() for record in caplog.records if "baseline" in record.getMessage()]
    assert told == ["a: baseline grid_exact_updates is not counted: expected at most 7 cells"]


@pytest.mark.parametrize("counted", [True, False])
async def test_baselines_are_counted_or_not_in_both_faces(counted: bool) -> None:
    hub = MemoryHub(LoopClock())

    def work() -> dict[str, int]:
        with fleetmap.sync.join("s", start=Pose2(), baselines=counted, link=hub.link("s")) as peer:
            peer.publish(grid())
            return dict(peer.stats().baselines)

    async with fleetmap.join("a", start=Pose2(), baselines=counted, link=hub.link("a")) as a:
        await a.publish(grid())
        assert (a.stats().baselines != {}) == counted
        assert ((await asyncio.to_thread(work)) != {}) == counted


async def test_another_resolution_starts_the_submap_anew() -> None:
    hub = MemoryHub(LoopClock())
    async with fleetmap.join("a", start=Pose2(), link=hub.link("a")) as a:
        await a.publish(grid())
        await a.publish(grid(resolution_m=0.1))
        assert (await a.refresh()).resolution_um == 100_000


async def test_a_name_is_taken_if_a_living_peer_answers_and_not_by_a_token_alone() -> None:
    hub = MemoryHub(LoopClock())
    ghost = hub.link("b")
    ghost.display(5)  # nobody is behind it
    async with fleetmap.join("a", start=Pose2(), link=hub.link("a")) as a:
        with pytest.raises(fleetmap.NameInUse, match="a living peer is already called 'a'"):
            await fleetmap.join("a", start=Pose2(), link=hub.link("a"))
        async with fleetmap.join("b", start=Pose2(), link=hub.link("b")) as b:
            assert await b.publish(grid())
            await a.synced(20.0, at_least=1)
        # Whoever runs is never put out.
        assert await a.publish(grid())


async def test_who_joins_beside_a_namesake_is_another_life_and_both_say_so() -> None:
    hub = MemoryHub(LoopClock())
    join = partial(fleetmap.join, "a", start=Pose2(), heartbeat_s=0.05)
    async with join(link=hub.link("a")) as first:
        await first.publish(grid())
        async with join(link=hub.link("a"), if_taken="join") as second:
            await second.publish(grid(70))
            merged = await second.synced(20.0)
            async with asyncio.timeout(20.0), first.stepped:
                await first.stepped.wait_for(lambda: bool(first.health()))
            assert (await first.synced(20.0)).digest == merged.digest
            assert {life for (_, revision) in first.revisions for life in [revision.life]} == {first.life, second.life}
            assert [(p.kind, p.robot) for p in first.health()] == [("namesake", "a")]
            assert "give each robot a name of its own" in first.health()[0].text.lower()
        async with asyncio.timeout(20.0), first.stepped:
            await first.stepped.wait_for(lambda: not first.health())


async def test_a_robot_that_starts_anew_has_its_former_map_until_it_says_otherwise() -> None:
    hub = MemoryHub(LoopClock())
    async with fleetmap.join("b", start=Pose2(), link=hub.link("b")) as b:
        async with fleetmap.join("a", start=Pose2(), link=hub.link("a")) as a:
            await a.publish(grid())
            former = a.life
            await b.synced(20.0, at_least=1)
        async with fleetmap.join("a", start=Pose2(), link=hub.link("a")) as a:
            assert a.life != former
            before = await a.synced(20.0, at_least=1)
            assert len(before) >= 4
            await a.publish(grid(70))
            await b.synced(20.0, at_least=1)
            (info,) = b.peers
            assert (info.life, info.lives) == (a.life, 2)
            assert b.maps["a"]["0"].digest == a._engine.own.submaps["0"].digest
            await a.forget("a")
            await b.synced(20.0, at_least=1)
            assert b.peers[0].lives == 1
            assert (await a.refresh()).digest == (await b.refresh()).digest
            with pytest.raises(fleetmap.ConfigError, match="no former life"):
                await a.forget("a")


@pytest.mark.parametrize("everywhere", [False, True])
async def test_a_robot_that_is_forgotten_is_out_of_the_merged_map(everywhere: bool) -> None:
    hub = MemoryHub(LoopClock())
    join = partial(fleetmap.join, start=Pose2())
    async with join("b", link=hub.link("b")) as b, join("c", link=hub.link("c")) as c:
        async with join("a", link=hub.link("a")) as a:
            await a.publish(grid())
            await b.synced(20.0, at_least=2)
        await b.forget("a", everywhere=everywhere)
        assert len(await b.refresh()) == 0
        assert (len(await c.synced(20.0, at_least=1)) == 0) == everywhere
        with pytest.raises(fleetmap.ConfigError, match="no map of that robot"):
            await b.forget("ghost")


async def test_a_peer_opens_once() -> None:
    hub = MemoryHub(LoopClock())
    peer = await fleetmap.join("a", link=hub.link("a"))
    await peer.close()
    with pytest.raises(fleetmap.LinkError, match="once"):
        await peer
    never_opened = fleetmap.join("a", link=hub.link("a"))
    await never_opened.close()
    with pytest.raises(fleetmap.LinkError, match="closed"):
        await never_opened.set_pose(Pose2())


async def test_what_comes_in_while_a_peer_closes_is_no_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    """The last words take their time in the engine's thread; a message of another robot meets them there."""
    hub = MemoryHub(LoopClock())
    async with fleetmap.join("b", start=Pose2(), link=hub.link("b")) as b:
        a = await fleetmap.join("a", start=Pose2(), link=hub.link("a"))
        await a.publish(grid())
        send_waiting = Engine.send_waiting

        def slowly(self: Engine, now_s: float) -> None:
            time.sleep(0.3)
            send_waiting(self, now_s)

        monkeypatch.setattr(Engine, "send_waiting", slowly)
        closing = asyncio.ensure_future(a.close())
        await asyncio.sleep(0)
        for width in range(61, 66):
            await b.publish(grid(width))
            await asyncio.sleep(0.02)
        await closing
        assert [change async for change in a.changes()] == []
        with pytest.raises(fleetmap.LinkError, match="the peer is closed"):
            await a.publish(grid())


async def test_the_sync_facade_does_the_same() -> None:
    hub = MemoryHub(LoopClock())

    def work() -> None:
        with fleetmap.sync.join("s", start=Pose2(), link=hub.link("s")) as peer:
            peer.publish(grid())
            peer.set_pose(Pose2(1.0, 1.0, 0.0))
            peer.set_goal((2.0, 1.0))
            merged = peer.synced(20.0, at_least=1)
            assert merged.digest == peer.merged.digest == peer.refresh().digest
            assert [p.robot for p in peer.peers] == ["a"]
            assert 0 < peer.life < 2**64
            assert peer.health() == ()
            assert peer.T_fleet_robot == Pose2()
            assert peer.teammates() == []
            assert peer.stats().bytes_vector > 0
            assert all(change.revisions for change in peer.changes(timeout_s=0.01))
            assert peer.plan((0.7, 0.7), (1.8, 1.5), radius_m=0.1).length_m > 1.0
        with pytest.raises(fleetmap.LinkError, match="closed"):
            peer.publish(grid())
        peer.close()

    async with fleetmap.join("a", start=Pose2(), link=hub.link("a")) as a:
        await asyncio.to_thread(work)
        assert [(p.robot, p.edges > 0) for p in a.peers] == [("s", True)]


async def test_a_full_inbox_drops_samples_counts_them_and_keeps_tokens(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inbox_module, "MAX_ITEMS", 3)
    ledger = Ledger()
    inbox = Inbox(asyncio.get_running_loop(), ledger, lambda: b"")
    answered: list[list[bytes]] = []
    for _ in range(5):
        inbox.deliver(Message("r", 1, "delta", b"xx"))
    inbox.deliver(Query("snapshot", b"", lambda replies: answered.append(list(replies))))
    inbox.deliver(Alive("r", 1))
    items = await inbox.take(1.0)
    assert len(items) == 4
    assert answered == [[]]
    assert ledger.stats().dropped["r", "delta/queue_full"].messages == 2
    assert await inbox.take(0.0) == []
    inbox.deliver(Query("snapshot", b"", lambda replies: answered.append(list(replies))))
    inbox.close()
    inbox.deliver(Message("r", 1, "delta", b"xx"))
    assert answered == [[], []]


def test_settings_of_a_profile_can_be_overridden() -> None:
    settings = zenoh_settings("local", listen=[], connect=["tcp/h:1"], config={"scouting/delay": 5})
    assert settings["scouting/multicast/enabled"] is False
    assert settings["transport/shared_memory/enabled"] is False
    assert settings["scouting/delay"] == 5
    assert zenoh_settings("lan", listen=[], connect=[], config=None)["scouting/multicast/enabled"] is True
