"""What people hold instead of an ``OccupancyGrid``: a ROS message, an array, the name of a map file."""

from __future__ import annotations

import math
import os
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.checks import as_number, check_type
from fleetmap.model.errors import ConfigError, MapFormatError
from fleetmap.model.grid import MAX_CELLS, OccupancyGrid
from fleetmap.model.mergedmap import MergedMap
from fleetmap.model.pose import Pose2

PATH = "<message>"
EXPECTED = (
    "expected a fleetmap.OccupancyGrid, a message like nav_msgs/OccupancyGrid, an array (height, width) with "
    "resolution_m=, the path of a map_server YAML, or a VectorMap"
)


class GridMessage(Protocol):
    """Anything shaped like ``nav_msgs/OccupancyGrid``, of rclpy, rospy or rosbags."""

    @property
    def info(self) -> Any:
        """``resolution``, ``width``, ``height``, ``origin``."""

    @property
    def data(self) -> Any:
        """Cells, row by row, the lowest y first: -1 unknown, 0 to 100."""


GridLike: TypeAlias = OccupancyGrid | GridMessage | NDArray[Any] | str | os.PathLike[str]


def as_grid(source: object, *, resolution_m: float | None = None, origin: Pose2 | None = None) -> OccupancyGrid:
    """A grid of what was handed in.

    Parameters
    ----------
    source : an ``OccupancyGrid``, a message, an array or nested lists (height, width), or the path of a map_server YAML
    resolution_m, origin : of an array: metres a cell, and the pose of the lower left corner

    Raises
    ------
    ConfigError : it is none of these, or ``resolution_m`` or ``origin`` are missing or too much
    MapFormatError : which field is wrong
    """
    array = isinstance(source, np.ndarray | list | tuple)
    if array and resolution_m is None:
        raise ConfigError(option="resolution_m", value=None, reason="expected metres a cell beside an array")
    if not array and (resolution_m is not None or origin is not None):
        given, value = ("origin", origin) if resolution_m is None else ("resolution_m", resolution_m)
        raise ConfigError(option=given, value=value, reason="goes with an array only: all else has its own")
    if origin is not None:
        check_type("origin", origin, Pose2, hint="write Pose2(x_m, y_m, yaw_rad)")
    if isinstance(source, OccupancyGrid):
        return source
    if array:
        assert resolution_m is not None
        return OccupancyGrid(source, resolution_m, Pose2() if origin is None else origin)  # type: ignore[arg-type]
    if isinstance(source, str | os.PathLike):
        from fleetmap.model.map_server import load_map

        return load_map(source)
    if hasattr(source, "info") and hasattr(source, "data"):
        grid = grid_of(source)
        if grid is None:
            raise MapFormatError(path=PATH, field="data", reason="has no cells")
        return grid
    if isinstance(source, MergedMap):
        raise ConfigError(option="source", value="MergedMap", reason="a merged map is never published again")
    raise ConfigError(option="source", value=type(source).__name__, reason=EXPECTED)


def grid_of(message: Any) -> OccupancyGrid | None:
    """A grid from a message; None if it has no cells.

    Raises
    ------
    MapFormatError : which field is wrong
    """
    cells, resolution_m, origin = parts_of(message)
    return OccupancyGrid(as_nav2_reads(cells), resolution_m, origin) if cells.size else None


def parts_of(message: Any) -> tuple[NDArray[np.int8], float, Pose2]:
    """Cells (height, width), row 0 the lowest y; metres a cell; the pose of the lower left corner.

    Raises
    ------
    MapFormatError : which field is wrong
    """
    info = message.info
    height, width = size_of(_field(info, "height"), _field(info, "width"))
    cells = cells_of(message.data, height, width)
    if cells.size == 0:
        return cells, 0.0, Pose2()
    resolution_m = _number(_field(info, "resolution"), "info.resolution")
    if resolution_m <= 0:
        raise MapFormatError(path=PATH, field="info.resolution", reason=f"expected more than 0; found {resolution_m}")
    origin = _field(info, "origin")
    return cells, rounded(resolution_m), origin if isinstance(origin, Pose2) else pose_of(origin, "info.origin")


