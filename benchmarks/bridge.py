"""Does the bridge keep up with a large map? A grid of 4000 x 4000 cells comes in each second, and the fleet's goes out.

The robot uncovers a maze of 200 m with 5500 walls; the ROS side speaks rmw_zenoh's wire by way of a router on loopback;
the bridge is `fleetmap bridge ros2` in a process of its own. Printed are its CPU time a second of the clock, what it
holds in memory, how long a map takes from in to out, and how many of those that came in were taken in: the newest
count, so that no queue grows. Beside it, in this process, one step of each part of the work, on the same maps:

- read: the message's CDR, into a grid
- vectorize: `Vectorizer.update`
- send: the difference, encoded
- fold: the merged map of the one robot, from scratch
- draw: the merged map as a grid
- write: the grid as CDR

    python benchmarks/bridge.py [--cells 4000] [--seconds 60] [--rate-hz 1] [--json]
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import resource
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import zenoh

from fleetmap.bridges import cdr, grids
from fleetmap.bridges.qos import LATCHED
from fleetmap.bridges.rmw_zenoh import RmwZenoh
from fleetmap.bridges.zenoh_port import ZenohPort
from fleetmap.codecs.protocol import encode
from fleetmap.merge import fold
from fleetmap.merge.protocol import Source
from fleetmap.model.delta import diff
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.grid_like import grid_of
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN
from fleetmap.model.pose import FixedPose
from fleetmap.peer.keys import zenoh_config
from fleetmap.peer.ports import free_port
from fleetmap.sims.worlds import make_world
from fleetmap.vectorize import Vectorizer

REACH_CELLS = 200
FIRST_SHARE = 0.8
"""Of the building is known in the first map already."""
WARM_UP = 3
"""Maps that come before anything is counted."""


def maps(cells: int) -> Iterator[OccupancyGrid]:
    """A maze that is known but for a part, which is uncovered disc by disc."""
    world = make_world("maze", size_m=cells * 0.05, seed=1)
    states = np.where(world.solid, OCCUPIED, FREE).astype(np.uint8)[:cells, :cells]
    states = np.pad(states, [(0, cells - n) for n in states.shape], constant_values=UNKNOWN)
    # What no free cell touches is inside of walls, which no robot sees.
    inner = np.pad(states == FREE, 2)
    near = sum(np.roll(inner, shift, (0, 1)) for shift in np.ndindex(5, 5))[:cells, :cells] > 0
    states[~near & (states == OCCUPIED)] = UNKNOWN
    known = np.zeros_like(states, bool)
    known[:, : int(FIRST_SHARE * cells)] = True
    rng, y, x = np.random.default_rng(1), cells // 2, int(FIRST_SHARE * cells)
    rows, columns = np.ogrid[:cells, :cells]
    while True:
        known |= (rows - y) ** 2 + (columns - x) ** 2 < (REACH_CELLS * cells // 4000) ** 2
        yield OccupancyGrid.from_states(np.where(known, states, UNKNOWN).astype(np.uint8), 0.05, world.origin)
        y = int(np.clip(y + rng.integers(-60, 61), 0, cells - 1))
        x = int(np.clip(x + rng.integers(-20, 41), 0, cells - 1))


def cpu_s(pid: int) -> float:
    """CPU time that a process has taken."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def memory_mb(pid: int) -> float:
    """What a process holds."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * resource.getpagesize() / 1e6


async def live(cells: int, seconds: float, rate_hz: float) -> dict[str, Any]:
    """The bridge at work, seen from outside."""
    ros = f"tcp/127.0.0.1:{free_port('127.0.0.1')}"
    settings = {"mode": "router", "listen/endpoints": [ros], "scouting/multicast/enabled": False}
    router = zenoh.open(zenoh_config({**settings, "transport/link/rx/max_message_size": 1 << 30}))
    port, came = ZenohPort(RmwZenoh(), endpoint=ros, node="mapper"), list[tuple[float, int]]()
    say = port.advertise("map", cdr.MAP, LATCHED)
    port.subscribe("fleet_map", cdr.MAP, LATCHED, lambda data: came.append((time.monotonic(), len(data))))
    status: list[bytes] = []
    port.subscribe("/diagnostics", cdr.DIAGNOSTICS, LATCHED, status.append)
    await port.open()
    command = [sys.executable, "-m", "fleetmap", "bridge", "ros2", "r1", "--start", "0,0,0", "--ros-endpoint", ros]
    options = ["--no-multicast-scouting", "--map-rate-hz", str(rate_hz), "--fleet-map-rate-hz", str(rate_hz)]
    process = await asyncio.create_subprocess_exec(*command, *options, stderr=asyncio.subprocess.DEVNULL)
    try:
        made, said = maps(cells), list[float]()
        waits_s: list[float] = []
        begun = None
        ends_s = time.monotonic() + 600
        while time.monotonic() < ends_s:
            data = cdr.encode(grids.map_message(next(made), frame_id="map", stamp_ns=time.time_ns()), cdr.MAP)
            said.append(time.monotonic())
            say(data)
            if begun is None and len(came) >= WARM_UP:
                begun = time.monotonic(), cpu_s(process.pid), memory_mb(process.pid), len(said), len(came)
                ends_s = begun[0] + seconds
            await asyncio.sleep(max(0.0, said[-1] + 1 / rate_hz - time.monotonic()))
            if begun is not None and came:
                # A map that goes out holds at least what came in by the pause before it.
                waits_s.append(min((t for t, _ in came if t > said[-1]), default=time.monotonic()) - said[-1])
        assert begun is not None
        at_s, used_s, held_mb, first_said, first_came = begun
        took_s = time.monotonic() - at_s
        return {
            "cells": cells,
            "seconds": round(took_s, 1),
            "maps_said": len(said) - first_said,
            "fleet_maps_heard": len(came) - first_came,
            "message_mb": round(came[-1][1] / 1e6, 1),
            "cores": round((cpu_s(process.pid) - used_s) / took_s, 3),
            "memory_mb_at_begin": round(held_mb),
            "memory_mb_at_end": round(memory_mb(process.pid)),
            "out_after_s": round(statistics.median(waits_s), 2),
            "figures": {v.key: v.value for v in cdr.decode(status[-1], cdr.DIAGNOSTICS, topic="x").status[0].values},
        }
    finally:
        process.terminate()
        await process.wait()
        await port.close()
        router.close()


def parts(cells: int, steps: int) -> dict[str, float]:
    """Median CPU milliseconds of each part, one map after the other."""
    took: dict[str, list[float]] = {}

    def timed(name: str, work: Callable[[], Any]) -> Any:
        began_s = time.process_time()
        result = work()
        took.setdefault(name, []).append(1e3 * (time.process_time() - began_s))
        return result

    vectorizer, before = Vectorizer(), None
    edges = 0
    made = maps(cells)
    for _ in range(steps + 1):
        data = cdr.encode(grids.map_message(next(made), frame_id="map", stamp_ns=1), cdr.MAP)
        grid = timed("read", lambda data=data: grid_of(cdr.decode(data, cdr.MAP, topic="x")))
        vector_map = timed("vectorize", lambda grid=grid: vectorizer.update(grid))
        if before is not None:
            timed("send", lambda a=before, b=vector_map: encode(diff(a, b), a))
        before = vector_map
        merged = timed("fold", lambda v=vector_map: fold([Source(("r1", 1, "0"), FixedPose(), v)]))
        drawn = timed("draw", merged.to_grid)
        timed("write", lambda d=drawn: cdr.encode(grids.map_message(d, frame_id="fleet", stamp_ns=1), cdr.MAP))
        edges = len(merged)
    medians = {name: round(statistics.median(times[-steps:]), 2) for name, times in took.items()}
    return {"edges": edges, **medians, "sum": round(sum(medians.values()), 2)}


def main() -> None:
    """Measure, and print a table or a document."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cells", type=int, default=4000)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--rate-hz", type=float, default=1.0)
    parser.add_argument("--steps", type=int, default=10)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--tiny", action="store_true", help="see that it runs")
    options = parser.parse_args()
    if options.tiny:
        options.cells, options.seconds, options.rate_hz, options.steps = 400, 2.0, 5.0, 2
    document = {
        "parts_ms": parts(options.cells, options.steps),
        "live": asyncio.run(live(options.cells, options.seconds, options.rate_hz)),
    }
    if options.json:
        print(json.dumps(document, indent=2))
        return
    for title, figures in document.items():
        print(title)
        for name, value in figures.items():
            print(f"  {name:24} {value}")


if __name__ == "__main__":
    main()
