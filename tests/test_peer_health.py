"""What is wrong tells itself: in ``health()`` and the log within 5 s, and in what ``synced`` raises."""

from __future__ import annotations

import asyncio
import logging
import socket
import time
from collections.abc import Callable

import msgpack
import pytest
from attacks import Stranger
from conftest import two_rooms

import fleetmap
from fleetmap.model.errors import ConfigError
from fleetmap.model.pose import Pose2
from fleetmap.peer.memory_link import LoopClock, MemoryHub
from fleetmap.peer.ports import free_port

WITHIN_S = 5.0
PLACE = {"fleet": "sick", "profile": "local", "start": Pose2()}


@pytest.fixture
def endpoint() -> str:
    return f"tcp/127.0.0.1:{free_port('127.0.0.1')}"


async def told(peer: fleetmap.Peer, kind: str, caplog: pytest.LogCaptureFixture, timeout_factor: float) -> str:
    """What a peer says of a kind of problem: in ``health``, in its log, and to a watcher."""
    began_s = time.monotonic()
    async with asyncio.timeout(WITHIN_S * timeout_factor):
        await until(lambda: kind in _logged(peer, caplog))
    assert time.monotonic() - began_s < WITHIN_S * timeout_factor
    (problem,) = [problem for problem in peer.health() if problem.kind == kind]
    lines = [record for record in caplog.records if record.getMessage() == f"{peer.robot}: {problem.text}"]
    assert [record.levelno for record in lines] == [logging.WARNING]
    return problem.text


def _logged(peer: fleetmap.Peer, caplog: pytest.LogCaptureFixture) -> set[str]:
    texts = {record.getMessage() for record in caplog.records}
    return {problem.kind for problem in peer.health() if f"{peer.robot}: {problem.text}" in texts}


async def until(true: Callable[[], object]) -> None:
    while not true():  # noqa: ASYNC110 - health is for looking
        await asyncio.sleep(0.05)


async def test_nobody_at_the_endpoint(endpoint, caplog, timeout_factor):
    async with fleetmap.join("a", connect=[endpoint], **PLACE) as peer:
        text = await told(peer, "unreachable", caplog, timeout_factor)
        assert text.startswith(f"no link to {endpoint}: nobody listens there: start the robot that should, or check")
        with pytest.raises(TimeoutError, match="nobody listens there"):
            await peer.synced(0.5)
        # It is over once somebody is there, and is not told again.
        async with fleetmap.join("b", listen=[endpoint], **PLACE), asyncio.timeout(20 * timeout_factor):
            await until(lambda: not peer.health())
            await peer.synced(10.0 * timeout_factor, at_least=1)


async def test_a_host_that_does_not_exist(caplog, timeout_factor):
    async with fleetmap.join("a", connect=["tcp/nowhere.invalid:7447"], **PLACE) as peer:
        text = await told(peer, "unreachable", caplog, timeout_factor)
        assert "no computer is known by the name 'nowhere.invalid'" in text


async def test_somebody_who_is_no_fleetmap(caplog, timeout_factor):
    with socket.create_server(("127.0.0.1", 0)) as server:
        endpoint = f"tcp/127.0.0.1:{server.getsockname()[1]}"
        async with fleetmap.join("a", connect=[endpoint], **PLACE) as peer:
            assert "but no link comes up" in await told(peer, "unreachable", caplog, timeout_factor)


async def test_several_endpoints_of_which_one_is_reached_are_no_problem(endpoint, timeout_factor):
    dead = f"tcp/127.0.0.1:{free_port('127.0.0.1')}"
    async with (
        fleetmap.join("b", listen=[endpoint], **PLACE),
        fleetmap.join("a", connect=[dead, endpoint], **PLACE) as peer,
    ):
        await peer.synced(10.0 * timeout_factor, at_least=1)
        await asyncio.sleep(3.0)
        assert peer.health() == ()


