"""How long does it take to judge a bag, and how much memory? By default 10 000 maps of 200 kB: 2 GB.

The bag is written by rosbags. A disc of sight moves through a world at 1 m a map; of what is in sight a share of cells
flickers in each map. Printed are seconds, and the largest sum of what all processes of `fleetmap stats` hold
(proportional set size), on how many cores.

    python benchmarks/bag.py [--maps 10000] [--side 447] [--json]
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer

from fleetmap.bridges import cdr, grids
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.kernel_cache import modules_of
from fleetmap.model.kernel_compiler import compile_ahead
from fleetmap.sims.worlds import make_world

SIGHT_CELLS, STEP_CELLS = 60, 20
FLICKER = 0.002
EVERY_NS = 500_000_000
LOOK_S = 0.2


def maps(side: int, count: int) -> Iterator[OccupancyGrid]:
    """What a robot says that wanders about an office."""
    world = make_world("office", size_m=0.05 * side, seed=1)
    truth = np.full((side, side), -1, np.int8)
    height, width = (min(side, n) for n in world.solid.shape)
    truth[:height, :width] = np.where(world.solid[:height, :width], 100, 0)
    known, rng = np.full_like(truth, -1), np.random.default_rng(1)
    rows, columns = np.ogrid[:side, :side]
    at, way = np.array([side / 2, side / 2]), rng.normal(size=2)
    for _ in range(count):
        way += 0.3 * rng.normal(size=2)
        way *= STEP_CELLS / np.hypot(*way)
        at = np.clip(at + way, 0, side - 1)
        near = (rows - at[0]) ** 2 + (columns - at[1]) ** 2 < SIGHT_CELLS**2
        known = np.where(near, truth, known)
        wrong = near & (rng.random(known.shape) < FLICKER) & (known >= 0)
        known[wrong] = 100 - known[wrong]
        yield OccupancyGrid(known, 0.05)


def write(path: Path, side: int, count: int) -> None:
    """A bag with nothing but ``/map``."""
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/map", cdr.MAP, typestore=cdr.typestore())
        for k, grid in enumerate(maps(side, count)):
            message = grids.map_message(grid, frame_id="map", stamp_ns=k * EVERY_NS)
            writer.write(connection, 10**18 + k * EVERY_NS, cdr.encode(message, cdr.MAP))


def family(pid: int) -> list[int]:
    """A process and all that it has started."""
    found = [pid]
    for path in Path(f"/proc/{pid}/task").glob("*/children"):
        try:
            for child in path.read_text().split():
                found += family(int(child))
        except OSError:  # it ended meanwhile
            continue
    return found


def held_kb(pid: int) -> int:
    """What a process holds, what it shares with others in part."""
    try:
        lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    except OSError:
        return 0
    return sum(int(line.split()[1]) for line in lines if line.startswith("Pss:"))


def judge(path: Path) -> dict[str, Any]:
    """Run ``fleetmap stats``, and look at it."""
    began_s, most_kb = time.monotonic(), 0
    command = [sys.executable, "-m", "fleetmap", "stats", str(path), "--json"]
    with tempfile.TemporaryFile("w+") as out:
        process = subprocess.Popen(command, stdout=out)
        while process.poll() is None:
            most_kb = max(most_kb, sum(map(held_kb, family(process.pid))))
            time.sleep(LOOK_S)
        took_s = time.monotonic() - began_s
        if process.returncode:
            raise SystemExit(process.returncode)
        out.seek(0)
        (topic,) = json.load(out)["bags"][0]["topics"]
    return {"s": round(took_s, 1), "mb": round(most_kb / 1024), "codecs": topic["codecs"], "edges": topic["edges"]}


def main() -> None:
    """Write a bag, judge it, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--maps", type=int, default=10_000)
    parser.add_argument("--side", type=int, default=447, help="cells")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--tiny", action="store_true", help="see that it runs")
    options = parser.parse_args()
    if options.tiny:
        options.maps, options.side = 120, 120
    compile_ahead(modules_of("model", "vectorize", "codecs"))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bag"
        write(path, options.side, options.maps)
        size_gb = sum(file.stat().st_size for file in path.iterdir()) / 1e9
        document = {"maps": options.maps, "gb": round(size_gb, 3), "cores": os.cpu_count(), **judge(path)}
    if options.json:
        print(json.dumps(document, indent=2))
    else:
        for name, value in document.items():
            print(f"{name:8} {value}")


if __name__ == "__main__":
    main()
