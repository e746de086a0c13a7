"""States of space, and the integer lattice on which an epoch's vertices lie."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.checks import as_number
from fleetmap.model.errors import ConfigError
from fleetmap.model.pose import FixedPose

FREE, OCCUPIED, UNKNOWN = 0, 1, 2
"""The three states of a cell, and of either side of an edge."""

MAX_COORDINATE = 1 << 20
"""Largest |lattice coordinate|, in cells: cross products of differences then fit 44 bits."""

EPSILON_CELLS = math.sqrt(2.0)
"""The error bound of the paper: sqrt(2) x cell size."""


@dataclass(frozen=True, slots=True)
class Lattice:
    """Where an epoch's integer lattice lies in its frame, and how large a cell is.

    ``T_frame_lattice`` puts lattice point (0, 0) at (x_um, y_um) of the submap's frame; one step is
    ``resolution_um`` micrometres. Points are (y, x) integers, y up.
    """

    resolution_um: int
    T_frame_lattice: FixedPose = FixedPose()

    def __post_init__(self) -> None:
        found = as_number(self.resolution_um)
        if found is None or not found.is_integer() or not 100 <= found <= 10_000_000:
            raise ConfigError(
                option="resolution",
                value=f"{self.resolution_um} um",
                reason="expected whole micrometres, 0.1 mm to 10 m a cell",
            )

    @property
    def resolution_m(self) -> float:
        """Size of a cell in metres."""
        return self.resolution_um / 1e6

    def to_metres(self, points_yx: NDArray[np.int32]) -> NDArray[np.float64]:
        """(..., 2) lattice points (y, x) -> (..., 2) metres (x, y) in the submap's frame."""
        points_xy = points_yx[..., ::-1] * self.resolution_m
        return self.T_frame_lattice.to_pose().apply(points_xy)
