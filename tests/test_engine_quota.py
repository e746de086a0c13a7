"""A publisher that may not send now: the difference to what was sent last goes later, and never a queue."""

from __future__ import annotations

import asyncio

import pytest
from exchange import engine, held, meet, records, room, tell

import fleetmap
from fleetmap.engine import Engine
from fleetmap.engine.quota import BURST_S, Quota
from fleetmap.model.errors import ConfigError
from fleetmap.model.pose import FixedPose, Pose2
from fleetmap.peer.memory_link import LoopClock, MemoryHub


def run(quota: Quota, *, publishes: int, every_s: float) -> tuple[Engine, Engine, list[tuple[float, int]]]:
    """An author that publishes ever larger rooms, and a listener; when records went, and their bytes."""
    author, listener = engine("a", start=FixedPose(), quota=quota), engine("b", start=FixedPose())
    meet(author, listener)
    went = []
    now_s = 0.0
    tell(listener, author, *records(author))
    for k in range(round(publishes * every_s * 10) + 300):
        now_s = k / 10
        if k % round(every_s * 10) == 0 and k < publishes * every_s * 10:
            assert author.publish("0", room(10 + k), now_s=now_s)
        author.tick(now_s)
        for record in records(author):
            went.append((now_s, len(record)))
            tell(listener, author, record, now_s=now_s)
    return author, listener, went


def test_a_budget_is_kept_and_the_last_map_arrives() -> None:
    budget_Bps = 40.0
    author, listener, went = run(Quota(budget_Bps=budget_Bps), publishes=100, every_s=0.2)
    assert held(listener, author).digest == author.own.digest
    assert author.own.submaps["0"].digest == room(10 + 198).digest
    assert 5 < len(went) < 60
    largest = max(size for _, size in went)
    for now_s, _ in went:
        sent = sum(size for then_s, size in went if then_s <= now_s)
        assert sent <= (now_s + BURST_S) * budget_Bps + largest


def test_a_rate_is_kept() -> None:
    author, listener, went = run(Quota(max_rate_hz=1.0), publishes=100, every_s=0.1)
    assert len(went) <= 11
    assert min(b - a for (a, _), (b, _) in zip(went, went[1:], strict=False)) >= 1.0
    assert held(listener, author).digest == author.own.digest


def test_going_back_before_it_is_sent_sends_nothing() -> None:
    author = engine("a", start=FixedPose(), quota=Quota(max_rate_hz=0.1))
    assert author.publish("0", room(10), now_s=0.0)
    assert author.publish("0", room(11), now_s=1.0)
    assert not author.publish("0", room(10), now_s=2.0)
    assert len(records(author)) == 2  # the start, and the first map
    author.tick(20.0)
    assert records(author) == []


@pytest.mark.parametrize("option", ["budget_Bps", "max_rate_hz"])
@pytest.mark.parametrize("value", [0, -1, float("nan"), float("inf")])
def test_impossible_quotas_are_refused(option: str, value: float) -> None:
    with pytest.raises(ConfigError, match=option):
        fleetmap.join("a", **{option: value})


async def test_a_peer_sends_what_waits_later_and_when_it_leaves() -> None:
    hub = MemoryHub(LoopClock())
    async with fleetmap.join("b", start=Pose2(), link=hub.link("b")) as b:
        async with fleetmap.join("a", start=Pose2(), link=hub.link("a"), max_rate_hz=2.0) as a:
            for size in range(20, 30):
                assert await a.publish(room(size))
            assert a.stats().sent["delta"].messages <= 3
            await asyncio.sleep(0.8)
            assert (await b.synced(5.0)).digest == (await a.synced(5.0)).digest
            sent = a.stats().sent["delta"].messages
            assert await a.publish(room(30))
            assert await a.publish(room(31))
        assert a.stats().sent["delta"].messages > sent
        await asyncio.sleep(0.2)
        edges = (await b.refresh()).edges
        assert edges[:, :4].max() == 310  # merged edges are in tenths of a cell
