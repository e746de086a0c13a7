"""Robots in a building of identical rooms, none knows where it started: whether any is ever merged at a wrong place.

A corridor with identical rooms on both sides, and a lobby with pillars at one end, which is the only thing that tells
one place from another. Prints for each seed whether the robots became one fleet and when, how far off a robot ever was
in its own merged map, and in how many components they ended.

    python benchmarks/alike_rooms.py [--robots 8] [--seeds 1 2 3] [--out FOLDER] [--json]
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import FREE, OCCUPIED
from fleetmap.model.map_server import save_map
from fleetmap.sims.config import SimConfig
from fleetmap.sims.fleet import run_fleet

CELL_M = 0.05
ROOM, DOOR, CORRIDOR, LOBBY, WALL = (80, 90), 20, 44, 160, 3
"""Cells: height and width of a room, its door, the corridor, the length of the lobby, a wall."""


def building(rooms: int) -> NDArray[np.bool_]:
    """Solid cells: so many rooms on each side of a corridor, and the lobby."""
    height, width = ROOM
    room = np.zeros((height, width), bool)
    room[:WALL] = room[-WALL:] = room[:, :WALL] = True
    room[-WALL:, 36 : 36 + DOOR] = False
    room[14:28, 12:30] = True  # a desk in each
    side = np.tile(room, (1, rooms))
    floor = np.vstack([side, np.zeros((CORRIDOR, side.shape[1]), bool), side[::-1]])
    lobby = np.zeros((len(floor), LOBBY), bool)
    for row, column in ((40, 60), (120, 100), (52, 118), (150, 30)):
        lobby[row : row + 8, column : column + 8] = True
    lobby[:60, :WALL] = lobby[-80:, :WALL] = True
    whole = np.hstack([floor, lobby])
    return np.pad(whole, WALL, constant_values=True)


def try_seed(folder: Path, seed: int, *, robots: int, rooms: int) -> dict[str, Any]:
    """One run."""
    states = np.where(building(rooms), OCCUPIED, FREE).astype(np.uint8)
    folder.mkdir(parents=True, exist_ok=True)
    save_map(OccupancyGrid.from_states(states, CELL_M), folder / "building.yaml")
    config = SimConfig(
        out=folder / f"run-{seed}", robots=robots, world=str(folder / "building.yaml"), seed=seed, starts="unknown",
        listen="tcp/127.0.0.1:0",
    )  # fmt: skip
    document: dict[str, Any] = dict(run_fleet(config).document)
    keys = ("components", "together_s", "misplaced_m", "converged", "covered", "simulated_s", "merged_error_m")
    return {"seed": seed, **{key: document[key] for key in keys}}


def main() -> None:
    """Run them, one after the other."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", type=int, default=8)
    parser.add_argument("--rooms", type=int, default=6, help="on each side of the corridor")
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3])
    parser.add_argument("--out", type=Path, help="keeps the run folders; a temporary one if not named")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--tiny", action="store_true", help="see that it runs")
    options = parser.parse_args()
    if options.tiny:
        options.robots, options.rooms, options.seeds = 1, 1, [1]
    rows = []
    with tempfile.TemporaryDirectory(prefix="fleetmap-alike-") as scratch:
        for seed in options.seeds:
            row = try_seed(options.out or Path(scratch), seed, robots=options.robots, rooms=options.rooms)
            rows.append(row)
            if not options.json:
                one = f"one after {row['together_s']:.0f} s" if row["together_s"] is not None else "not one"
                print(
                    f"seed {seed}: {one}, {row['components']} components after {row['simulated_s']:.0f} s; "
                    f"never more than {100 * row['misplaced_m']:.1f} cm off; covered {100 * row['covered']:.0f} %",
                    flush=True,
                )
    if options.json:
        print(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
