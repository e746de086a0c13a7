"""The vector maps that are scored: one place that says in which profiles."""

from __future__ import annotations

from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.vectormap import VectorMap

PROFILES = ("share", "full")
"""``share``: the boundary of free space, as robots exchange it; ``full``: all boundaries between the three states."""


def make_vector_map(grid: OccupancyGrid, profile: str) -> VectorMap:
    """Vectorize a grid in one profile, with the default epsilon of sqrt(2) cells and the default specks dropped."""
    from fleetmap.vectorize import vectorize

    return vectorize(grid, profile=profile)
