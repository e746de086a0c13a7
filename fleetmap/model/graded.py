"""Warnings about graded grids, whose cells have values between free (0) and occupied (100)."""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.errors import MapWarning
from fleetmap.model.grid import OccupancyGrid

FEWEST_KNOWN_CELLS = 50
"""A grid with fewer known cells tells nothing about its thresholds."""

HARDLY_ANY = 0.01
"""A share below this is hardly any. (Maps of open ground have less than 1 % of walls: these are compared with the
cells between the thresholds alone.)"""

CHUNK_CELLS = 1 << 20


def is_graded(grid: OccupancyGrid) -> bool:
    """Whether any cell has a value between 0 and 100; 0.2 ms a million cells, where counting them takes 2."""
    return bool((grid.cells_yx.view(np.uint8) - np.uint8(1) < 99).any())


def count_values(grid: OccupancyGrid) -> NDArray[np.int64]:
    """(101,) how many cells have each value from 0 to 100; the rest of the grid is unknown."""
    flat = grid.cells_yx.view(np.uint8).ravel()
    counts = np.zeros(256, np.int64)
    for start in range(0, flat.size, CHUNK_CELLS):  # bincount makes eight bytes of each cell
        counts += np.bincount(flat[start : start + CHUNK_CELLS], minlength=256)
    return counts[:101]


def warn_of_thresholds(grid: OccupancyGrid, *, stacklevel: int = 2) -> bool:
    """Warn with ``MapWarning`` if a graded grid has hardly any cell that counts as free, or as occupied.

    Returns
    -------
    bool : whether it warned; of a grid with too few known cells nothing can be told
    """
    if not is_graded(grid):
        return False
    counts = count_values(grid)
    known = int(counts.sum())
    if known < FEWEST_KNOWN_CELLS:
        return False
    most_free, least_occupied = grid.limits
    free, occupied = int(counts[: most_free + 1].sum()), int(counts[least_occupied:].sum())
    between = known - free - occupied
    if free < HARDLY_ANY * known or occupied == 0 or occupied < HARDLY_ANY * between:
        values = np.flatnonzero(counts)
        warnings.warn(
            f"of {known} known cells, whose values go from {values[0]} to {values[-1]}, {free} count as free (below "
            f"{grid.free_below:g}) and {occupied} as occupied (above {grid.occupied_above:g}); {between} between them "
            "count as unknown. Set free_below and occupied_above to what this map's free cells and walls have; "
            "a mask of walls is an array of bools",
            MapWarning,
            stacklevel=stacklevel + 1,
        )
        return True
    return False


def warn_of_lost_values(grid: OccupancyGrid, keeper: str, *, stacklevel: int = 2) -> bool:
    """Warn with ``MapWarning``, and return True, if a grid has values that ``keeper``, which holds states, loses."""
    if not is_graded(grid):
        return False
    counts = count_values(grid)
    warnings.warn(
        f"{counts[1:100].sum()} of {counts.sum()} known cells have values between 0 and 100; {keeper} holds which "
        "cells are free, occupied and unknown, and not these values",
        MapWarning,
        stacklevel=stacklevel + 1,
    )
    return True
