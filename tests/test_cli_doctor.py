"""``fleetmap doctor``: each cause for which robots don't find each other is told in words that say what to do."""

from __future__ import annotations

import asyncio
import json
import sys
from typing import Any

import msgpack
import pytest
from attacks import Stranger
from conftest import two_rooms

import fleetmap
from fleetmap.model.pose import Pose2
from fleetmap.peer.ports import free_port

PLACE = {"fleet": "sick", "profile": "local", "start": Pose2()}


def free_endpoint() -> str:
    return f"tcp/127.0.0.1:{free_port('127.0.0.1')}"


@pytest.fixture
def endpoint() -> str:
    return free_endpoint()


async def doctor(*arguments: str) -> tuple[int, str, str]:
    """Exit code, output and errors of the command."""
    command = [sys.executable, "-m", "fleetmap", "doctor", "--no-multicast-scouting", "--for-s", "2", *arguments]
    process = await asyncio.create_subprocess_exec(
        *command, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE
    )
    out, errors = await process.communicate()
    assert process.returncode is not None
    return process.returncode, out.decode(), errors.decode()


async def findings(*arguments: str) -> dict[str, Any]:
    code, out, errors = await doctor("--fleet", "sick", "--json", *arguments)
    document: dict[str, Any] = json.loads(out)
    assert code == (1 if document["problems"] else 0), errors
    return document


async def test_robots_that_are_well(endpoint):
    async with fleetmap.join("a", listen=[endpoint], **PLACE), fleetmap.join("b", connect=[endpoint], **PLACE):
        code, out, _ = await doctor("--fleet", "sick", "--connect", endpoint)
        assert code == 0
        assert out.splitlines()[-1] == "no problem found"
        assert f"robot a answers, by {endpoint}" in out
        assert "robot b answers" in out


async def test_nobody_at_one_endpoint_and_no_such_host_at_another(endpoint):
    document = await findings("--connect", endpoint, "--connect", "tcp/nowhere.invalid:7447")
    assert [problem["kind"] for problem in document["problems"]] == ["unreachable"] * 2
    text = " ".join(problem["text"] for problem in document["problems"])
    assert "nobody listens there" in text
    assert "no computer is known by the name 'nowhere.invalid'" in text


@pytest.mark.parametrize("wrong", ["tcp/127.0.0.1", "tcp/127.0.0.1:99999", "tcp/:7447", "tcp/10.0.0.2 :7447"])
async def test_a_bad_endpoint_is_an_error_of_usage(wrong):
    code, _, errors = await doctor("--connect", wrong)
    assert code == 2
    assert "expected tcp/HOST:PORT" in errors


async def test_robots_behind_a_router(router):
    alone = {**PLACE, "config": {"scouting/gossip/enabled": False}}
    async with fleetmap.join("a", connect=[router], **alone):
        document = await findings("--connect", router)
        assert document["robots"] == []
        (problem,) = document["problems"]
        assert problem["text"].startswith("a and this robot are behind a router")


async def test_another_version_and_a_name_that_two_have_and_one_that_does_not_answer(endpoint):
    async with (
        fleetmap.join("a", listen=[endpoint], **PLACE),
        fleetmap.join("a", connect=[endpoint], if_taken="join", **PLACE),
    ):
        with Stranger(connect=[endpoint]) as stranger:
            stranger.token("fleetmap/sick/new/alive/0123456789abcdef")
            answer = msgpack.packb([3 << 4 | 8, 1, 2, 3])
            stranger.answer("fleetmap/sick/new/stats/0123456789abcdef", [answer])
            stranger.token("fleetmap/sick/old/alive/0/0")
            stranger.token("fleetmap/sick/hung/alive/0123456789abcdef")
            document = await findings("--connect", endpoint)
    texts = {(problem["kind"], problem["about"]): problem["text"] for problem in document["problems"]}
    assert texts["version", "new"].startswith("new speaks version 3 of the protocol, and this one version 2")
    assert texts["version", "old"].startswith("old speaks another version of the protocol")
    assert texts["namesake", "a"].startswith("2 living peers are named a: give each robot a name of its own")
    assert texts["mute", "hung"].startswith("hung shows that it lives, and doesn't answer")


async def test_what_a_robot_finds_wrong_itself_is_told(endpoint, timeout_factor):
    later, far = free_endpoint(), Pose2(9000.0, 0.0, 0.0)
    async with (
        fleetmap.join("a", listen=[endpoint], **PLACE) as a,
        fleetmap.join("b", connect=[later], **{**PLACE, "start": far}) as b,
    ):
        # Each alone is within what a component may extend; then they meet by way of a third one.
        await a.publish(two_rooms())
        await b.publish(two_rooms())
        async with (
            asyncio.timeout(30 * timeout_factor),
            fleetmap.join("c", listen=[later], connect=[endpoint], **{**PLACE, "start": None}),
        ):
            while {p.kind for p in (*a.health(), *b.health())} != {"left out"}:  # noqa: ASYNC110 - health is for looking
                await asyncio.sleep(0.1)
            document = await findings("--connect", endpoint)
    told = [problem for problem in document["problems"] if problem["kind"] == "told"]
    (own,) = [problem for problem in told if "left out of the merged map: the own map, submap 0" in problem["text"]]
    assert own["text"].startswith(f"{own['about']} tells: ")
