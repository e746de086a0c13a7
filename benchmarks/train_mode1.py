"""Make fleetmap/codecs/mode1_start.py: the start probabilities of payload mode 1, from deltas of generated worlds.

One robot explores each world and publishes 70 times; seed 1 is left out, to measure on. About two minutes:

    python benchmarks/train_mode1.py > fleetmap/codecs/mode1_start.py

The table is part of the format: another table is another mode. ``--tiny`` is for the tests: one small world.
"""

from __future__ import annotations

import argparse
import base64
from collections.abc import Iterator

import numpy as np

from fleetmap.codecs.fields import to_fields
from fleetmap.codecs.mode1 import count_decisions
from fleetmap.codecs.mode1_layout import CONTEXTS
from fleetmap.model.delta import diff
from fleetmap.model.vectormap import VectorMap
from fleetmap.sims.agent import Agent
from fleetmap.sims.explore import Explorer
from fleetmap.sims.lidar import Lidar
from fleetmap.sims.robot import Drive, Robot
from fleetmap.sims.worlds import choose_starts, make_world
from fleetmap.vectorize import Vectorizer

WORLDS = [(kind, seed) for seed in (2, 3, 4) for kind in ("office", "unstructured", "maze")]
PUBLISHES = 70
LONGEST_S = 2000.0
LINE = 100


def publishes(kind: str, seed: int, *, size_m: float) -> Iterator[VectorMap]:
    """The maps that one robot publishes while it explores a world."""
    world = make_world(kind, size_m=size_m, seed=seed)
    start = choose_starts(world, 4, radius_m=0.2, rng=np.random.default_rng([seed, 1]))[0]
    body = Robot(world, start, Lidar(), Drive(pose_noise_m=0.01), np.random.default_rng(seed))
    agent = Agent(body, T_fleet_robot=start, explorer=Explorer("r0"))
    vectorizer = Vectorizer()
    count = 0
    while count < PUBLISHES and agent.now_s < LONGEST_S and not (agent.idle and agent.now_s > 60.0):
        agent.advance(agent.now_s + 3.0)
        if agent.publish_due:
            yield vectorizer.update(body.mapper.grid())
            agent.published()
            count += 1


def main() -> None:
    """Print the module."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tiny", action="store_true", help="one world of 8 m: runs in seconds, trains nothing useful")
    tiny = parser.parse_args().tiny
    counts = np.zeros((CONTEXTS, 2), np.int64)
    for kind, seed in WORLDS[:1] if tiny else WORLDS:
        base: VectorMap | None = None
        for vector_map in publishes(kind, seed, size_m=8.0 if tiny else 40.0):
            base = base or VectorMap.empty(vector_map.lattice)
            count_decisions(to_fields(diff(base, vector_map), base), base, counts)
            base = vector_map
    zeros, ones = counts.T
    share = (zeros + 0.6) / (zeros + ones + 1.2)
    table = bytes(np.clip(np.rint(256 * share - 0.5), 2, 253).astype(np.uint8))
    text = base64.b85encode(table).decode()
    print('"""Start probabilities of payload mode 1, one byte a context; made by ``benchmarks/train_mode1.py``."""\n')
    print("import base64\n\nSTART = base64.b85decode(")
    for i in range(0, len(text), LINE):
        print(f'    "{text[i : i + LINE]}"')
    print(")")


if __name__ == "__main__":
    main()