async def test_robots_behind_a_router_that_never_hear_each_other(router, caplog, timeout_factor):
    alone = {**PLACE, "config": {"scouting/gossip/enabled": False}}
    async with (
        fleetmap.join("a", connect=[router], **alone) as a,
        fleetmap.join("b", connect=[router], **alone) as b,
    ):
        assert await told(a, "router", caplog, timeout_factor) == (
            "b and this robot are behind a router, which passes nothing on between peers: join with "
            'config={"mode": "client"}, or give connect= the address of a robot'
        )
        assert (await told(b, "router", caplog, timeout_factor)).startswith("a and this robot")
    async with (
        fleetmap.join("a", connect=[router], **{**PLACE, "config": {"mode": "client", "listen/endpoints": []}}) as a,
        fleetmap.join("b", connect=[router], **{**PLACE, "config": {"mode": "client", "listen/endpoints": []}}),
    ):
        await a.synced(10.0 * timeout_factor, at_least=1)
        assert a.health() == ()


@pytest.mark.parametrize("said", ["a message", "a token of other form"])
async def test_another_version_of_the_protocol_is_named_with_its_robot(said, endpoint, caplog, timeout_factor):
    async with fleetmap.join("a", listen=[endpoint], **PLACE) as peer:
        with Stranger(connect=[endpoint]) as stranger:
            if said == "a message":
                payload = msgpack.packb([3 << 4 | 3, 1, 2, 3])
                async with asyncio.timeout(WITHIN_S * timeout_factor):
                    while not peer.health():
                        stranger.put("fleetmap/sick/b/digest/0123456789abcdef", payload)
                        await asyncio.sleep(0.1)
                text = await told(peer, "version", caplog, timeout_factor)
                assert text.startswith("b speaks version 3 of the protocol, and this one version 2")
            else:
                stranger.token("fleetmap/sick/b/alive/0/0")
                text = await told(peer, "version", caplog, timeout_factor)
                assert text.startswith("b speaks another version of the protocol")
            assert "Install the same fleetmap on both" in text


async def test_a_name_that_is_taken(endpoint, caplog, timeout_factor):
    async with (
        fleetmap.join("a", listen=[endpoint], **PLACE) as first,
        fleetmap.join("a", connect=[endpoint], if_taken="join", **PLACE),
    ):
        assert "Give each robot a name of its own" in await told(first, "namesake", caplog, timeout_factor)


async def test_an_own_map_that_is_left_out_of_the_merged_one(caplog, timeout_factor):
    hub = MemoryHub(LoopClock())
    hub.cut("a", "b")
    far = Pose2(9000.0, 0.0, 0.0)
    async with (
        fleetmap.join("a", link=hub.link("a"), start=Pose2()) as a,
        fleetmap.join("b", link=hub.link("b"), start=far) as b,
    ):
        # Each alone is within what a component may extend; then they meet.
        await a.publish(two_rooms())
        await b.publish(two_rooms())
        hub.heal("a", "b")
        async with asyncio.timeout(WITHIN_S * timeout_factor):
            await until(lambda: a.health() and b.health())
        (left_out,) = {problem.robot for peer in (a, b) for problem in peer.health()}
        own, other = (a, b) if left_out == "a" else (b, a)
        text = await told(own, "left out", caplog, timeout_factor)
        assert text.startswith("left out of the merged map: the own map, submap 0")
        assert f"the map of {left_out}" in await told(other, "left out", caplog, timeout_factor)


def test_a_key_file_that_is_missing_is_refused_at_once():
    for config in (
        {"transport/link/tls/connect_private_key": "/nowhere/a.key"},
        {"transport/link/tls": {"root_ca_certificate": "/nowhere/a.key"}},
        {"transport/link/tls": '{"listen_certificate": "/nowhere/a.key"}'},
        {"transport": {"auth": {"usrpwd": {"dictionary_file": "/nowhere/a.key"}}}},
    ):
        with pytest.raises(ConfigError, match=r"/nowhere/a.key can't be read \(No such file or directory\)"):
            fleetmap.join("a", config=config)
