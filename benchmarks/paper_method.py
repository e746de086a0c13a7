"""What comes of the paper's own vectorization: edges, uncovered cells, stray edges, time, and whether it is valid.

Runs the three readings of ``fleetmap.vectorize.paper_method`` over the maps in ``FLEETMAP_DATA``, if that is set,
and over generated worlds of 80 m (1600 x 1600 cells); and ``vectorize`` beside them, for size and time.

    FLEETMAP_DATA=... python benchmarks/paper_method.py [--json]

The distances are measured here by shapely and a KD-tree, and share nothing with the method or the verifier:
from the centre of each occupied cell to the nearest edge, and from points of the edges, 1/16 cell apart, to the
nearest occupied centre (so that they are short of the largest by at most 1/32 cell). ``--tiny`` is for the tests.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import statistics
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import numba
import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.ndimage import label, maximum_filter
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from fleetmap.model.errors import MapWarning
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import EPSILON_CELLS, FREE, OCCUPIED
from fleetmap.model.map_server import load_map
from fleetmap.model.vectormap import VectorMap
from fleetmap.sims.worlds import make_world
from fleetmap.vectorize import vectorize, verify
from fleetmap.vectorize.paper_method import vectorize_by_paper

RUNS = 5
SAMPLE_CELLS = 1 / 16
METHODS = (("B", "occupied"), ("C", "occupied"), ("mended", "occupied"), ("mended", "surface"))


def grids(tiny: bool) -> Iterator[tuple[str, OccupancyGrid]]:
    """The maps to run on, with their names."""
    folder = os.environ.get("FLEETMAP_DATA")
    for path in sorted(Path(folder).glob("maps/*/map.yaml")) if folder and not tiny else []:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MapWarning)
            yield path.parent.name, load_map(path)
    size_m = 10.0 if tiny else 80.0
    for kind in ("office",) if tiny else ("office", "maze", "unstructured"):
        world = make_world(kind, size_m=size_m, seed=1)
        states = np.where(world.solid, OCCUPIED, FREE).astype(np.uint8)
        yield f"{kind}, {size_m:.0f} m", OccupancyGrid.from_states(states, world.resolution_m, world.origin)


def measure(grid: OccupancyGrid, found: VectorMap, cells: str) -> dict[str, object]:
    """Both constraints of the paper, measured over the cells that the graph was made of; lengths in cells."""
    states = grid.states_yx()
    chosen = states == OCCUPIED
    if cells == "surface":
        chosen &= maximum_filter((states == FREE).view(np.uint8), 3) > 0
    centres = np.argwhere(chosen).astype(np.float64)
    lines = found.edges[:, :4].astype(np.float64).reshape(-1, 2, 2)
    if len(lines) == 0 or len(centres) == 0:
        nothing = {"farthest_cell": math.nan, "farthest_point": math.nan, "pieces_of_cells": 0, "pieces": 0}
        return {"uncovered": float(len(centres) > 0), **nothing}
    tree = shapely.STRtree(shapely.linestrings(lines))
    _, distances = tree.query_nearest(shapely.points(centres), return_distance=True, all_matches=False)
    _, pieces_of_cells = label(chosen, np.ones((3, 3)))
    return {
        "uncovered": float((distances > found.epsilon_cells + 1e-9).mean()),
        "farthest_cell": float(distances.max()),
        "farthest_point": float(KDTree(centres).query(sample(lines), workers=-1)[0].max()),
        "pieces_of_cells": int(pieces_of_cells),
        "pieces": count_pieces(found),
    }


def sample(lines: NDArray[np.float64]) -> NDArray[np.float64]:
    """(m, 2) points along lines (n, 2, 2), ends among them, at most ``SAMPLE_CELLS`` apart."""
    steps = np.ceil(np.hypot(*(lines[:, 1] - lines[:, 0]).T) / SAMPLE_CELLS).astype(np.int64)
    line = np.repeat(np.arange(len(lines)), steps + 1)
    step = np.arange(len(line)) - np.repeat(np.cumsum(steps + 1) - (steps + 1), steps + 1)
    share = (step / steps[line])[:, None]
    points: NDArray[np.float64] = lines[line, 0] * (1 - share) + lines[line, 1] * share
    return points


def count_pieces(found: VectorMap) -> int:
    """How many connected pieces the graph has."""
    vertices, ends = np.unique(found.edges[:, :4].reshape(-1, 2), axis=0, return_inverse=True)
    a, b = ends.reshape(-1, 2).T
    graph = coo_array((np.ones(len(a), bool), (a, b)), shape=(len(vertices), len(vertices)))
    return int(connected_components(graph, directed=False)[0])


def timed(make: Callable[[], VectorMap], runs: int) -> tuple[VectorMap, float]:
    """The result, and the median of its times in milliseconds."""
    times = []
    for _ in range(runs):
        started = time.perf_counter()
        found = make()
        times.append((time.perf_counter() - started) * 1e3)
    return found, statistics.median(times)


def run(name: str, grid: OccupancyGrid, runs: int) -> Iterator[dict[str, object]]:
    """One row for each method."""
    states = grid.states_yx()
    here = {"map": name, "height": grid.height, "width": grid.width, "occupied": int((states == OCCUPIED).sum())}
    for reading, cells in METHODS:
        found, ms = timed(lambda r=reading, c=cells: vectorize_by_paper(grid, reading=r, cells=c), runs)
        started = time.perf_counter()
        report = verify(grid, found, points="centres", specks=0)
        verify_ms = (time.perf_counter() - started) * 1e3
        row = {**here, "method": f"{reading}, {cells}", "edges": len(found), "ms": ms, "verify_ms": verify_ms}
        yield {**row, **measure(grid, found, cells), "violations": Counter(v.kind for v in report.violations)}
    found, ms = timed(lambda: vectorize(grid), runs)
    yield {**here, "method": "boundary", "edges": int(found.obstacle.sum()), "ms": ms}


def as_text(rows: list[dict[str, object]]) -> str:
    """One line of the Markdown table: all methods on one map."""
    cells = [str(rows[0]["map"]), str(rows[0]["occupied"])]
    for row in rows[:-1]:
        shares = f"{100 * row['uncovered']:.1f} %, {row['farthest_cell']:.2f}, {row['farthest_point']:.2f}"
        cells.append(f"{row['edges']} in {row['pieces']}; {shares}")
    beyond = {kind: count for kind, count in rows[-2]["violations"].items() if count}
    cells.append(", ".join(f"{count} {kind}" for kind, count in sorted(beyond.items())) or "none")
    cells += [str(rows[-1]["edges"]), " / ".join(f"{row['ms']:.1f}" for row in rows)]
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tiny", action="store_true", help="one world of 10 m, once")
    parser.add_argument("--json", action="store_true", help="one JSON document instead of the table")
    options = parser.parse_args()
    vectorize_by_paper(OccupancyGrid(np.zeros((3, 3), np.int8), 0.05))  # loads the kernels
    vectorize(OccupancyGrid(np.zeros((3, 3), np.int8), 0.05))
    conditions = {
        "epsilon_cells": EPSILON_CELLS,
        "runs": 1 if options.tiny else RUNS,
        "machine": f"{platform.machine()}, {os.cpu_count()} cores",
        "python": platform.python_version(),
        "numpy": np.__version__,
        "numba": numba.__version__,
        "real_maps": "FLEETMAP_DATA" in os.environ and not options.tiny,
    }
    if not options.json:
        print(", ".join(f"{key} {value}" for key, value in conditions.items()))
        methods = [f"{reading}, {cells}" for reading, cells in METHODS]
        print("\nEdges in connected pieces; share of cells uncovered, farthest cell, farthest point, both in cells.\n")
        print(f"| map | occupied | {' | '.join(methods)} | verify of the last | boundary, edges | ms |")
        print("|---" * (len(methods) + 5) + "|")
    rows = []
    for name, grid in grids(options.tiny):
        here = list(run(name, grid, 1 if options.tiny else RUNS))
        rows += here
        if not options.json:
            print(as_text(here), flush=True)
    if options.json:
        finite = [{k: None if isinstance(v, float) and math.isnan(v) else v for k, v in row.items()} for row in rows]
        print(json.dumps({"conditions": conditions, "rows": finite}, indent=2))


if __name__ == "__main__":
    main()
