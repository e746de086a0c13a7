"""A grid without its specks, as the vectorizer sees it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.checks import check_count
from fleetmap.model.grid import OccupancyGrid
from fleetmap.vectorize.fresh import APART_CELLS, read_grid
from fleetmap.vectorize.store import Store

SPECK_CELLS = 12
"""Free and unknown specks of at most so many cells are dropped by default: with noise they are most of a map."""

MAX_SPECK_CELLS = 10_000


def check_specks(specks: int) -> int:
    """The largest size of a speck; ConfigError if that can't be one."""
    return check_count("specks", specks, most=MAX_SPECK_CELLS, unit=" cells")


def drop_specks(grid: OccupancyGrid, specks: int = SPECK_CELLS) -> OccupancyGrid:
    """A grid of three states (100, 0 and -1) in which free and unknown specks of at most so many cells are filled.

    It holds what a vector map of ``grid`` stands for, so that both can be compared fairly. A speck becomes what is
    most around it; occupied cells all stay, and so does a free speck far from other free space.

    Raises
    ------
    ConfigError : ``specks`` is out of its range
    """
    from fleetmap.vectorize.speck_kernels import fill_specks

    check_specks(specks)
    store = Store((0, 0), (grid.height, grid.width), 0.0)
    corners, count = read_grid(grid, store, (0, 0))
    fill_specks(store.states, store.cracks, store.seen, corners, count, specks, APART_CELLS, *store.low_yx)
    y, x = -store.low_yx[0], -store.low_yx[1]
    states: NDArray[np.uint8] = store.states[y : y + grid.height, x : x + grid.width].copy()
    return OccupancyGrid.from_states(states, grid.resolution_m, grid.origin)
