"""The same table on maps of real buildings: there is no truth, so a vector map is scored against its grid only."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from fleetmap.model.errors import ConfigError
from fleetmap.model.map_server import load_map
from fleetmap.paper.experiment import extent
from fleetmap.paper.formats import grid_sizes, vector_sizes
from fleetmap.paper.properties import measure_properties
from fleetmap.paper.scores import score
from fleetmap.paper.vectors import PROFILES, make_vector_map


def find_maps(folder: Path) -> list[Path]:
    """All files called ``map.yaml`` in the folder and below it, in order.

    Raises
    ------
    ConfigError : there is none
    """
    found = sorted(folder.rglob("map.yaml"))
    if not found:
        what = "has no map.yaml in it or below" if folder.is_dir() else "is no folder"
        raise ConfigError(option="maps", value=str(folder), reason=f"{what}; expected DIR/**/map.yaml")
    return found


def run_real_map(path: Path, folder: Path) -> dict[str, Any]:
    """One row.

    Raises
    ------
    MapFormatError : the map can't be read
    """
    grid = load_map(path)
    vector_maps = {profile: make_vector_map(grid, profile) for profile in PROFILES}
    return {
        "map": (path.parent.relative_to(folder) if path.parent != folder else Path(folder.resolve().name)).as_posix(),
        **extent(grid),
        "properties": asdict(measure_properties(grid)),
        "vector_against_grid": {profile: score(found, grid) for profile, found in vector_maps.items()},
        "edges": {profile: len(found) for profile, found in vector_maps.items()},
        "sizes": {
            "grid": grid_sizes(grid),
            "vector_from_grid": {profile: vector_sizes(found) for profile, found in vector_maps.items()},
        },
    }
