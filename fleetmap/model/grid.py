"""``OccupancyGrid``: cells free / occupied / unknown, by the conventions of ROS."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.errors import MapFormatError
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN
from fleetmap.model.pose import Pose2

OCCUPIED_THRESHOLD = 0.65
FREE_THRESHOLD = 0.196
"""map_server's defaults; grey 205 (its own unknown) is p = 0.196 and must stay unknown."""

MAX_CELLS = 1 << 28
"""Largest grid that is read or made, in cells (256 MB at one byte a cell)."""


@dataclass(frozen=True, eq=False)
class OccupancyGrid:
    """A grid as in nav_msgs/OccupancyGrid.

    Parameters
    ----------
    cells_yx : (height, width) int8; -1 unknown, 0 to 100 the probability of an obstacle in per cent.
        Row 0 is the *lowest* y, as in the ROS message (image files have it the other way round).
    resolution_m : metres a cell, more than 0
    origin : pose of the lower left corner of cell (0, 0) in the map frame; yaw turns the whole grid

    Raises
    ------
    MapFormatError : wrong shape, type, value, resolution or origin
    """

    cells_yx: NDArray[np.int8]
    resolution_m: float
    origin: Pose2 = field(default_factory=Pose2)

    def __post_init__(self) -> None:
        def refuse(what: str, reason: str) -> MapFormatError:
            return MapFormatError(path="<array>", field=what, reason=reason)

        cells = np.asarray(self.cells_yx)
        if cells.ndim != 2 or cells.size == 0:
            raise refuse("cells_yx", f"expected (height, width), both at least 1; found shape {cells.shape}")
        if cells.size > MAX_CELLS:
            raise refuse("cells_yx", f"{cells.size} cells; at most {MAX_CELLS}")
        if cells.dtype.kind == "f" and not np.isfinite(cells).all():
            raise refuse("cells_yx", "holds NaN or infinity")
        if cells.dtype.kind not in "iufb":
            raise refuse("cells_yx", f"expected int8; found {cells.dtype}")
        if cells.min() < -1 or cells.max() > 100:
            raise refuse("cells_yx", f"expected -1 or 0 to 100; found {cells.min()} to {cells.max()}")
        if not (math.isfinite(self.resolution_m) and self.resolution_m > 0):
            raise refuse("resolution_m", f"expected a finite number above 0; found {self.resolution_m}")
        object.__setattr__(self, "cells_yx", np.ascontiguousarray(cells, np.int8))

    @classmethod
    def from_states(
        cls, states_yx: NDArray[np.uint8], resolution_m: float, origin: Pose2 | None = None
    ) -> OccupancyGrid:
        """A grid from (height, width) states FREE, OCCUPIED, UNKNOWN (row 0 lowest)."""
        return cls(np.array([0, 100, -1], np.int8)[states_yx], resolution_m, origin or Pose2())

    @property
    def height(self) -> int:
        """Rows."""
        return int(self.cells_yx.shape[0])

    @property
    def width(self) -> int:
        """Columns."""
        return int(self.cells_yx.shape[1])

    def states_yx(self) -> NDArray[np.uint8]:
        """(height, width) uint8: FREE, OCCUPIED or UNKNOWN; a probability between the thresholds is unknown."""
        # A table over all 256 bytes: one gather instead of three passes over the grid.
        table = np.full(256, UNKNOWN, np.uint8)
        table[: int(FREE_THRESHOLD * 100) + 1] = FREE
        table[int(OCCUPIED_THRESHOLD * 100) : 101] = OCCUPIED
        return table[self.cells_yx.view(np.uint8)]
