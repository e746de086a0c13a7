"""What does a map take? Snapshots and the exact layer beside the codecs of others, in bytes and in time.

The paper's nine terrains as a robot maps them, and real maps, never mixed in one median. The rows are those of
``fleetmap stats``; here are the figures that sum them up, for each map and in the median:

- share, specks: gzip -9 of the grid by a snapshot of the profile share, specks dropped (12 cells) and kept
- B/edge: bytes of that snapshot by its edges; same: the exact layer of the grid that is drawn of it, by the snapshot
- zip: the zipped PGM by the snapshot, as in the paper
- exact: gzip -9 by the exact layer, and JPEG XL on effort 9 by it
- enc, dec: CPU time of gzip -6 of the grid by that of the snapshot, and of gunzip

    python benchmarks/codec.py [--maps MAP.yaml...] [--json]
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

from fleetmap.cli.map_stats import measure_map
from fleetmap.model.errors import MapWarning
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.map_server import load_map
from fleetmap.paper.formats import grid_sizes
from fleetmap.paper.survey import survey_terrain
from fleetmap.paper.terrains import SIZES_M, choose_terrains

COLUMNS = ("edges", "bytes", "share", "specks", "B/edge", "same", "zip", "exact", "exact/jxl", "enc", "dec")


def sum_up(name: str, grid: OccupancyGrid) -> dict[str, Any]:
    """One map."""
    document = measure_map(Path(name), grid)
    rows = {row["codec"]: row for row in document["rows"]}
    own, size = rows["vector"], document["codecs"]["vector"]
    jpeg_xl = document["codecs"].get("jpeg_xl")
    return {
        "map": name,
        "edges": document["edges"]["vector"],
        "bytes": size,
        "share": document["ratios"]["vector"],
        "specks": document["ratios"]["vector_specks"],
        "B/edge": size / max(document["edges"]["vector"], 1),
        "same": document["ratios_same_content"]["vector"],
        "zip": grid_sizes(grid)["pgm_zip"] / size,
        "exact": document["ratios"]["exact"],
        "exact/jxl": float("nan") if jpeg_xl is None else jpeg_xl / document["codecs"]["exact"],
        "enc": rows["gzip6"]["encode_ms"] / own["encode_ms"],
        "dec": rows["gzip6"]["decode_ms"] / own["decode_ms"],
    }


def inputs(options: argparse.Namespace) -> Iterator[tuple[str, str, OccupancyGrid]]:
    """Group, name and grid of each map."""
    for terrain in choose_terrains((10,) if options.tiny else SIZES_M):
        yield "terrains", terrain.name, survey_terrain(terrain).grid
        if options.tiny:
            return
    paths = options.maps
    if not paths and (folder := os.environ.get("FLEETMAP_DATA")):
        paths = sorted(Path(folder).glob("maps/*/map.yaml"))
    for path in paths:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MapWarning)
            yield "real maps", path.parent.name, load_map(path)


def line(name: str, row: dict[str, Any]) -> str:
    """One row of the table."""
    cells = [f"{row[c]:.0f}" if c in ("edges", "bytes") else f"{row[c]:.2f}" for c in COLUMNS]
    return f"{name:26s}" + "".join(f"{cell:>10s}" for cell in cells)


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--maps", nargs="*", type=Path, default=[], help="map_server maps instead of FLEETMAP_DATA's")
    parser.add_argument("--json", action="store_true", help="one document instead of a table")
    parser.add_argument("--tiny", action="store_true", help="one terrain of 10 m: for the tests")
    options = parser.parse_args()
    groups: dict[str, list[dict[str, Any]]] = {}
    if not options.json:
        print(f"{'':26s}" + "".join(f"{column:>10s}" for column in COLUMNS))
    for group, name, grid in inputs(options):
        row = sum_up(name, grid)
        groups.setdefault(group, []).append(row)
        if not options.json:
            print(line(name, row), flush=True)
    medians = {g: {c: float(np.median([row[c] for row in rows])) for c in COLUMNS} for g, rows in groups.items()}
    if options.json:
        json.dump({"epsilon_cells": 2**0.5, "groups": groups, "medians": medians}, sys.stdout)
        return
    for group, row in medians.items():
        print(line(f"median of {len(groups[group])} {group}", row))
        worst = {c: float(min(r[c] for r in groups[group])) for c in COLUMNS}
        print(line(f"least of {len(groups[group])} {group}", worst))


if __name__ == "__main__":
    main()
