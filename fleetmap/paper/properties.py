"""How ragged a grid is: three figures that tell a SLAM's grid from a drawing, so that nobody scores the latter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import FREE, UNKNOWN

SPECK_CELLS = 12
"""Free 4-connected components of at most so many cells are specks."""

LONGEST_SKIN = 1000

WANTED = {"corners_per_crack": (0.25, 0.35), "skin_median_cells": (1.0, 3.0), "free_specks_percent": (0.05, 1.0)}
"""What the nine grids hold. Measured on 21 grids of real buildings: 0.10 to 0.58, 1 to 2 cells, 0 to 1.7 per cent."""


@dataclass(frozen=True, slots=True)
class Properties:
    """What was measured of a grid.

    Parameters
    ----------
    cracks : sides between two cells of different state, of the three; outside of the grid is unknown
    corners_per_crack : lattice points where exactly two cracks meet and turn, per crack
    skin_median_cells, skin_p10_cells, skin_p90_cells : occupied cells in a row behind the free side of a crack,
        along its normal
    free_specks, free_specks_percent : how many, and their cells in per cent of all cells
    """

    cracks: int
    corners_per_crack: float
    skin_p10_cells: float
    skin_median_cells: float
    skin_p90_cells: float
    free_specks: int
    free_specks_percent: float

    def hold(self) -> bool:
        """Whether all three are as ``WANTED``."""
        return all(low <= getattr(self, name) <= high for name, (low, high) in WANTED.items())


def measure_properties(grid: OccupancyGrid) -> Properties:
    """Measure a grid."""
    states = grid.states_yx()
    cracks, corners = count_cracks(states)
    p10, median, p90 = skin_quantiles(states, (0.1, 0.5, 0.9))
    specks, speck_cells = count_specks(states)
    return Properties(
        cracks=cracks,
        corners_per_crack=corners / cracks if cracks else 0.0,
        skin_p10_cells=p10,
        skin_median_cells=median,
        skin_p90_cells=p90,
        free_specks=specks,
        free_specks_percent=100 * speck_cells / states.size,
    )


def count_cracks(states: NDArray[np.uint8]) -> tuple[int, int]:
    """How many cracks there are, and how many lattice points of degree 2 where they turn."""
    padded = np.pad(states, 1, constant_values=UNKNOWN)
    upright = padded[:, 1:] != padded[:, :-1]
    level = padded[1:] != padded[:-1]
    # Around each inner lattice point of the padded grid: below, above, left and right of it.
    below, above, left, right = upright[:-1], upright[1:], level[:, :-1], level[:, 1:]
    degree = below.astype(np.uint8) + above + left + right
    turns = (degree == 2) & (below != above)
    return int(upright.sum() + level.sum()), int(turns.sum())


def skin_quantiles(states: NDArray[np.uint8], shares: tuple[float, ...]) -> list[float]:
    """Thicknesses in cells that these shares of the cracks do not exceed; 0 without obstacles."""
    from fleetmap.paper.properties_kernels import skin_counts

    below = np.cumsum(skin_counts(np.ascontiguousarray(states), LONGEST_SKIN))
    return [float(np.searchsorted(below, share * below[-1])) if below[-1] else 0.0 for share in shares]


def count_specks(states: NDArray[np.uint8]) -> tuple[int, int]:
    """How many free specks there are, and how many cells they have together."""
    from scipy import ndimage

    labels, _ = ndimage.label(states == FREE)
    sizes = np.bincount(labels.ravel())[1:]
    small = sizes <= SPECK_CELLS
    return int(small.sum()), int(sizes[small].sum())
