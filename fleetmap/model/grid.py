"""``OccupancyGrid``: cells free / occupied / unknown, by the conventions of ROS."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.checks import as_number
from fleetmap.model.errors import ConfigError, MapFormatError
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN
from fleetmap.model.pose import Pose2

OCCUPIED_THRESHOLD = 0.65
FREE_THRESHOLD = 0.196
"""map_server's defaults; grey 205 (its own unknown) is p = 0.196 and must stay unknown."""

FREE_BELOW, OCCUPIED_ABOVE = 20.0, 64.0
"""The same for whole per cents: up to 19 free, from 65 on occupied."""

MAX_CELLS = 1 << 28
"""Largest grid that is read or made, in cells (256 MB at one byte a cell)."""


@dataclass(frozen=True, eq=False)
class OccupancyGrid:
    """A grid as in nav_msgs/OccupancyGrid.

    Parameters
    ----------
    cells_yx : (height, width), row 0 the *lowest* y, as in the ROS message (image files have it the other way round).
        Integers of any type: -1 unknown, 0 to 100 the probability of an obstacle in per cent. Floats: that probability,
        0 to 1, rounded to whole per cents; NaN unknown. Bools: a mask of obstacles, True occupied, False free. What
        is kept is a copy, (height, width) int8, read-only: the array that was handed in may be used again.
    resolution_m : metres a cell, more than 0
    origin : pose of the lower left corner of cell (0, 0) in the map frame; yaw turns the whole grid
    free_below, occupied_above : per cent; a known cell is free if its value is below the one, occupied if it is above
        the other, and unknown between them. 0 < free_below <= occupied_above < 100

    Raises
    ------
    MapFormatError : wrong shape, type, value, resolution or origin
    ConfigError : thresholds that are none
    """

    cells_yx: NDArray[np.int8]
    resolution_m: float
    origin: Pose2 = field(default_factory=Pose2)
    free_below: float = FREE_BELOW
    occupied_above: float = OCCUPIED_ABOVE

    def __post_init__(self) -> None:
        resolution_m = as_number(self.resolution_m)
        if resolution_m is None or resolution_m <= 0:
            raise _refused("resolution_m", f"expected a finite number above 0; found {self.resolution_m!r}")
        origin: object = self.origin
        if not isinstance(origin, Pose2):
            raise _refused("origin", f"expected Pose2(x_m, y_m, yaw_rad); found {type(origin).__name__}")
        self._put("cells_yx", _per_cent(self.cells_yx))
        self._put("resolution_m", resolution_m)
        self._put_thresholds(self.free_below, self.occupied_above)

    @classmethod
    def from_states(
        cls, states_yx: NDArray[np.uint8], resolution_m: float, origin: Pose2 | None = None
    ) -> OccupancyGrid:
        """A grid from (height, width) states FREE, OCCUPIED, UNKNOWN (row 0 lowest).

        Raises
        ------
        MapFormatError : wrong shape, type, state, resolution or origin
        """
        states = _array("states_yx", states_yx)
        if states.dtype.kind not in "iu":
            raise _refused("states_yx", f"expected integers; found {states.dtype}")
        if states.min() < 0 or states.max() > UNKNOWN:
            raise _refused("states_yx", f"expected 0 (free), 1 (occupied) or 2 (unknown); found {_range(states)}")
        return cls(np.array([0, 100, -1], np.int8)[states], resolution_m, Pose2() if origin is None else origin)

    def with_thresholds(self, *, free_below: float | None = None, occupied_above: float | None = None) -> OccupancyGrid:
        """The same cells, which both grids share, under other thresholds; None leaves one as it is.

        Raises
        ------
        ConfigError : not 0 < free_below <= occupied_above < 100
        """
        if free_below is None and occupied_above is None:
            return self
        other = copy.copy(self)
        other._put_thresholds(
            self.free_below if free_below is None else free_below,
            self.occupied_above if occupied_above is None else occupied_above,
        )
        return other

    @property
    def height(self) -> int:
        """Rows."""
        return int(self.cells_yx.shape[0])

    @property
    def width(self) -> int:
        """Columns."""
        return int(self.cells_yx.shape[1])

    @property
    def limits(self) -> tuple[int, int]:
        """The thresholds in whole per cents: the highest value that is free, and the lowest that is occupied."""
        return math.ceil(self.free_below) - 1, math.floor(self.occupied_above) + 1

    def states_yx(self) -> NDArray[np.uint8]:
        """(height, width) uint8: FREE, OCCUPIED or UNKNOWN; a value between the thresholds is unknown."""
        # A table over all 256 bytes: one gather instead of three passes over the grid.
        free, occupied = self.limits
        table = np.full(256, UNKNOWN, np.uint8)
        table[: free + 1] = FREE
        table[occupied:101] = OCCUPIED
        return table[self.cells_yx.view(np.uint8)]

    def _put(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)

    def _put_thresholds(self, free_below: float, occupied_above: float) -> None:
        free, occupied = check_thresholds(free_below, occupied_above)
        self._put("free_below", free)
        self._put("occupied_above", occupied)


