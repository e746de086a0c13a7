"""Callers that give up, and peers that are closed under a call: nothing is lost, left open, or stuck."""

from __future__ import annotations

import asyncio
import contextlib
import threading

import numpy as np
import pytest
import zenoh

import fleetmap
import fleetmap.sync
from fleetmap.merge import fold
from fleetmap.model.errors import LinkError
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.mergedmap import MergedMap
from fleetmap.model.pose import Pose2
from fleetmap.peer.memory_link import FakeClock, LoopClock, MemoryHub
from fleetmap.peer.zenoh_link import ZenohLink, parse_token


def grid() -> OccupancyGrid:
    states = np.full((40, 40), 2, np.uint8)
    states[8:30, 8:30] = 0
    return OccupancyGrid.from_states(states, 0.05)


async def test_a_refresh_that_is_cancelled_still_reaches_the_readers(monkeypatch: pytest.MonkeyPatch) -> None:
    began, gate = asyncio.Event(), threading.Event()
    loop = asyncio.get_running_loop()

    def slow(sources: object) -> MergedMap:
        loop.call_soon_threadsafe(began.set)
        gate.wait(20.0)
        return fold(sources)  # type: ignore[arg-type]

    hub = MemoryHub(LoopClock())
    async with fleetmap.join("a", start=Pose2(), link=hub.link("a"), fold_interval_s=0.0) as peer:
        await peer.refresh()
        changes = peer.changes()

        async def first_edges() -> int:
            async for change in changes:
                if change.edges_added:
                    return change.edges_added
            return 0

        reader = asyncio.ensure_future(first_edges())
        monkeypatch.setattr("fleetmap.merge.fold", slow)
        # The refresh takes its turn before the peer's own: both wait for the same lock, in this order.
        async with peer._folder._turn:
            refresh = asyncio.ensure_future(peer.refresh())
            await asyncio.sleep(0)
            await peer.publish(grid())
        await began.wait()
        refresh.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await refresh
        gate.set()
        async with asyncio.timeout(20.0):
            assert await reader > 0
        assert len(peer.merged) > 0
        await changes.aclose()


async def test_a_publish_that_is_cancelled_ends_before_the_next_one_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    hub = MemoryHub(LoopClock())
    async with fleetmap.join("a", start=Pose2(), link=hub.link("a")) as peer:
        began, gate, running, most = asyncio.Event(), threading.Event(), [0], [0]
        loop, real = asyncio.get_running_loop(), peer._publisher._vectorize

        def slow(submap: str, source: OccupancyGrid) -> object:
            running[0] += 1
            most[0] = max(most[0], running[0])
            loop.call_soon_threadsafe(began.set)
            gate.wait(20.0)
            result = real(submap, source)
            running[0] -= 1
            return result

        monkeypatch.setattr(type(peer._publisher), "_vectorize", lambda _, submap, source: slow(submap, source))
        first = asyncio.ensure_future(peer.publish(grid()))
        await began.wait()
        first.cancel()
        with pytest.raises(asyncio.CancelledError):
            await first
        second = asyncio.ensure_future(peer.publish(grid()))
        await asyncio.sleep(0)
        loop.call_later(0.1, gate.set)
        assert not await second  # the first one was said
        assert most[0] == 1


async def test_synced_under_which_the_peer_is_closed_says_so() -> None:
    hub = MemoryHub(LoopClock())
    peer = await fleetmap.join("a", link=hub.link("a"))
    waiting = asyncio.ensure_future(peer.synced(20.0, at_least=3))
    async with asyncio.timeout(20.0):
        while not peer.stepped._waiters:  # type: ignore[attr-defined]  # noqa: ASYNC110 - a condition has no event
            await asyncio.sleep(0)
    await peer.close()
    with pytest.raises(LinkError, match="closed"):
        await waiting


def test_a_sync_call_under_which_the_peer_is_closed_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = FakeClock()
    link = MemoryHub(clock).link("a")
    peer = fleetmap.sync.join("a", link=link)
    began, gate = threading.Event(), threading.Event()

    def slow(*_: object) -> None:
        began.set()
        gate.wait(20.0)

    monkeypatch.setattr(type(peer._peer._publisher), "_vectorize", slow)
    ended: list[BaseException] = []

    def publish() -> None:
        try:
            peer.publish(grid())
        except BaseException as error:
            ended.append(error)

    thread = threading.Thread(target=publish, daemon=True)
    thread.start()
    assert began.wait(20.0)
    peer.close()
    thread.join(20.0)
    gate.set()
    assert [type(e) for e in ended] == [LinkError]


@pytest.mark.parametrize("life", ["", "1", "\u00b2" * 16, "0" * 15 + "G", "0" * 15 + "A", "0" * 17, "x"])
def test_a_life_in_other_digits_is_no_token(life: str) -> None:
    assert parse_token(f"fleetmap/f/r/alive/{life}") is None
    assert parse_token("fleetmap/f/r/alive/00000000000000ff") == ("r", 255)


def test_a_session_that_opens_after_close_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    closed = []

    class Session:
        def close(self) -> None:
            closed.append(self)

    closer = threading.Thread(target=lambda: link.close_now())

    def open_session(config: object) -> Session:
        closer.start()
        assert link._closed.wait(20.0)
        return Session()

    monkeypatch.setattr("zenoh.open", open_session)
    link = ZenohLink("r", fleet="f", profile="local")
    for _ in range(2):  # and then, none is opened
        with pytest.raises(LinkError, match="closed"):
            link._open(None)  # type: ignore[arg-type]
        closer.join()
        assert len(closed) == 1


async def test_a_close_that_is_cancelled_closes_the_link(monkeypatch: pytest.MonkeyPatch) -> None:
    hub = MemoryHub(LoopClock())
    link = hub.link("a")
    peer = await fleetmap.join("a", link=link)
    began, gate, real = asyncio.Event(), asyncio.Event(), link.close

    async def slow() -> None:
        began.set()
        await gate.wait()
        await real()

    monkeypatch.setattr(link, "close", slow)
    closing = asyncio.ensure_future(peer.close())
    await began.wait()
    closing.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await closing
    gate.set()
    await peer.close()
    assert link.token is None


async def test_connecting_anew_is_tried_until_it_works(monkeypatch: pytest.MonkeyPatch) -> None:
    link = ZenohLink("a", fleet="f", profile="local")
    tries = []

    def open_session(receiver: object) -> list[object]:
        tries.append(receiver)
        if len(tries) < 3:
            raise zenoh.ZError("the port is taken")
        return []

    monkeypatch.setattr(link, "_open", open_session)
    monkeypatch.setattr(link, "_receiver", object())
    await asyncio.wait_for(link.reopen(), 20)
    assert len(tries) == 3
