"""``fleetmap stats --fleet``: a guest that watches a fleet on loopback."""

from __future__ import annotations

import asyncio
import json
import signal
import socket
import sys

import numpy as np
import pytest

import fleetmap
from fleetmap.cli.fleet_stats import Grids
from fleetmap.model.lattice import Lattice
from fleetmap.model.pose import Pose2
from fleetmap.model.vectormap import VectorMap


def room(size: int) -> VectorMap:
    corners = [(0, 0), (0, size), (size, size), (size, 0)]
    rows = [(*a, *b, 1) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
    return VectorMap(Lattice(50_000), np.array(rows, np.int32), np.full(4, 4, np.uint8))


@pytest.fixture
def endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


@pytest.mark.parametrize("ends", ["in time", "by Ctrl-C"])
async def test_it_counts_what_robots_send_and_what_grids_would_have_cost(endpoint, timeout_factor, ends):
    command = ["stats", "--fleet", "watched", "--connect", endpoint, "--no-multicast-scouting", "--json"]
    command += ["--for-s", "6"] if ends == "in time" else []
    async with fleetmap.join("r1", fleet="watched", profile="local", listen=[endpoint], start=Pose2()) as robot:
        await robot.publish(room(100))
        # Whoever reads first compiles and keeps the kernels: the watcher has only some seconds.
        async with fleetmap.join("stats-first", fleet="watched", profile="local", connect=[endpoint]) as first:
            await first.synced(120 * timeout_factor, at_least=1)
            await robot.publish(room(99))
            await first.synced(120 * timeout_factor)
            for maps in first.maps.values():
                Grids().look(maps)
        watcher = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "fleetmap", *command, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE
        )
        async with asyncio.timeout(30 * timeout_factor), robot.stepped:
            await robot.stepped.wait_for(lambda: any(p.alive for p in robot.peers))
        for step in range(30 if ends == "by Ctrl-C" else 200):
            await robot.publish(room(101 + step))
            await asyncio.sleep(0.2)
            if watcher.returncode is not None:
                break
        if ends == "by Ctrl-C":
            watcher.send_signal(signal.SIGINT)
        out, err = await asyncio.wait_for(watcher.communicate(), 30 * timeout_factor)
    assert watcher.returncode == 0, err.decode()
    document = json.loads(out)
    (row,) = document["robots"]
    assert row["robot"] == "r1"
    assert row["alive"]
    assert row["edges"] == 4
    assert row["kinds"]["delta"]["messages"] >= 1
    assert row["wire_bytes"] > row["bytes"] > 0
    assert row["changes"] >= 2
    assert row["grid_gzip_full"] > row["grid_exact_updates"] > 0


def test_a_map_that_no_grid_can_hold_is_counted_and_left_out():
    far = VectorMap(Lattice(50_000), np.array([[-(2**20), -(2**20), 2**20, 2**20, 1]], np.int32), np.zeros(1, np.uint8))
    grids = Grids()
    grids.look({"0": far, "1": room(20)})
    assert (grids.undrawn, grids.changes) == (1, 1)


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
