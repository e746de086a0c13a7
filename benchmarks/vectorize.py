"""How many edges, how fast, how near, how like: ``vectorize`` beside OpenCV, scikit-image and GEOS.

All run in one process, one after the other, again and again; times are medians of CPU time (``time.process_time``),
on one thread. Inputs are the terrains of 80 m (1600 x 1600 cells) that ``fleetmap.paper`` has a robot map, and, if
``FLEETMAP_DATA`` names them, real maps; these two are never mixed in one median.

    python benchmarks/vectorize.py [--maps MAP.yaml...] [--json]

Ours gets the grid as it is, and drops specks of at most 12 cells. The others get the planes of the grid without these
specks, made beforehand. Epsilon is sqrt(2) cells, but for ``exact``. Columns:

- edges; ms; ratio of the time to that of OpenCV on the free and the occupied plane
- cover, stray: the largest distance, in cells, from the boundary to the polylines and back, measured by GEOS at points
  half or a quarter of a cell apart (so they are short of the truth by at most half of that)
- MS to UPDF: what comes of drawing it, against the grid (see ``fleetmap.model.metrics``)
- min-#, lines: the edges in ratio to the fewest with vertices on the boundary, and to a lower bound for any vertices
  (see ``vectorize_oracles``); of ``share`` those of free space alone
- bad: violations that ``verify`` finds
"""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import statistics
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from vectorize_oracles import Arc, fewest_edges, fewest_lines, trace

from fleetmap.model.errors import MapWarning
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN
from fleetmap.model.map_server import load_map
from fleetmap.model.metrics import compare
from fleetmap.model.vectormap import VectorMap
from fleetmap.paper.survey import survey_terrain
from fleetmap.paper.terrains import choose_terrains
from fleetmap.vectorize import drop_specks, rasterize, vectorize, verify

try:
    import cv2
    import skimage
except ImportError:  # pip install fleetmap[bench]
    cv2 = skimage = None

EPSILON = math.sqrt(2)
EPSILON2 = {"share": 512, "full": 512, "exact": 63}
"""Squared, in 256ths, for the oracles."""

REFERENCE = "OpenCV free + occupied"
Polylines = list[NDArray[np.float64]]
"""(n, 2) points (y, x) in cells, the first one repeated where it is closed."""


@dataclass
class Drawing:
    """What a method makes: its edges, which boundary they stand for, and how to make a grid of it."""

    lines: Polylines
    boundary: str
    states: NDArray[np.uint8] | None = None
    vector_map: VectorMap | None = None
    profile: str | None = None

    @property
    def edges(self) -> int:
        """Number of edges; what is a point or goes back and forth has none or one."""
        return sum(len(line) - 1 if len(line) != 3 or (line[0] != line[2]).any() else 1 for line in self.lines)


def terrain(kind: str, size_m: int) -> OccupancyGrid:
    """The grid that a robot maps of one of the paper's terrains; see ``fleetmap.paper``."""
    return next(survey_terrain(t).grid for t in choose_terrains((size_m,)) if t.kind == kind)


# --- the methods: each has what is timed, and what makes a drawing of its result

Method = tuple[Callable[[], Any], Callable[[Any], Drawing]]


def ours(grid: OccupancyGrid, profile: str) -> Method:
    """``vectorize`` in one profile."""

    def draw(vector_map: VectorMap) -> Drawing:
        lines = list(vector_map.edges[:, :4].reshape(-1, 2, 2).astype(np.float64))
        states = rasterize(vector_map, like=grid).states_yx()
        return Drawing(lines, "free" if profile == "share" else "all", states, vector_map, profile)

    return lambda: vectorize(grid, profile=profile), draw


