"""Where the robot drives: past one place in each square of a coarse raster, always to the nearest one next."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.errors import ConfigError
from fleetmap.sims.worlds import World

STEP = 4
"""The way is sought on every fourth cell (0.2 m)."""

PITCH_M = 5.0
"""Side of the squares: wide enough that some rooms are only seen through their doors, as in most real maps."""

CLEARANCE_M = 0.28
"""Distance that the robot's centre keeps from walls."""

SCAN_EVERY_M = 0.25
"""Distance between two scans, about what Karto takes by default (0.2 m)."""


@dataclass(frozen=True, slots=True)
class Tour:
    """The places of the scans.

    Parameters
    ----------
    places_xy : (n, 2) in cells of the world from its lower left corner
    headings_rad : (n,) direction of travel
    travelled_m : (n,) way from the start
    """

    places_xy: NDArray[np.float64]
    headings_rad: NDArray[np.float64]
    travelled_m: NDArray[np.float64]


def plan_tour(world: World) -> Tour:
    """Drive through the largest space of a world. Nothing about it is random.

    Raises
    ------
    ConfigError : the robot fits nowhere
    """
    from scipy import ndimage

    from fleetmap.paper.tour_kernels import nearest_first

    standable = world.standable(CLEARANCE_M)[STEP // 2 :: STEP, STEP // 2 :: STEP]
    labels, found = ndimage.label(standable)
    if found == 0:
        raise ConfigError(option="terrain", value=world.name, reason=f"no room for a robot of {CLEARANCE_M} m")
    passable = labels == 1 + np.argmax(np.bincount(labels.ravel())[1:])
    targets = one_a_square(passable, round(PITCH_M / world.resolution_m / STEP))
    start_row, start_column = np.argwhere(targets)[0].tolist()
    walk = nearest_first(passable, targets, start_row, start_column)

    corners = walk[:, ::-1] * STEP + STEP // 2 + 0.5  # (x, y) of the cells' centres
    way_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))]) * world.resolution_m
    travelled_m = np.arange(0.0, max(way_m[-1], SCAN_EVERY_M), SCAN_EVERY_M)
    places = np.column_stack([np.interp(travelled_m, way_m, corners[:, k]) for k in (0, 1)])
    ahead = np.diff(places, axis=0, append=places[-1:])
    return Tour(places, np.arctan2(ahead[:, 1], ahead[:, 0]), travelled_m)


def one_a_square(passable: NDArray[np.bool_], pitch: int) -> NDArray[np.bool_]:
    """Of each square of ``pitch`` cells the passable cell that is nearest to its middle, if it has any."""
    cells = np.argwhere(passable)
    squares = cells // pitch
    off_centre = ((2 * (cells - squares * pitch) - (pitch - 1)) ** 2).sum(axis=1)
    order = np.lexsort((cells[:, 1], cells[:, 0], off_centre, squares[:, 1], squares[:, 0]))
    _, first = np.unique(squares[order], axis=0, return_index=True)
    chosen = cells[order][first]
    targets = np.zeros_like(passable)
    targets[chosen[:, 0], chosen[:, 1]] = True
    return targets
