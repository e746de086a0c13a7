"""Real Zenoh sessions on loopback: explicit endpoints, multicast off, every wait has an event and a timeout."""

from __future__ import annotations

import asyncio
import os
import socket
import sys
import threading
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from attacks import Stranger
from exchange import room

import fleetmap
from fleetmap.model.pose import Pose2
from fleetmap.peer import Peer
from fleetmap.peer.keys import living_keys
from fleetmap.peer.ports import free_port

TIMEOUT_S = 20.0 * float(os.environ.get("FLEETMAP_TEST_TIMEOUT_FACTOR", "1"))


@pytest.fixture
def endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def first(endpoint: str, robot: str = "a", **kw: object) -> Peer:
    return fleetmap.join(robot, fleet="test", profile="local", listen=[endpoint], start=Pose2(), **kw)  # type: ignore[arg-type]


def further(endpoint: str, robot: str, **kw: object) -> Peer:
    return fleetmap.join(robot, fleet="test", profile="local", connect=[endpoint], **{"start": Pose2(), **kw})  # type: ignore[arg-type]


async def until(peer: Peer, condition: Callable[[], bool]) -> None:
    """Wait for something that the peer gets to know of."""
    async with asyncio.timeout(TIMEOUT_S), peer.stepped:
        await peer.stepped.wait_for(condition)


async def test_peers_hold_the_same_merged_map(endpoint: str) -> None:
    async with first(endpoint) as a, further(endpoint, "b", start=Pose2(1.0, 0.5, 0.3)) as b:
        await a.publish(room(100))
        await b.publish(room(80))
        merged = [await peer.synced(TIMEOUT_S, at_least=1) for peer in (a, b)]
        assert len(merged[0]) > 0
        assert merged[0].digest == merged[1].digest
        assert a.revisions == b.revisions


async def test_a_late_joiner_gets_everything(endpoint: str) -> None:
    async with first(endpoint) as a, further(endpoint, "b") as b:
        for size in range(50, 60):
            await a.publish(room(size))
        await b.publish(room(30))
        async with further(endpoint, "c") as c:
            merged = await c.synced(TIMEOUT_S, at_least=2)
            assert merged.digest == (await a.synced(TIMEOUT_S)).digest
            assert [(p.robot, p.alive) for p in c.peers] == [("a", True), ("b", True)]


async def test_changes_say_what_a_record_did(endpoint: str) -> None:
    async with first(endpoint) as a, further(endpoint, "b") as b:
        await b.synced(TIMEOUT_S, at_least=1)
        changes = b.changes()
        waiting = asyncio.ensure_future(anext(changes))
        await a.publish(room(40))
        async with asyncio.timeout(TIMEOUT_S):
            change = await waiting
            while ("a", a.life, "0") not in change.frames:
                change = await anext(changes)
        place = change.frames.index(("a", a.life, "0"))
        assert change.boxes_m[place] == pytest.approx((0.0, 0.0, 2.0, 2.0))
        assert (change.edges_added, change.edges_removed) == (4, 0)
        assert dict(change.revisions)["a"].seq == 2
        await changes.aclose()


async def test_poses_and_goals_arrive_in_the_frame_that_is_asked_for(endpoint: str) -> None:
    async with first(endpoint) as a, further(endpoint, "b", start=Pose2(10.0, 0.0, np.pi / 2)) as b:
        await a.synced(TIMEOUT_S, at_least=1)
        await b.set_pose(Pose2(1.0, 0.0, 0.0))
        await b.set_goal((2.0, 0.0))
        # Poses and goals come on keys of their own, in either order.
        await until(a, lambda: any(m.pose and m.goal_xy for m in a.teammates()))
        (mate,) = a.teammates(frame="fleet")
        assert mate.robot == "b"
        assert mate.pose is not None
        assert (mate.pose.x_m, mate.pose.y_m, mate.pose.yaw_rad) == pytest.approx((10.0, 1.0, np.pi / 2), abs=2e-3)
        assert mate.goal_xy == pytest.approx((10.0, 2.0), abs=2e-3)


