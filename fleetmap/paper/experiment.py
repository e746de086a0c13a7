"""One of the nine experiments: a terrain surveyed, its three maps scored, and their bytes counted."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.vectormap import VectorMap
from fleetmap.paper.formats import grid_sizes, vector_sizes
from fleetmap.paper.properties import measure_properties
from fleetmap.paper.scores import difference, score
from fleetmap.paper.survey import Survey, survey_terrain
from fleetmap.paper.terrains import Terrain
from fleetmap.paper.vectors import PROFILES, make_vector_map


@dataclass(frozen=True, slots=True)
class Experiment:
    """What one experiment leaves.

    Parameters
    ----------
    terrain, survey : where it was, and what was seen there
    from_grid, from_truth : by profile, the vector maps made of the grid and of the truth
    row : all its numbers, as in the JSON document
    """

    terrain: Terrain
    survey: Survey
    from_grid: dict[str, VectorMap]
    from_truth: dict[str, VectorMap]
    row: dict[str, Any]


def run_experiment(terrain: Terrain) -> Experiment:
    """Run one; the same terrain gives the same numbers."""
    survey = survey_terrain(terrain)
    grid, truth = survey.grid, survey.truth
    from_grid = {profile: make_vector_map(grid, profile) for profile in PROFILES}
    from_truth = {profile: make_vector_map(truth, profile) for profile in PROFILES}
    properties = measure_properties(grid)
    grid_scores = score(grid, truth)
    vector_scores = {profile: score(vector_map, truth) for profile, vector_map in from_grid.items()}
    row = {
        "terrain": terrain.kind,
        "size_m": terrain.size_m,
        "seed": terrain.seed,
        **extent(grid),
        "survey": {
            "scans": len(survey.tour.places_xy),
            "travelled_m": float(survey.tour.travelled_m[-1]),
            "seen_percent": 100 * survey.seen,
        },
        "properties": {**asdict(properties), "as_wanted": properties.hold()},
        "scores": {
            "grid": grid_scores,
            "vector_from_grid": vector_scores,
            "vector_from_truth": {profile: score(found, truth) for profile, found in from_truth.items()},
        },
        "vector_minus_grid": {profile: difference(found, grid_scores) for profile, found in vector_scores.items()},
        "vector_against_grid": {profile: score(found, grid) for profile, found in from_grid.items()},
        "edges": {
            "vector_from_grid": {profile: len(found) for profile, found in from_grid.items()},
            "vector_from_truth": {profile: len(found) for profile, found in from_truth.items()},
        },
        "sizes": {
            "grid": grid_sizes(grid),
            "truth": grid_sizes(truth),
            "vector_from_grid": {profile: vector_sizes(found) for profile, found in from_grid.items()},
            "vector_from_truth": {profile: vector_sizes(found) for profile, found in from_truth.items()},
        },
    }
    return Experiment(terrain, survey, from_grid, from_truth, row)


def extent(grid: OccupancyGrid) -> dict[str, Any]:
    """The grid's cells, for a row."""
    return {"width": grid.width, "height": grid.height, "resolution_m": grid.resolution_m}
