"""Make fleetmap/codecs/mode1_start.py: what the contexts of mode 1 know at first, from generated worlds.

Deltas: one robot explores each of nine worlds with noise and publishes 70 times; and nine terrains like those of the
paper are uncovered as in ``deltas.py``. Snapshots: terrains like those of the paper, as a robot maps them. No seeds are
those that are measured on. About three minutes:

    python benchmarks/train_mode1.py > table.py && mv table.py fleetmap/codecs/mode1_start.py

The tables are part of the format: other tables are another mode. ``--tiny`` is for the tests.
"""

from __future__ import annotations

import argparse
import base64
import zlib
from collections.abc import Iterable, Iterator

import numpy as np
from deltas import uncover
from numpy.typing import NDArray

from fleetmap.codecs.fields import to_fields
from fleetmap.codecs.mode1 import count_decisions
from fleetmap.codecs.mode1_layout import CONTEXTS
from fleetmap.codecs.range_coder import count_memory
from fleetmap.model.delta import diff
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.vectormap import VectorMap
from fleetmap.paper.survey import survey_terrain
from fleetmap.paper.terrains import Terrain
from fleetmap.sims.agent import Agent
from fleetmap.sims.explore import Explorer
from fleetmap.sims.lidar import Lidar
from fleetmap.sims.robot import Drive, Robot
from fleetmap.sims.worlds import choose_starts, make_world
from fleetmap.vectorize import Vectorizer, vectorize

KINDS = ("office", "unstructured", "maze")
WORLD_SEEDS, TERRAIN_SEEDS, MAP_SEEDS = (2, 3, 4), (11, 12, 13), (11, 12, 13, 14)
PUBLISHES, STEPS = 70, 100
LONGEST_S = 2000.0

PRIOR = 0.4
"""So many decisions of either kind are added to those that were counted."""

SEEN_IN_DELTAS, SEEN_IN_SNAPSHOTS = 30, 8
"""A start counts as seen so often at most: more would be slow to unlearn."""

LINE = 100


def publishes(kind: str, seed: int, *, size_m: float) -> Iterator[OccupancyGrid]:
    """The grids that one robot publishes while it explores a world."""
    world = make_world(kind, size_m=size_m, seed=seed)
    start = choose_starts(world, 4, radius_m=0.2, rng=np.random.default_rng([seed, 1]))[0]
    body = Robot(world, start, Lidar(), Drive(pose_noise_m=0.01), np.random.default_rng(seed))
    agent = Agent(body, T_fleet_robot=start, explorer=Explorer("r0"))
    count = 0
    while count < PUBLISHES and agent.now_s < LONGEST_S and not (agent.idle and agent.now_s > 60.0):
        agent.advance(agent.now_s + 3.0)
        if agent.publish_due:
            yield body.mapper.grid()
            agent.published()
            count += 1


def count_run(grids: Iterable[OccupancyGrid], counts: NDArray[np.int64]) -> None:
    """Add the decisions of a run's deltas, without its first map."""
    vectorizer = Vectorizer()
    base: VectorMap | None = None
    for grid in grids:
        vector_map = vectorizer.update(grid)
        if base:
            count_decisions(to_fields(diff(base, vector_map), base), base, counts)
        base = vector_map


def count_snapshot(vector_map: VectorMap, counts: NDArray[np.int64]) -> None:
    """Add the decisions of a whole map."""
    empty = VectorMap.empty(vector_map.lattice)
    count_decisions(to_fields(diff(empty, vector_map), empty), empty, counts)


def print_table(name: str, counts: NDArray[np.int64], most_seen: int) -> None:
    """Print the chances of a 1, out of 256, and how often each counts as seen."""
    zeros, ones = count_memory(counts)
    share = (ones + PRIOR) / (zeros + ones + 2 * PRIOR)
    start = np.clip(np.rint(256 * share - 0.5), 0, 255).astype(np.uint8)
    seen = np.minimum(zeros + ones, most_seen).astype(np.uint8)
    print(f"\n{name} = (")
    for table in (start, seen):
        text = base64.b85encode(zlib.compress(table.tobytes(), 9)).decode()
        print("    zlib.decompress(\n        base64.b85decode(")
        for i in range(0, len(text), LINE):
            print(f'            "{text[i : i + LINE]}"')
        print("        )\n    ),")
    print(")")


def main() -> None:
    """Print the module."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tiny", action="store_true", help="worlds of 10 m: runs in seconds, trains nothing useful")
    tiny = parser.parse_args().tiny
    deltas, snapshots = np.zeros(CONTEXTS, np.int64), np.zeros(CONTEXTS, np.int64)
    for kind in KINDS[:1] if tiny else KINDS:
        for seed in WORLD_SEEDS[:1] if tiny else WORLD_SEEDS:
            count_run(publishes(kind, seed, size_m=10.0 if tiny else 40.0), deltas)
        for seed in MAP_SEEDS[:1] if tiny else MAP_SEEDS:
            grid = survey_terrain(Terrain(kind, 10 if tiny else 40, seed)).grid
            if seed in TERRAIN_SEEDS:
                count_run(uncover(grid, STEPS), deltas)
            for specks in (12, 0):
                count_snapshot(vectorize(grid, specks=specks), snapshots)
            if seed == MAP_SEEDS[0]:
                count_snapshot(vectorize(grid, profile="full"), snapshots)
    print('"""What the contexts of mode 1 know at first; made by ``benchmarks/train_mode1.py``."""\n')
    print("import base64\nimport zlib")
    print_table("DELTA", deltas, SEEN_IN_DELTAS)
    print_table("SNAPSHOT", snapshots, SEEN_IN_SNAPSHOTS)


if __name__ == "__main__":
    main()
