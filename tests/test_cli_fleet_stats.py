"""``fleetmap stats --fleet``: a watcher on loopback that is no robot, and shows what the robots count themselves."""

from __future__ import annotations

import asyncio
import json
import signal
import socket
import sys
import threading

import numpy as np
import pytest
import zenoh

import fleetmap
from fleetmap.model.errors import LinkError
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN
from fleetmap.model.pose import Pose2
from fleetmap.peer import Peer
from fleetmap.peer.figures import counts
from fleetmap.peer.profiles import zenoh_settings
from fleetmap.peer.settings import as_json5
from fleetmap.peer.watcher import Seen, Watcher


def hall(width: int) -> OccupancyGrid:
    """A room of 20 free rows and so many free columns."""
    states = np.full((30, 80), UNKNOWN, np.uint8)
    states[4:26, 4 : 6 + width] = OCCUPIED
    states[5:25, 5 : 5 + width] = FREE
    return OccupancyGrid.from_states(states, 0.05, Pose2())


@pytest.fixture
def endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def robot(name: str, endpoint: str, *, first: bool = False) -> Peer:
    place = {"listen": [endpoint]} if first else {"connect": [endpoint]}
    return fleetmap.join(name, fleet="watched", profile="local", start=Pose2(), heartbeat_s=0.5, **place)


async def look_until(watcher: Watcher, robots: int, timeout_factor: float) -> list[Seen]:
    """Look until so many robots answer; links come up one after the other."""
    async with asyncio.timeout(20 * timeout_factor):
        while True:
            seen = await watcher.look()
            if sum(s.figures is not None for s in seen) == robots:
                return seen


@pytest.mark.parametrize("busy", [False, True])
async def test_what_is_shown_is_what_the_robots_count_and_nothing_of_it_stays(endpoint, timeout_factor, busy):
    async with robot("a", endpoint, first=True) as a, robot("b", endpoint) as b:
        for width in (10, 20):
            await a.publish(hall(width))
        await a.set_pose(Pose2(1.0, 0.5, 0.0))
        for peer in (a, b):
            await peer.synced(60 * timeout_factor, at_least=1)
        before = {peer: peer.stats() for peer in (a, b)}
        async with Watcher("watched", profile="local", connect=[endpoint]) as watcher:
            for width in range(21, 26):
                if busy:
                    await a.publish(hall(width))
                seen = await look_until(watcher, 2, timeout_factor)
        # Only heartbeats may have gone out between the robots' answers and this look at them.
        for shown, peer in zip(seen, (a, b), strict=True):
            now, figures = peer.stats(), shown.figures
            assert (shown.robot, shown.alive) == (peer.robot, True)
            assert shown.endpoint.startswith("tcp/127.0.0.1:")
            assert figures is not None
            told = counts(figures.sent)
            assert now.sent.keys() == told.keys()
            assert all(now.sent[kind] == count for kind, count in told.items() if kind != "digest")
            assert 0 <= now.sent["digest"].messages - told["digest"].messages <= 20
            assert counts(figures.grids) == now.grids
            assert figures.explored_dm2 == round(100 * now.explored_m2)
            # What the watcher caused is not what the robot sent.
            grown = {k for k, count in now.sent.items() if count != before[peer].sent.get(k)}
            assert grown <= ({"digest", "delta"} if busy and peer is a else {"digest"})
            assert now.received.keys() == before[peer].received.keys() | (
                {("a", "delta")} if busy and peer is b else set()
            )
            assert [p.robot for p in peer.peers] == [other.robot for other in (a, b) if other is not peer]
        assert sum(peer.stats().watched.size_bytes for peer in (a, b)) == watcher.answers.size_bytes
        assert a.stats().explored_m2 == pytest.approx((25 if busy else 20) * 20 * 0.05**2)


