"""Where a grid lies on an epoch's lattice: by whole cells, and a phase in sixteenths."""

from __future__ import annotations

import math

from fleetmap.model.errors import ConfigError
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import MAX_COORDINATE, Lattice
from fleetmap.model.pose import FixedPose, wrap

SIXTEENTHS = 16
"""Phases are rounded to 1/16 of a cell: what is off by less than 1/32 lies on the lattice."""


def lattice_of(grid: OccupancyGrid) -> Lattice:
    """Lay a lattice on the corners of a grid's cells, (0, 0) at its origin; for the first grid of an epoch.

    Raises
    ------
    ConfigError : cells that are too small or too large, or an origin that is too far away
    """
    if grid.resolution_m > 10.0:  # the largest floats have no micrometres
        raise ConfigError(option="resolution_m", value=grid.resolution_m, reason="expected 0.1 mm to 10 m a cell")
    return Lattice(round(grid.resolution_m * 1e6), FixedPose.from_pose(grid.origin))


def place_on_lattice(grid: OccupancyGrid, lattice: Lattice) -> tuple[tuple[int, int], tuple[int, int]]:
    """Where the lower left corner of a grid lies: the nearest lattice point, and what it is off from it.

    Returns
    -------
    shift_yx : lattice point (y, x)
    phase_yx : sixteenths of a cell, each from -8 to 7

    Raises
    ------
    ConfigError : another resolution or yaw, so that over the grid's extent it would be off by more than 1/32
        of a cell, or a grid beyond the lattice's largest coordinate: a new epoch is needed
    """
    cells = max(grid.height, grid.width)
    if abs(grid.resolution_m / lattice.resolution_m - 1) * cells > 1 and (
        abs(grid.resolution_m * 1e6 - lattice.resolution_um) > 0.5
    ):
        raise ConfigError(
            option="resolution_m",
            value=grid.resolution_m,
            reason=f"this epoch has cells of {lattice.resolution_m} m: start a new epoch",
        )
    pose = lattice.T_frame_lattice.to_pose()
    if abs(wrap(grid.origin.yaw_rad - pose.yaw_rad)) * cells > 1 / 32:
        raise ConfigError(
            option="origin yaw_rad",
            value=grid.origin.yaw_rad,
            reason=f"this epoch's lattice has yaw {pose.yaw_rad:.6f}: start a new epoch",
        )
    dx, dy = grid.origin.x_m - pose.x_m, grid.origin.y_m - pose.y_m
    c, s = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
    place = []
    for offset_m, extent in ((-s * dx + c * dy, grid.height), (c * dx + s * dy, grid.width)):
        sixteenths = round(offset_m / lattice.resolution_m * SIXTEENTHS)
        shift = (sixteenths + SIXTEENTHS // 2) // SIXTEENTHS
        if max(-shift, shift + extent) > MAX_COORDINATE:
            raise ConfigError(
                option="origin", value=grid.origin, reason=f"more than {MAX_COORDINATE} cells from the first grid's"
            )
        place.append((shift, sixteenths - shift * SIXTEENTHS))
    (shift_y, phase_y), (shift_x, phase_x) = place
    return (shift_y, shift_x), (phase_y, phase_x)