async def test_a_closed_peer_is_absent_and_its_map_stays(endpoint: str) -> None:
    async with first(endpoint) as a:
        async with further(endpoint, "b") as b:
            await b.publish(room(60))
            await a.synced(TIMEOUT_S, at_least=1)
        await until(a, lambda: not a.peers[0].alive)
        assert a.peers[0].edges == 4
        assert len(await a.refresh()) > 0
        async with further(endpoint, "c") as c:
            await c.synced(TIMEOUT_S, at_least=1)
            assert [(p.robot, p.alive, p.edges) for p in c.peers] == [("a", True, 0), ("b", False, 4)]
            assert c.merged.digest == a.merged.digest


async def test_a_restarted_robot_is_another_life_and_its_former_map_stays(endpoint: str) -> None:
    async with first(endpoint) as a:
        async with further(endpoint, "b") as b:
            await b.publish(room(60))
            await a.synced(TIMEOUT_S, at_least=1)
            former = b.life
        await until(a, lambda: not a.peers[0].alive)
        async with further(endpoint, "b") as b:
            assert b.life != former
            await b.publish(room(50))
            await a.synced(TIMEOUT_S, at_least=1)
            await b.synced(TIMEOUT_S, at_least=1)
            assert a.merged.digest == b.merged.digest
            assert (a.peers[0].life, a.peers[0].lives) == (b.life, 2)
            await b.publish(room(50), supersedes=True)
            await until(a, lambda: a.peers[0].lives == 1)


async def test_a_name_in_use_is_refused(endpoint: str) -> None:
    async with first(endpoint) as a:
        with pytest.raises(fleetmap.NameInUse, match="'a'"):
            await further(endpoint, "a")
        await a.publish(room(10))


async def test_a_namesake_may_join_when_it_says_that_it_wants_to(endpoint: str) -> None:
    async with first(endpoint) as a, further(endpoint, "a", if_taken="join") as again:
        await a.publish(room(60))
        await again.publish(room(50))
        await until(a, lambda: bool(a.health()))
        await until(again, lambda: bool(again.health()))
        assert (await a.synced(TIMEOUT_S)).digest == (await again.synced(TIMEOUT_S)).digest
        assert {revision.life for _, revision in a.revisions} == {a.life, again.life}


async def test_an_unknown_start_is_a_component_of_its_own(endpoint: str) -> None:
    async with first(endpoint) as a, further(endpoint, "b", start=None) as b:
        await a.publish(room(60))
        await b.publish(room(50))
        merged_a, merged_b = await a.synced(TIMEOUT_S, at_least=1), await b.synced(TIMEOUT_S, at_least=1)
        assert merged_a.digest != merged_b.digest
        assert [robot for robot, _ in b.revisions] == ["b"]
        await b.set_start(Pose2())
        assert b.T_fleet_robot == Pose2()
        assert (await b.synced(TIMEOUT_S)).digest == (await a.synced(TIMEOUT_S)).digest


async def test_a_robot_that_is_killed_is_noticed(endpoint: str) -> None:
    script = (
        "import asyncio, sys, fleetmap\n"
        "async def main():\n"
        "    async with fleetmap.join('k', fleet='test', profile='local', connect=[sys.argv[1]]):\n"
        "        print('joined', flush=True)\n"
        "        await asyncio.sleep(600)\n"
        "asyncio.run(main())\n"
    )
    async with first(endpoint) as a:
        victim = await asyncio.create_subprocess_exec(
            sys.executable, "-c", script, endpoint, stdout=asyncio.subprocess.PIPE
        )
        try:
            assert victim.stdout is not None
            assert await victim.stdout.readline() == b"joined\n"
            await until(a, lambda: bool(a.peers) and a.peers[0].alive and a.peers[0].seq == 1)
            victim.kill()
            await until(a, lambda: not a.peers[0].alive)
        finally:
            if victim.returncode is None:
                victim.kill()
            await victim.wait()