@pytest.mark.parametrize("ends", ["in time", "by Ctrl-C"])
async def test_the_command_shows_payload_and_wire_and_ends_as_it_is_told(endpoint, timeout_factor, ends):
    command = ["stats", "--fleet", "watched", "--connect", endpoint, "--no-multicast-scouting", "--json"]
    command += ["--for-s", "1"] if ends == "in time" else []
    async with robot("a", endpoint, first=True) as a:
        for width in (10, 20):
            await a.publish(hall(width))
        watcher = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "fleetmap", *command, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE
        )
        assert watcher.stderr is not None
        async with asyncio.timeout(60 * timeout_factor):
            assert await watcher.stderr.readline() == f"reached a by {endpoint}\n".encode()
            if ends == "by Ctrl-C":
                watcher.send_signal(signal.SIGINT)
            out, err = await watcher.communicate()
    assert watcher.returncode == 0, err.decode()
    document = json.loads(out)
    assert document["reached"] == 1
    (row,) = document["robots"]
    assert (row["robot"], row["alive"], row["endpoint"]) == ("a", True, endpoint)
    assert row["kinds"]["delta"]["messages"] in (3, 4)  # where it listens may be said by then
    assert row["bytes"] == sum(kind["bytes"] for kind in row["kinds"].values())
    assert row["wire_bytes"] == sum(row["wire"].values()) > row["bytes"]
    assert row["explored_m2"] == pytest.approx(1.0)
    assert row["bytes_per_m2"] == pytest.approx(row["bytes"], abs=0.01)
    for grids, ratio in row["ratios"].items():
        assert ratio == pytest.approx(row[grids] / row["bytes"])
        # Poses, heartbeats and keep-alives count on both sides.
        assert row["wire_ratios"][grids] == pytest.approx(row[f"wire_{grids}"] / row["wire_bytes"])
    assert row["watchers"]["messages"] == document["watcher"]["answers"] - 1  # all before this one


async def test_whoever_reaches_nobody_is_told_what_to_do(fleetmap_command, endpoint, tmp_path):
    command = ("stats", "--connect", endpoint, "--no-multicast-scouting", "--for-s", "0.5")
    alone = await asyncio.to_thread(fleetmap_command, *command, "--fleet", "watched", cwd=tmp_path)
    assert alone.code == 1
    assert endpoint in alone.err
    assert "--connect" in alone.err
    async with robot("a", endpoint, first=True):
        other = await asyncio.to_thread(fleetmap_command, *command, "--fleet", "other", "--json", cwd=tmp_path)
    assert other.code == 1
    assert other.document["error"]["type"] == "LinkError"
    assert "robots of watched: name one of these with --fleet" in other.document["error"]["message"]


async def test_a_robot_that_does_not_say_or_says_nonsense_is_shown_without_figures(endpoint, timeout_factor):
    config = zenoh.Config()
    for key, value in zenoh_settings("local", listen=[endpoint], connect=[], config=None).items():
        config.insert_json5(key, as_json5(value))
    session = await asyncio.to_thread(zenoh.open, config)
    try:
        mute = session.liveliness().declare_token("fleetmap/watched/mute/alive/0000000000000001")
        session.liveliness().declare_token("fleetmap/watched/liar/alive/0000000000000002")

        def lie(query: zenoh.Query) -> None:
            with query:
                query.reply("fleetmap/watched/liar/stats/0000000000000002", b"\xff" * 100)

        session.declare_queryable("fleetmap/watched/liar/stats/0000000000000002", lie)
        async with (
            Watcher("watched", profile="local", connect=[endpoint]) as watcher,
            asyncio.timeout(20 * timeout_factor),
        ):
            while not (seen := await watcher.look()):
                pass
        assert seen[-1] == Seen("mute", True, None, None, lives=1)
        assert all(s.figures is None for s in seen)
        del mute
    finally:
        await asyncio.to_thread(session.close)


async def test_a_robot_at_work_answers_at_once(endpoint, timeout_factor):
    """Its engine has one thread, and a long map may keep that for seconds."""
    async with (
        robot("a", endpoint, first=True) as a,
        Watcher("watched", profile="local", connect=[endpoint]) as watcher,
    ):
        await look_until(watcher, 1, timeout_factor)
        done = threading.Event()
        work = asyncio.ensure_future(a._read(lambda: done.wait(60 * timeout_factor)))
        try:
            (seen,) = await watcher.look()
        finally:
            done.set()
        assert seen.figures is not None
        assert await work


async def test_a_closed_watcher_refuses(endpoint):
    async with Watcher("watched", profile="local", connect=[endpoint]) as watcher:
        pass
    with pytest.raises(LinkError, match="closed"):
        await watcher.look()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ([], "--fleet NAME"),
        (["map.yaml", "--fleet", "a"], "without maps"),
        (["map.yaml", "--for-s", "3"], "go with --fleet"),
        (["--fleet", "no spaces please"], "fleet"),
    ],
)
def test_what_does_not_go_together_is_refused(fleetmap_command, tmp_path, arguments, says):
    run = fleetmap_command("stats", *arguments, cwd=tmp_path)
    assert run.code == 2, run.err
    assert says in run.err
