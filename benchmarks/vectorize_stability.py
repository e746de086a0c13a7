"""How many edges change when nothing did? A world that is seen again, and a grid that is rendered at other phases.

1. A robot that stands still in a world of 40 m observes it for 100 publishes: a scan each, ranges off by 2 cm and poses
   by 1 cm (one sigma), added up by its mapper. Per cent of all edges that each publish takes away: mean, median, the
   mean of the last half, and how much of it was given up though it held, since all around took too many vertices.
2. A grid is rendered at 20 random phases, uniform in half a cell each way, by linear interpolation between its cell
   centres: what a mapper does that lays its origin elsewhere each time. Per cent of the edges that each phase takes
   away: the first, the median, the worst; and those of phases within 0.4 cells after one that was, too. Beyond that a
   wall that is ragged by one cell each way is more than epsilon = sqrt(2) cells off every edge that held before.

    python benchmarks/vectorize_stability.py [--maps MAP.yaml...] [--json]
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
from numpy.typing import NDArray
from scipy import ndimage

from fleetmap.model.delta import diff
from fleetmap.model.errors import MapWarning
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN
from fleetmap.model.map_server import load_map
from fleetmap.model.pose import Pose2
from fleetmap.paper.survey import survey_terrain
from fleetmap.paper.terrains import choose_terrains
from fleetmap.sims.lidar import Lidar
from fleetmap.sims.mapping import Mapper
from fleetmap.sims.worlds import choose_starts, make_world
from fleetmap.vectorize import Vectorizer

PROFILES = ("share", "full")
POSE_SIGMA = (0.01, 0.01, 0.001)
MODERATE_CELLS = 0.4


def observe_again(kind: str, size_m: float, profile: str, publishes: int) -> dict[str, Any]:
    """A static world, publish after publish."""
    rng = np.random.default_rng(0)
    world = make_world(kind, size_m=size_m, seed=1)
    start = choose_starts(world, 1, radius_m=0.2, rng=rng)[0]
    lidar = Lidar()
    mapper = Mapper(lidar)
    vectorizer = Vectorizer(profile=profile)
    old = None
    changed, redone = [], []
    for k in range(10 + publishes):
        mapper.add(lidar.scan(world, start, rng=rng), Pose2(*(rng.normal(0, 1, 3) * POSE_SIGMA)))
        if k < 10:
            continue
        new = vectorizer.update(mapper.grid())
        if old is not None:
            changed.append(100 * len(diff(old, new).removed) / len(old))
            redone.append(100 * vectorizer.redone / len(old))
        old = new
    assert old is not None
    later = changed[len(changed) // 2 :]
    return {
        "what": f"{kind}, seen again",
        "profile": profile,
        "edges": len(old),
        "mean": float(np.mean(changed)),
        "median": float(np.median(changed)),
        "last half": float(np.mean(later)),
        "given up": float(np.mean(redone)),
    }


def render(states: NDArray[np.uint8], phase_yx: NDArray[np.float64]) -> NDArray[np.uint8]:
    """(height, width) states at the centres of cells that lie off by a phase: the one that weighs most there."""
    order = (OCCUPIED, FREE, UNKNOWN)
    weights = [ndimage.shift((states == s).astype(np.float32), -phase_yx, order=1, mode="nearest") for s in order]
    return np.array(order, np.uint8)[np.argmax(weights, axis=0)]


def change_phase(name: str, grid: OccupancyGrid, profile: str, phases: int) -> dict[str, Any]:
    """A static grid, phase after phase."""
    rng = np.random.default_rng(0)
    states, cell_m = grid.states_yx(), grid.resolution_m
    vectorizer = Vectorizer(profile=profile)
    old = vectorizer.update(OccupancyGrid.from_states(states, cell_m))
    changed, calm = [], []
    before = np.zeros(2)
    for _ in range(phases):
        phase_yx = rng.uniform(-0.5, 0.5, 2)
        origin = Pose2(phase_yx[1] * cell_m, phase_yx[0] * cell_m)
        new = vectorizer.update(OccupancyGrid.from_states(render(states, phase_yx), cell_m, origin))
        changed.append(100 * len(diff(old, new).removed) / len(old))
        if max(abs(before).max(), abs(phase_yx).max()) <= MODERATE_CELLS:
            calm.append(changed[-1])
        old, before = new, phase_yx
    return {
        "what": f"{name}, {phases} phases",
        "profile": profile,
        "edges": len(old),
        "first": changed[0],
        "median": float(np.median(changed)),
        "worst": max(changed),
        "moderate": float(np.median(calm)) if calm else None,
    }


def rows(options: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """All that is measured, one after the other."""
    size_m, publishes, phases, terrain_m = (20.0, 4, 2, 10) if options.tiny else (40.0, 100, 20, 40)
    for kind in ("maze", "office", "unstructured"):
        for profile in PROFILES:
            yield observe_again(kind, size_m, profile, publishes)
    grids = [(f"terrain {t.name}", survey_terrain(t).grid) for t in choose_terrains((terrain_m,))]
    paths = options.maps
    if not paths and not options.tiny and (folder := os.environ.get("FLEETMAP_DATA")):
        paths = sorted(Path(folder).glob("maps/*/map.yaml"))
    for path in paths:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MapWarning)
            grids.append((path.parent.name, load_map(path)))
    for name, grid in grids:
        for profile in PROFILES:
            yield change_phase(name, grid, profile, phases)


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--maps", nargs="*", type=Path, default=[], help="map_server maps instead of FLEETMAP_DATA's")
    parser.add_argument("--json", action="store_true", help="one document instead of lines")
    parser.add_argument("--tiny", action="store_true", help="small worlds, twice: for the tests")
    options = parser.parse_args()
    found = []
    for row in rows(options):
        found.append(row)
        if not options.json:
            numbers = {k: f"{v:.2f}" for k, v in row.items() if isinstance(v, float)}
            print(
                f"{row['what']:36s}{row['profile']:6s}{row['edges']:7d} edges; per cent changed: {numbers}", flush=True
            )
    if options.json:
        json.dump(found, sys.stdout)


if __name__ == "__main__":
    main()
