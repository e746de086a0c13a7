"""Do drawn grids keep walls closed? Rooms, real maps, and grids that were tampered with.

1. Closed rooms with walls of one or two cells (straight, stepped or slanting; known or unknown beyond), seen by one to
   four robots in frames of their own, whose starts are off by a fifth of a cell. How many have a 4-connected way out,
   in the grid of each source and in the merged one at half to twice the cell.
2. Maps and the paper's terrains, vectorized in all profiles: places where the drawn grid opens a wall.
3. Drawn grids of closed rooms from which cells were taken: how many the verifier refuses, of those that a flood gets
   through, and of those that it doesn't.

    python benchmarks/drawn_walls.py [--rooms 2000] [--grids 200] [--maps MAP.yaml...] [--json]
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

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from rooms import KINDS, is_shut, make_room, take_cells

from fleetmap.merge import fold
from fleetmap.model.errors import MapWarning
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.map_server import load_map
from fleetmap.paper.survey import survey_terrain
from fleetmap.paper.terrains import choose_terrains
from fleetmap.vectorize import rasterize, vectorize, verify

PROFILES = ("share", "full", "exact")
RESOLUTIONS_M = (0.025, 0.03, 0.0375, 0.05, 0.07, 0.1)


def open_rooms(count: int) -> dict[str, Any]:
    """Seeds of the rooms that are open, in grids of sources and in merged ones."""
    in_source, in_merged, sources = [], [], 0
    for seed in range(count):
        room = make_room(np.random.default_rng(seed), KINDS[seed % len(KINDS)])
        placed = room.sources(PROFILES[seed // len(KINDS) % 2])
        sources += len(placed)
        for source, grid in zip(placed, room.grids, strict=True):
            if not is_shut(rasterize(source.vector_map, like=grid), room.outline, source.T_fleet_frame.to_pose()):
                in_source.append(seed)
        merged = fold(placed)
        if not all(is_shut(merged.to_grid(r), room.outline) for r in RESOLUTIONS_M):
            in_merged.append((seed, len(placed)))
    return {"rooms": count, "sources": sources, "open_in_source": in_source, "open_in_merged": in_merged}


def opened_maps(maps: Iterator[tuple[str, OccupancyGrid]]) -> dict[str, Any]:
    """Per map and profile, how many places the verifier tells; and how much is wrong besides."""
    opened: dict[str, int] = {}
    for name, grid in maps:
        for profile in PROFILES:
            report = verify(grid, vectorize(grid, profile=profile))
            kinds = [v.kind for v in report.violations]
            opened[f"{name} {profile}"] = kinds.count("opened")
            assert len(kinds) == kinds.count("opened"), (name, profile, set(kinds))
    return {"maps": len(opened) // len(PROFILES), "opened": {k: n for k, n in opened.items() if n}}


def tampered(count: int) -> dict[str, int]:
    """Until there are so many of both kinds: refused of those that are open, and of those that are not."""
    told = {"open": 0, "open_refused": 0, "shut": 0, "shut_refused": 0}
    seed = 0
    while min(told["open"], told["shut"]) < count:
        rng = np.random.default_rng([1, seed])
        room = make_room(rng, KINDS[seed % len(KINDS)], robots=1)
        vector_map = vectorize(room.grids[0], profile=PROFILES[seed % 2])
        drawn = take_cells(rasterize(vector_map, like=room.grids[0]), rng, block=bool(seed % 4 > 1))
        kind = "shut" if is_shut(drawn, room.outline) else "open"
        if told[kind] < count:
            told[kind] += 1
            report = verify(room.grids[0], vector_map, drawn=drawn)
            told[f"{kind}_refused"] += any(v.kind == "opened" for v in report.violations)
        seed += 1
    return told


def find_maps(paths: list[Path], sizes: tuple[int, ...]) -> Iterator[tuple[str, OccupancyGrid]]:
    """Real maps, then the paper's terrains as a robot surveys them."""
    for path in paths:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MapWarning)
            yield path.parent.name, load_map(path)
    for terrain in choose_terrains(sizes):
        yield terrain.name, survey_terrain(terrain).grid


def main() -> None:
    """Run all three and print what was found."""
    data = Path(os.environ.get("FLEETMAP_DATA", "/nonexistent"))
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rooms", type=int, default=2000)
    parser.add_argument("--grids", type=int, default=200, help="so many open ones and so many shut ones")
    parser.add_argument("--maps", type=Path, nargs="*", default=sorted(data.glob("maps/*/map.yaml")))
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--tiny", action="store_true", help="a few rooms, one small terrain")
    options = parser.parse_args()
    if options.tiny:
        options.rooms, options.grids, options.maps = 4, 2, []
    document = {
        "rooms": open_rooms(options.rooms),
        "maps": opened_maps(find_maps(options.maps, (10,) if options.tiny else (10, 40, 80))),
        "tampered": tampered(options.grids),
    }
    if options.json:
        print(json.dumps(document, indent=2))
        return
    for name, found in document.items():
        print(name, " ".join(f"{key}={value}" for key, value in found.items()))


if __name__ == "__main__":
    main()