def pose_of(pose: Any, field: str = "pose") -> Pose2:
    """A pose of ROS in the plane. A quaternion of zeros, as messages begin with, stands for no rotation.

    Raises
    ------
    MapFormatError : it is none, or not finite
    """
    try:
        position, q = pose.position, pose.orientation
        parts = [position.x, position.y, q.x, q.y, q.z, q.w]
    except AttributeError as error:
        reason = f"expected a geometry_msgs/Pose or a Pose2; found {type(pose).__name__} ({error})"
        raise MapFormatError(path=PATH, field=field, reason=reason) from None
    x, y, qx, qy, qz, qw = (_number(part, field) for part in parts)
    length = math.hypot(qx, qy, qz, qw)
    if length == 0:
        return Pose2(x, y)
    if abs(length - 1) > 0.1:
        reason = f"expected a unit quaternion; found ({qx:g}, {qy:g}, {qz:g}, {qw:g})"
        raise MapFormatError(path=PATH, field=field, reason=reason)
    qx, qy, qz, qw = (part / length for part in (qx, qy, qz, qw))
    return Pose2(x, y, math.atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz)))


def rounded(resolution_m: float) -> float:
    """The number that was meant: the message has it as float32, in which 0.05 is 0.0500000007."""
    single = np.float32(resolution_m)
    return float(str(single)) if float(single) == resolution_m else resolution_m


def as_nav2_reads(cells: NDArray[np.int8]) -> NDArray[np.int8]:
    """The cells with what is neither -1 nor 0 to 100 as obstacles, as nav2's static layer takes it for."""
    view = cells.view(np.uint8)
    odd = (view > 100) & (view < 255)
    return np.where(odd, np.int8(100), cells) if odd.any() else cells


def size_of(height: Any, width: Any) -> tuple[int, int]:
    """Rows and columns.

    Raises
    ------
    MapFormatError : there are too many
    """
    whole = [as_number(part) for part in (height, width)]
    rows, columns = (-1 if part is None or part != int(part) else int(part) for part in whole)
    if rows < 0 or columns < 0 or rows * columns > MAX_CELLS:
        reason = f"expected at most {MAX_CELLS} cells; found {width!r} x {height!r}"
        raise MapFormatError(path=PATH, field="width, height", reason=reason)
    return rows, columns


def cells_of(data: Any, height: int, width: int) -> NDArray[np.int8]:
    """(height, width) int8 of a message's list of cells; a view where it may be.

    Raises
    ------
    MapFormatError : these are not so many small numbers
    """
    try:
        if isinstance(data, np.ma.MaskedArray):
            raise TypeError("found a masked array: .filled(-1) makes masked cells unknown")
        array = np.asarray(data)
        if array.dtype.kind not in "iu" and array.size:
            raise TypeError(f"found {array.dtype}")
        # Drivers that hold bytes write 255 for -1.
        narrow = array.view(np.int8) if array.dtype in (np.int8, np.uint8) else array.astype(np.int8)
        if array.dtype.itemsize > 1 and not np.array_equal(narrow, array):
            raise TypeError(f"found {array.min()} to {array.max()}")
    except (TypeError, ValueError, OverflowError) as error:
        reason = f"expected a list or an array of int8: {error}"
        raise MapFormatError(path=PATH, field="data", reason=reason) from None
    if narrow.size != height * width:
        reason = f"expected width x height = {width} x {height} = {height * width} cells; found {narrow.size}"
        raise MapFormatError(path=PATH, field="data", reason=reason)
    return narrow.reshape(height, width)


def _field(info: Any, name: str) -> Any:
    try:
        return getattr(info, name)
    except AttributeError:
        raise MapFormatError(path=PATH, field=f"info.{name}", reason="missing") from None


def _number(value: Any, field: str) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise MapFormatError(path=PATH, field=field, reason=f"expected finite numbers; found {value!r}")
    return number
