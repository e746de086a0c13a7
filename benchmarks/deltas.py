"""What do updates cost while a map grows? Deltas of vector maps beside gzipped grids and differences of grids.

Groups, never mixed in one median: the paper's terrains of 40 m and real maps, along whose free space a disc of 10 m
moves by 1.5 m a step and uncovers what is in sight (100 steps); generated worlds of 40 m that a robot explores, its
ranges off by 2 cm and its poses by 1 cm (one sigma; 100 publishes); and logs of real lasers, mapped scan by scan with
the simulation's mapper and published by its rule, 1.5 m or 5 s on the way, up to their end. The logs' poses are taken
as they stand: in those with raw odometry they drift, walls smear and are drawn anew beside the old ones. Where a log
counts scans for stamps, a scan is a second. For each step:

- delta: the record as it is published, payload and envelope; bytes: median, 99th percentile, largest
- full: gzip -6 of the whole grid, as nav_msgs/OccupancyGrid
- updates: gzip -6 of the smallest rectangle with all changes, as map_msgs/OccupancyGridUpdate
- differences: the same rectangle as three states through the exact layer, with the last grid as its base: the best
  that is known for grids

and the ratios of their sums to that of the deltas. Grids are lossless and vector maps lie within epsilon = sqrt(2)
cells: no ratio without that. After each step the delta is decoded and applied, and must give the same bytes.

    python benchmarks/deltas.py [--maps MAP.yaml...] [--logs LOG...] [--only GROUP...] [--json]
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from carmen import replay
from scipy import ndimage

from fleetmap.codecs.baselines import exact_changed_rectangle, gzip_changed_rectangle, gzip_grid
from fleetmap.engine import Alive, Chain, Engine, Message, Put
from fleetmap.model.errors import MapWarning
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import FREE, UNKNOWN
from fleetmap.model.map_server import load_map
from fleetmap.model.pose import FixedPose
from fleetmap.paper.survey import survey_terrain
from fleetmap.paper.survey_kernels import look_around
from fleetmap.paper.terrains import choose_terrains
from fleetmap.paper.tour import plan_tour
from fleetmap.sims.agent import Agent
from fleetmap.sims.explore import Explorer
from fleetmap.sims.lidar import Lidar
from fleetmap.sims.robot import Drive, Robot
from fleetmap.sims.worlds import World, choose_starts, make_world
from fleetmap.vectorize import Vectorizer

REACH_M, STEP_M, BEAMS = 10.0, 1.5, 1440
WALL_CELLS = 2
"""Of what is not free so many cells are uncovered beside what is in sight."""

LONGEST_S = 4000.0

GROUPS = {
    "terrains": "terrains, uncovered",
    "worlds": "worlds, explored with noise",
    "maps": "real maps, uncovered",
    "logs": "laser logs, mapped step by step",
}
"""By the names that ``--only`` takes."""


def uncover(grid: OccupancyGrid, steps: int) -> Iterator[OccupancyGrid]:
    """A disc of sight moves through the largest free space of a grid."""
    states, cell_m = grid.states_yx(), grid.resolution_m
    solid = np.pad(states != FREE, 1, constant_values=True)[1:-1, 1:-1].copy()
    places = plan_tour(World(solid, resolution_m=cell_m)).places_xy
    apart = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(places, axis=0).T))]) * cell_m
    in_sight = np.zeros(solid.shape, bool)
    square = np.ones((2 * WALL_CELLS + 1,) * 2, bool)
    for k in range(steps):
        if k * STEP_M > apart[-1]:
            return
        x, y = places[np.searchsorted(apart, k * STEP_M)]
        look_around(solid, in_sight, x, y, BEAMS, REACH_M / cell_m)
        known = ndimage.binary_dilation(in_sight, square)
        yield OccupancyGrid.from_states(np.where(known, states, UNKNOWN).astype(np.uint8), cell_m, grid.origin)


def explore(kind: str, size_m: float, steps: int) -> Iterator[OccupancyGrid]:
    """The grids that one robot with noise publishes."""
    world = make_world(kind, size_m=size_m, seed=1)
    start = choose_starts(world, 1, radius_m=0.2, rng=np.random.default_rng(1))[0]
    body = Robot(world, start, Lidar(), Drive(pose_noise_m=0.01), np.random.default_rng(1))
    agent = Agent(body, T_fleet_robot=start, explorer=Explorer("r0"))
    while steps and agent.now_s < LONGEST_S and not (agent.idle and agent.now_s > 60.0):
        agent.advance(agent.now_s + 3.0)
        if agent.publish_due:
            yield body.mapper.grid()
            agent.published()
            steps -= 1


def follow(name: str, grids: Iterator[OccupancyGrid]) -> dict[str, Any]:
    """One run: what each way of sending would have taken."""
    vectorizer = Vectorizer()
    author, listener = (Engine(robot, chain=Chain(robot.encode()), start=FixedPose()) for robot in ("r0", "r1"))
    listener.receive(Alive(*author.own.key), now_s=0.0)
    deltas: list[int] = []
    sums = {"full": 0, "updates": 0, "differences": 0}
    old = None
    edges = 0

    def carry() -> int:
        size = 0
        for output in author.take_outputs():
            if isinstance(output, Put) and output.kind == "delta":
                listener.receive(Message("r0", output.life, "delta", output.payload), now_s=0.0)
                size += len(output.payload)
        return size

    carry()
    for grid in grids:
        vector_map = vectorizer.update(grid)
        edges = len(vector_map)
        author.publish("0", vector_map)
        deltas.append(carry())
        (held,) = listener.holdings.replicas.values()
        assert held.stream.digest == author.own.digest
        sums["full"] += gzip_grid(grid)
        sums["updates"] += gzip_changed_rectangle(old, grid)
        sums["differences"] += exact_changed_rectangle(old, grid)
        old = grid
    total = sum(deltas)
    sent = [size for size in deltas if size]
    return {
        "run": name,
        "steps": len(deltas),
        "edges": edges,
        "bytes": total,
        "median": float(np.median(deltas)),
        "p99": float(np.percentile(deltas, 99)),
        "largest": max(sent, default=0),
        "ratios": {key: size / total for key, size in sums.items()},
    }


def runs(options: argparse.Namespace) -> Iterator[tuple[str, str, Iterator[OccupancyGrid]]]:
    """Group, name and grids of each run."""
    steps, terrain_m, world_m = (3, 10, 10.0) if options.tiny else (100, 40, 40.0)
    maps, logs = options.maps, options.logs
    if not options.tiny and (folder := os.environ.get("FLEETMAP_DATA")):
        maps = maps or sorted(Path(folder).glob("maps/*/map.yaml"))
        logs = logs or sorted(Path(folder).glob("logs/*.log.gz"))
    if "terrains" in options.only:
        for terrain in choose_terrains((terrain_m,)):
            yield GROUPS["terrains"], terrain.name, uncover(survey_terrain(terrain).grid, steps)
    if "worlds" in options.only:
        for kind in ("maze", "office", "unstructured"):
            yield GROUPS["worlds"], f"{kind} {world_m:.0f} m", explore(kind, world_m, steps)
    for path in maps if "maps" in options.only else ():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MapWarning)
            yield GROUPS["maps"], path.parent.name, uncover(load_map(path), steps)
    for path in logs if "logs" in options.only else ():
        name = path.name.removesuffix(".gz").removesuffix(".log")
        yield GROUPS["logs"], name, replay(path, steps=steps if options.tiny else None)


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--maps", nargs="*", type=Path, default=[], help="map_server maps instead of FLEETMAP_DATA's")
    parser.add_argument("--logs", nargs="*", type=Path, default=[], help="CARMEN logs instead of FLEETMAP_DATA's")
    parser.add_argument("--only", nargs="+", choices=GROUPS, default=list(GROUPS), help="run only these groups")
    parser.add_argument("--json", action="store_true", help="one document instead of lines")
    parser.add_argument("--tiny", action="store_true", help="terrains of 10 m, three steps: for the tests")
    options = parser.parse_args()
    groups: dict[str, list[dict[str, Any]]] = {}
    for group, name, grids in runs(options):
        row = follow(name, grids)
        groups.setdefault(group, []).append(row)
        if not options.json:
            ratios = ", ".join(f"{key} {ratio:.1f} x" for key, ratio in row["ratios"].items())
            print(
                f"{group}: {name:25s}{row['steps']:4d} steps{row['edges']:7d} edges{row['bytes']:8d} B, "
                f"a step {row['median']:.0f} B, p99 {row['p99']:.0f}, most {row['largest']}; {ratios}",
                flush=True,
            )
    if not groups:
        parser.error("no maps, no logs: name some with --maps or --logs, or set FLEETMAP_DATA")
    medians = {
        group: {
            **{key: float(np.median([row[key] for row in rows])) for key in ("median", "p99")},
            "ratios": {key: float(np.median([row["ratios"][key] for row in rows])) for key in rows[0]["ratios"]},
        }
        for group, rows in groups.items()
    }
    if options.json:
        json.dump({"epsilon_cells": 2**0.5, "groups": groups, "medians": medians}, sys.stdout)
        return
    for group, row in medians.items():
        ratios = ", ".join(f"{key} {ratio:.1f} x" for key, ratio in row["ratios"].items())
        print(f"median of {len(groups[group])}, {group}: {row['median']:.0f} B, p99 {row['p99']:.0f} B; {ratios}")


if __name__ == "__main__":
    main()