def opencv(planes: dict[int, NDArray[np.uint8]], boundary: str) -> Method:
    """``findContours`` + ``approxPolyDP`` on one plane or more; SIMPLE, since it is faster and gives the same."""

    def run() -> dict[int, tuple[list[NDArray[np.int32]], Any]]:
        found = {}
        for state, plane in planes.items():
            contours, hierarchy = cv2.findContours(plane, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
            found[state] = ([cv2.approxPolyDP(contour, EPSILON, True) for contour in contours], hierarchy)
        return found

    def draw(found: dict[int, tuple[list[NDArray[np.int32]], Any]]) -> Drawing:
        states = np.full(next(iter(planes.values())).shape, UNKNOWN, np.uint8)
        lines: Polylines = []
        for state, (polygons, hierarchy) in found.items():
            mask = np.zeros_like(states)
            cv2.drawContours(mask, polygons, -1, 1, cv2.FILLED, hierarchy=hierarchy)
            states[mask == 1] = state
            # Their points are the centres of cells.
            lines += [np.concatenate([p[:, 0], p[:1, 0]])[:, ::-1] + 0.5 for p in polygons]
        return Drawing(lines, boundary, states)

    return run, draw


def scikit_image(planes: dict[int, NDArray[np.uint8]]) -> Method:
    """``find_contours`` + ``approximate_polygon``, which go between the centres of cells."""

    def run() -> dict[int, Polylines]:
        return {
            state: [
                skimage.measure.approximate_polygon(line, EPSILON)
                for line in skimage.measure.find_contours(np.pad(plane, 1), 0.5)
            ]
            for state, plane in planes.items()
        }

    def draw(found: dict[int, Polylines]) -> Drawing:
        states = np.full(planes[FREE].shape, UNKNOWN, np.uint8)
        for state, lines in found.items():
            mask = np.zeros_like(states)
            cv2.fillPoly(mask, [np.rint((line[:, ::-1] - 1) * 256).astype(np.int32) for line in lines], 1, shift=8)
            states[mask == 1] = state
        return Drawing([line - 0.5 for lines in found.values() for line in lines], "all", states)

    return run, draw


def geos(arcs: list[Arc]) -> Method:
    """``shapely.simplify`` of the arcs between all three states; they are given."""
    lines = shapely.linestrings(
        np.concatenate([points_of(arc) for arc in arcs]), indices=np.repeat(np.arange(len(arcs)), lengths_of(arcs))
    )
    return (
        lambda: shapely.simplify(lines, EPSILON, preserve_topology=False),
        lambda found: Drawing([shapely.get_coordinates(line) for line in found], "all"),
    )


def points_of(arc: Arc) -> NDArray[np.float64]:
    """The points of an arc, the first one once more if it is closed."""
    return np.concatenate([arc.points, arc.points[:1]] if arc.closed else [arc.points]).astype(np.float64)


def lengths_of(arcs: list[Arc]) -> list[int]:
    """How many points each has."""
    return [len(arc.points) + arc.closed for arc in arcs]


# --- what is measured


def farthest(lines: Polylines, others: Polylines, step: float) -> float:
    """The largest distance from points of some lines, at most a step apart, to the nearest of the others."""
    if not lines or not others:
        return math.nan
    segments = np.concatenate([np.concatenate([line[:-1], line[1:]], axis=1) for line in lines])
    pieces = np.maximum(np.ceil(np.abs(segments[:, 2:] - segments[:, :2]).max(axis=1) / step), 1).astype(int)
    which = np.repeat(np.arange(len(segments)), pieces + 1)
    k = np.arange(len(which)) - np.repeat(np.cumsum(pieces + 1) - pieces - 1, pieces + 1)
    points = segments[which, :2] + (k / pieces[which])[:, None] * (segments[which, 2:] - segments[which, :2])
    pairs = np.concatenate([np.stack([line[:-1], line[1:]], axis=1) for line in others])
    tree = shapely.STRtree(shapely.linestrings(pairs))
    _, distance = tree.query_nearest(shapely.points(points), return_distance=True, all_matches=False)
    return float(distance.max())


def measure(name: str, grid: OccupancyGrid, repeats: int) -> dict[str, Any]:
    """All rows of one input."""
    filled = drop_specks(grid).states_yx()
    planes = {state: (filled == state).astype(np.uint8) for state in (FREE, OCCUPIED)}
    arcs = {profile: trace(filled if profile != "exact" else grid.states_yx(), profile) for profile in EPSILON2}
    methods: dict[str, Method] = {
        **{f"ours, {profile}": ours(grid, profile) for profile in EPSILON2},
        "GEOS simplify, given the arcs": geos(arcs["full"]),
    }
    if cv2 is not None:
        methods |= {
            "OpenCV free": opencv({FREE: planes[FREE]}, "free"),
            "OpenCV occupied": opencv({OCCUPIED: planes[OCCUPIED]}, "occupied"),
            REFERENCE: opencv(planes, "all"),
            "scikit-image free + occupied": scikit_image(planes),
        }
    times: dict[str, list[float]] = {method: [] for method in methods}
    results = {method: run() for method, (run, _) in methods.items()}
    for repeat in range(repeats):
        for method, (run, _) in methods.items():
            if repeat >= 3 and method.startswith("scikit"):
                continue
            started = time.process_time()
            run()
            times[method].append((time.process_time() - started) * 1e3)

    inverse = np.where(filled == OCCUPIED, FREE, UNKNOWN).astype(np.uint8)
    boundary = {"free": arcs["share"], "all": arcs["full"], "occupied": trace(inverse, "share")}
    lines = {kind: [points_of(arc) for arc in found] for kind, found in boundary.items()}
    lines["exact"] = [points_of(arc) for arc in arcs["exact"]]
    rows = []
    for method, (_, draw) in methods.items():
        drawing = draw(results[method])
        covered = "exact" if drawing.profile == "exact" else drawing.boundary
        row: dict[str, Any] = {"method": method, "edges": drawing.edges, "ms": statistics.median(times[method])}
        row["ratio"] = row["ms"] / statistics.median(times.get(REFERENCE, [math.nan]))
        row["cover"] = farthest(lines[covered], drawing.lines, 0.5)
        near = "all" if drawing.profile == "share" else covered  # it outlines obstacles out of sight
        row["stray"] = farthest(drawing.lines, lines[near], 0.25)
        if drawing.states is not None:
            scores = compare(OccupancyGrid.from_states(drawing.states, grid.resolution_m, grid.origin), grid)
            row |= {key: getattr(scores, key) for key in ("MS", "CC", "PC", "OPDF", "UPDF")}
        if drawing.vector_map is not None and drawing.profile is not None:
            of_free = drawing.vector_map.obstacle | drawing.vector_map.frontier
            count = int(of_free.sum()) if drawing.profile == "share" else drawing.edges
            for key, oracle in (("min-#", fewest_edges), ("lines", fewest_lines)):
                least = sum(oracle(arc, EPSILON2[drawing.profile]) for arc in arcs[drawing.profile])
                row[key] = count / max(least, 1)
                row[f"{key} edges"] = least
            row["bad"] = len(verify(grid, drawing.vector_map).violations)
        rows.append(row)
    return {"input": name, "cells": [grid.height, grid.width], "rows": rows}


# --- the script

COLUMNS = ("edges", "ms", "ratio", "cover", "stray", "MS", "CC", "PC", "OPDF", "UPDF", "min-#", "lines", "bad")


def print_table(title: str, rows: list[dict[str, Any]]) -> None:
    """One line a method."""
    print(f"\n{title}\n{'':30s}" + "".join(f"{column:>9s}" for column in COLUMNS))
    for row in rows:
        cells = [row.get(column, math.nan) for column in COLUMNS]
        texts = ["" if v != v else str(v) if isinstance(v, int) else f"{v:.2f}" for v in cells]
        print(f"{row['method']:30s}" + "".join(f"{text:>9s}" for text in texts), flush=True)


def medians(measured: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """One row a method: the median of each column over inputs."""
    result = []
    for rows in zip(*(m["rows"] for m in measured), strict=True):
        columns = [column for column in rows[0] if column != "method"]
        result.append({"method": rows[0]["method"], **{c: float(np.median([r[c] for r in rows])) for c in columns}})
    return result


def inputs(options: argparse.Namespace) -> Iterator[tuple[str, str, OccupancyGrid]]:
    """Group, name and grid of each input."""
    for kind in ("maze", "office", "unstructured"):
        yield "generated", kind, terrain(kind, 10 if options.tiny else 80)
    paths = options.maps
    if not paths and not options.tiny and (folder := os.environ.get("FLEETMAP_DATA")):
        paths = sorted(Path(folder).glob("maps/*/map.yaml"))
    for path in paths:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MapWarning)
            yield "real", path.parent.name, load_map(path)


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--maps", nargs="*", type=Path, default=[], help="map_server maps instead of FLEETMAP_DATA's")
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--json", action="store_true", help="one document instead of tables")
    parser.add_argument("--tiny", action="store_true", help="terrains of 10 m, once: for the tests")
    options = parser.parse_args()
    if cv2 is None:
        print("OpenCV and scikit-image are missing: pip install fleetmap[bench]", file=sys.stderr)
    else:
        cv2.setNumThreads(1)
    groups: dict[str, list[dict[str, Any]]] = {}
    for group, name, grid in inputs(options):
        measured = measure(name, grid, 1 if options.tiny else options.repeats)
        groups.setdefault(group, []).append(measured)
        if not options.json:
            print_table(f"{group}: {name}, {grid.height} x {grid.width} cells", measured["rows"])
    versions = {"python": platform.python_version(), "numpy": np.__version__}
    versions |= {"shapely": shapely.__version__, "geos": shapely.geos_version_string}
    if cv2 is not None:
        versions |= {"opencv": cv2.__version__, "scikit-image": skimage.__version__}
    conditions = {
        "clock": "process_time",
        "threads": 1,
        "repeats": options.repeats,
        "epsilon_cells": EPSILON,
    } | versions
    summary = {group: medians(measured) for group, measured in groups.items()}
    if options.json:
        json.dump({"conditions": conditions, "groups": groups, "medians": summary}, sys.stdout)
        return
    for group, rows in summary.items():
        print_table(f"{group}: medians of {len(groups[group])} inputs", rows)
    if "real" not in groups and not options.tiny:
        print("\nno real maps: FLEETMAP_DATA is not set")
    print(f"\n{conditions}")


if __name__ == "__main__":
    main()