async def test_a_link_that_is_opened_anew_finds_the_fleet_again(endpoint: str) -> None:
    async with first(endpoint) as a, further(endpoint, "b") as b:
        await b.publish(room(60))
        await a.synced(TIMEOUT_S, at_least=1)
        await b._link.reopen()
        await b.publish(room(61))
        await until(a, lambda: a.peers[0].alive and a.peers[0].seq == b._engine.own.seq)
        await a.publish(room(20))
        await until(b, lambda: bool(b.peers) and b.peers[0].alive and b.peers[0].seq == a._engine.own.seq)
        assert (await a.synced(TIMEOUT_S, at_least=1)).digest == (await b.synced(TIMEOUT_S, at_least=1)).digest


async def test_a_port_in_use_is_a_link_error(endpoint: str) -> None:
    async with first(endpoint):
        with pytest.raises(fleetmap.LinkError, match="tcp/"):
            await first(endpoint, "b")


async def test_a_closed_peer_refuses(endpoint: str) -> None:
    peer = await first(endpoint)
    await peer.close()
    await peer.close()
    with pytest.raises(fleetmap.LinkError, match="closed"):
        await peer.publish(room(5))
    assert [change async for change in peer.changes()] == []


async def test_synced_says_what_is_missing(endpoint: str) -> None:
    async with first(endpoint) as a:
        with pytest.raises(TimeoutError, match="1 more peers"):
            await a.synced(0.01, at_least=1)


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("robot", "a b"),
        ("robot", ""),
        ("fleet", "x/y"),
        ("level", "é"),
        ("profile", "wan"),
        ("connect", ["udp/127.0.0.1:1"]),
        ("listen", "tcp/127.0.0.1:1"),
        ("heartbeat_s", 0.0),
    ],
)
def test_an_impossible_option_is_named(option: str, value: object) -> None:
    with pytest.raises(fleetmap.ConfigError, match=option):
        fleetmap.join(**{"robot": "a", option: value})  # type: ignore[arg-type]


def test_a_look_at_a_thousand_tokens_ends(endpoint: str) -> None:
    with Stranger(listen=[endpoint]) as stranger, Stranger(connect=[endpoint], timeout_s=TIMEOUT_S) as who_looks:
        for i in range(1000):
            stranger.token(f"fleetmap/many/x{i}/alive/{i:016x}")
        who_looks.listen_to("fleetmap/many/**")
        who_looks.until(lambda: len(who_looks.alive) == 1000)
        found: list[str] = []

        def look() -> None:
            found.extend(living_keys(who_looks.session, "fleetmap/many/*/alive/**", timeout_s=TIMEOUT_S))

        # A daemon: one that never ended would hold up the end of the tests, too.
        looking = threading.Thread(target=look, daemon=True)
        looking.start()
        looking.join(TIMEOUT_S)
        assert set(found) == who_looks.alive


async def test_who_has_lost_all_links_dials_those_that_it_has_heard_of(timeout_factor):
    seed, other = (f"tcp/127.0.0.1:{free_port('127.0.0.1')}" for _ in range(2))
    join = partial(fleetmap.join, fleet="dead-seed", profile="local", start=Pose2())
    async with join("e", connect=[seed]) as e:
        async with join("a", listen=[seed]), join("b", listen=[other], connect=[seed]):
            await e.synced(20.0 * timeout_factor, at_least=2)
            async with asyncio.timeout(20.0 * timeout_factor):
                while other not in e._engine.addresses():  # noqa: ASYNC110 - b says it a moment later
                    await asyncio.sleep(0.1)
        # Both are gone, and only b comes back, which dials nobody.
        async with join("b", listen=[other]):
            await e.synced(30.0 * timeout_factor, at_least=1)
