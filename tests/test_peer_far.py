"""Maps far from the origin, through the whole stack: merged as near it, or refused aloud, never gone without a word."""

from __future__ import annotations

import asyncio
import logging

import numpy as np
import pytest

import fleetmap
from fleetmap.codecs.facts import set_anchor
from fleetmap.model.errors import ConfigError, MapFormatError
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN
from fleetmap.model.pose import FixedPose, Pose2
from fleetmap.peer.memory_link import LoopClock, MemoryHub
from fleetmap.peer.peer import HEALTH_S
from fleetmap.vectorize import vectorize


def grid(x_m: float = 0.0, y_m: float = 0.0, *, width: int = 60) -> OccupancyGrid:
    states = np.full((50, width), UNKNOWN, np.uint8)
    states[8:40, 8:-8] = OCCUPIED
    states[10:38, 10:-10] = FREE
    return OccupancyGrid.from_states(states, 0.05, Pose2(x_m, y_m))


def long_grid(far_m: float) -> OccupancyGrid:
    """A free corridor of that length."""
    states = np.full((5, round(far_m / 0.1) + 2), OCCUPIED, np.uint8)
    states[1:-1, 1:-1] = FREE
    return OccupancyGrid.from_states(states, 0.1)


@pytest.mark.parametrize("far_m", [6e3, 50e3, 500e3, 9e6])
@pytest.mark.parametrize("way", ["origin", "anchor", "start", "set_start"])
async def test_a_far_map_is_merged_as_a_near_one(way: str, far_m: float) -> None:
    """Of two robots that are there, each by a way of its own: the other one always by its start."""
    near = far = None
    for x_m in (0.0, far_m):
        hub = MemoryHub(LoopClock())
        start, anchor, origin = (x_m if way == w else 0.0 for w in ("start", "anchor", "origin"))
        async with (
            fleetmap.join("a", start=Pose2(start, -start), link=hub.link("a")) as a,
            fleetmap.join("b", start=Pose2(x_m + 0.02, -x_m), link=hub.link("b")) as b,
        ):
            if way == "set_start":
                await a.set_start(Pose2(x_m, -x_m))
            assert await a.publish(grid(origin, -origin), anchor=Pose2(anchor, -anchor))
            assert await a.publish(grid(origin, -origin, width=62), anchor=Pose2(anchor, -anchor))
            assert await b.publish(grid())
            near, far = far, await b.synced(20.0, at_least=1)
            assert (await a.synced(20.0, at_least=1)).digest == far.digest
            path = b.plan((x_m + 0.7, 0.7 - x_m), (x_m + 1.8, 1.5 - x_m), radius_m=0.1, frame="fleet")
            assert path.length_m == pytest.approx(np.hypot(1.1, 0.8))
            assert a.teammates() == []
    assert near is not None
    assert far is not None
    assert far.left_out == ()
    assert far.origin_um == tuple(round(v * 1e6 / 1.024e9) * 1_024_000_000 for v in (far_m, -far_m))
    assert np.abs(far.segments_xy - [far_m, -far_m] - near.segments_xy).max() < 1e-9
    here, there = near.to_grid(), far.to_grid()
    assert np.array_equal(here.cells_yx, there.cells_yx)
    moved = there.origin.x_m - here.origin.x_m, there.origin.y_m - here.origin.y_m
    assert moved == pytest.approx((far_m, -far_m))


@pytest.mark.parametrize("far_m", [6e3, 50e3])
async def test_a_map_too_large_is_refused_before_anything_is_sent(far_m: float) -> None:
    hub = MemoryHub(LoopClock())
    async with fleetmap.join("a", start=Pose2(), link=hub.link("a")) as a:
        await a.publish(grid())
        before, sent = await a.refresh(), a.stats().bytes_deltas
        for source in (long_grid(far_m), vectorize(long_grid(far_m))):
            with pytest.raises(ConfigError, match=rf"extends {far_m:.0f} m; .* 5243 m"):
                await a.publish(source, submap="1")
        with pytest.raises(ConfigError, match="5243 m"):
            await a.publish(grid(far_m), submap="1")
        assert (await a.refresh()).digest == before.digest
        assert a.stats().bytes_deltas == sent
        assert await a.publish(grid(5.0e3), submap="1")