def check_thresholds(free_below: object, occupied_above: object) -> tuple[float, float]:
    """The thresholds as floats.

    Raises
    ------
    ConfigError : not 0 < free_below <= occupied_above < 100
    """
    free, occupied = as_number(free_below), as_number(occupied_above)
    # Of per cents none is so low: a share was meant, under which all cells but 0 would be obstacles.
    if free is None or occupied is None or not 0 < free <= occupied < 100 or occupied < 1:
        reason = "expected per cents, 0 < free_below <= occupied_above < 100 (52, not 0.52)"
        raise ConfigError(option="free_below, occupied_above", value=(free_below, occupied_above), reason=reason)
    return free, occupied


def _refused(what: str, reason: str) -> MapFormatError:
    return MapFormatError(path="<array>", field=what, reason=reason)


def _range(values: NDArray[np.generic]) -> str:
    return f"{values.min()} to {values.max()}"


def _array(what: str, given: object) -> NDArray[np.generic]:
    """What was handed in as an array of numbers or bools, of two axes and of a size that is allowed; not a copy."""
    if isinstance(given, np.ma.MaskedArray):
        raise _refused(what, "expected a plain array; found a masked one: .filled(-1) makes masked cells unknown")
    try:
        array = np.asarray(given)
    except (TypeError, ValueError) as error:  # rows of different lengths
        raise _refused(what, f"expected an array (height, width); found {type(given).__name__}: {error}") from None
    if array.dtype.kind not in "iufb":
        found = f"an array of {array.dtype}" if isinstance(given, np.ndarray) else type(given).__name__
        raise _refused(what, f"expected an array of integers, floats or bools; found {found}")
    if array.ndim != 2 or array.size == 0:
        raise _refused(what, f"expected (height, width), both at least 1; found shape {array.shape}")
    if array.size > MAX_CELLS:
        raise _refused(what, f"{array.size} cells; at most {MAX_CELLS}")
    return array


def _per_cent(given: object) -> NDArray[np.int8]:
    """A copy as -1 to 100, read-only: a later change of the array that was handed in changes no map."""
    cells = _array("cells_yx", given)
    result: NDArray[np.int8]
    if cells.dtype.kind == "b":
        result = np.multiply(cells, np.int8(100), dtype=np.int8, order="C")
    elif cells.dtype.kind == "f":
        result = _of_probabilities(cells)
    elif cells.min() < -1 or cells.max() > 100:
        hint = (
            ": if 255 is unknown, cells.view(np.int8) has -1 for it; the image of a map file is read by load_map"
            if cells.dtype == np.uint8
            else ""
        )
        raise _refused("cells_yx", f"expected integers -1 to 100; found {_range(cells)}{hint}")
    else:
        result = np.array(cells, np.int8, order="C")
    result.flags.writeable = False
    return result


def _of_probabilities(cells: NDArray[np.generic]) -> NDArray[np.int8]:
    # fmin and fmax pass over NaN, which stands for unknown.
    low, high = float(np.fmin.reduce(cells, axis=None)), float(np.fmax.reduce(cells, axis=None))
    if low < 0 or high > 1:
        reason = (
            f"floats are probabilities, 0 to 1, and NaN is unknown; found {low:g} to {high:g}: "
            "if they are per cents and -1, cells.round().astype(np.int8)"
        )
        raise _refused("cells_yx", reason)
    per_cent = np.rint(np.multiply(cells, 100, dtype=np.float64))
    per_cent[np.isnan(per_cent)] = -1
    result: NDArray[np.int8] = per_cent.astype(np.int8, order="C")
    return result