async def test_a_start_too_far_from_the_fleet_is_refused() -> None:
    hub = MemoryHub(LoopClock())
    async with (
        fleetmap.join("a", start=Pose2(500e3), link=hub.link("a")) as a,
        fleetmap.join("b", link=hub.link("b")) as b,
    ):
        await a.publish(grid())
        await b.publish(grid())
        await b.synced(20.0, at_least=1)
        with pytest.raises(ConfigError, match=r"submap 0 of a \(life [0-9a-f]{16}\) it extends 500002 m"):
            await b.set_start(Pose2())
        assert b.T_fleet_robot is None
        await b.set_start(Pose2(500e3 + 3.0))
        assert len(await b.refresh()) == 8
    with pytest.raises(ConfigError, match=r"1759218[56] m"):
        fleetmap.join("c", start=Pose2(2e7), link=hub.link("c"))


async def test_who_is_left_out_of_the_merged_map_is_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    hub = MemoryHub(LoopClock())
    names = ("a", "b", "far")
    peers = [await fleetmap.join(n, start=Pose2(), link=hub.link(n), fold_interval_s=1e3) for n in names]
    a, b, far = peers
    with caplog.at_level(logging.WARNING, "fleetmap"):
        for peer in (a, b):
            await peer.publish(grid())
        # By a program that doesn't look where the others are.
        anchors = {**set_anchor("0", FixedPose(10**10)), **set_anchor("1", FixedPose(10**10))}
        there = vectorize(grid())
        await far._run(lambda: far._engine._commit(facts=anchors, submaps={"0": there, "1": there}))
        for width in (62, 64):
            await a.publish(grid(width=width))
            for peer in peers:
                await peer.synced(20.0, at_least=2)
    assert {frame for frame, _ in a.merged.left_out} == {("far", far.life, "0"), ("far", far.life, "1")}
    async with asyncio.timeout(20.0):
        while len(caplog.records) < len(peers):  # noqa: ASYNC110 - the log is for looking
            await asyncio.sleep(0.1)
    await asyncio.sleep(2 * HEALTH_S)
    lines = sorted(record.getMessage() for record in caplog.records)
    assert [line.partition(" (life")[0] for line in lines] == [
        "a: left out of the merged map: the map of far, submap 0",
        "b: left out of the merged map: the map of far, submap 0",
        "far: left out of the merged map: the own map, submap 0",
    ]
    assert all("at most 5755 m" in line for line in lines)
    assert all(line.endswith("and 1 more") for line in lines)
    for peer in peers:
        await peer.close()


async def test_a_vector_map_that_is_not_closed_is_refused() -> None:
    """No side of it can be told to be free, so that everybody would leave it out."""
    hub = MemoryHub(LoopClock())
    whole = vectorize(grid())
    torn = fleetmap.VectorMap(whole.lattice, whole.edges[1:], whole.thickness[1:])
    async with fleetmap.join("a", start=Pose2(), link=hub.link("a")) as a:
        with pytest.raises(MapFormatError, match="not closed"):
            await a.publish(torn)
        assert await a.publish(whole)


async def test_a_map_that_jumps_far_away_starts_anew_and_takes_no_memory_for_what_lies_between() -> None:
    hub = MemoryHub(LoopClock())
    async with fleetmap.join("a", start=Pose2(), link=hub.link("a")) as a:
        for far_m in (0.0, 3500.0, 60e3, 0.0):
            assert await a.publish(grid(far_m, far_m))
            merged = await a.refresh()
            assert merged.bounds_m() == pytest.approx((far_m + 0.5, far_m + 0.5, far_m + 2.5, far_m + 1.9), abs=0.2)
