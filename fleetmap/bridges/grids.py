"""Occupancy grids of ROS, in and out: whole ones, and the rectangles of ``/map_updates``."""

from __future__ import annotations

import math
import threading
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fleetmap.bridges import cdr
from fleetmap.bridges.transforms import MAX_NAME
from fleetmap.model.errors import MapFormatError
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.grid_like import PATH, as_nav2_reads, cells_of, parts_of, size_of
from fleetmap.model.pose import Pose2


class LatestMap:
    """The last map of a topic, with all its updates; may be used from several threads.

    Only the newest is kept: maps that come faster than they are taken replace each other.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._cells: NDArray[np.int8] | None = None
        self._resolution_m, self._origin = 0.0, Pose2()
        self._new = False
        self.frame_id = ""

    def replace(self, message: Any) -> bool:
        """Take in a whole map; False if it has no cells, as mappers say before they know anything.

        Raises
        ------
        MapFormatError : which field is wrong
        """
        cells, resolution_m, origin = parts_of(message)
        if cells.size == 0:
            return False
        frame_id = str(message.header.frame_id).lstrip("/")
        if len(frame_id) > MAX_NAME:
            raise MapFormatError(path=PATH, field="header.frame_id", reason=f"longer than {MAX_NAME} characters")
        kept = cells.copy()
        with self._lock:
            self._cells, self._resolution_m, self._origin, self._new = kept, resolution_m, origin, True
            self.frame_id = frame_id
        return True

    def update(self, message: Any) -> bool:
        """Take in a rectangle of the map that came last; False before there is one.

        Raises
        ------
        MapFormatError : which field is wrong; nothing of it is applied
        """
        height, width = size_of(message.height, message.width)
        data = cells_of(message.data, height, width)
        x, y = int(message.x), int(message.y)
        with self._lock:
            if self._cells is None:
                return False
            rows, columns = self._cells.shape
            if not (0 <= x <= columns - width and 0 <= y <= rows - height):
                reason = f"{width} x {height} cells at ({x}, {y}) don't lie in the last map of {columns} x {rows}"
                raise MapFormatError(path=PATH, field="x, y, width, height", reason=reason)
            if data.size:
                self._cells[y : y + height, x : x + width] = data
                self._new = True
        return True

    def take(self) -> OccupancyGrid | None:
        """The map as it is now; None if nothing has changed since it was taken last."""
        with self._lock:
            if self._cells is None or not self._new:
                return None
            self._new = False
            return OccupancyGrid(as_nav2_reads(self._cells), self._resolution_m, self._origin)


def map_message(grid: OccupancyGrid, *, frame_id: str, stamp_ns: int) -> Any:
    """A grid as a message."""
    info = cdr.make(
        "nav_msgs/msg/MapMetaData",
        map_load_time=cdr.time_of(stamp_ns),
        resolution=grid.resolution_m,
        width=grid.width,
        height=grid.height,
        origin=pose_message(grid.origin),
    )
    return cdr.make(cdr.MAP, header=cdr.header(frame_id, stamp_ns), info=info, data=grid.cells_yx.reshape(-1))


def update_message(before: OccupancyGrid, grid: OccupancyGrid, *, frame_id: str, stamp_ns: int) -> Any | None:
    """What changed as a rectangle; None if it has to be told as a whole map, since size or place differ."""
    same = before.cells_yx.shape == grid.cells_yx.shape and before.resolution_m == grid.resolution_m
    if not same or before.origin != grid.origin:
        return None
    changed = before.cells_yx != grid.cells_yx
    rows, columns = np.flatnonzero(changed.any(axis=1)), np.flatnonzero(changed.any(axis=0))
    if not len(rows):
        return None
    (top, left), (bottom, right) = (rows[0], columns[0]), (rows[-1] + 1, columns[-1] + 1)
    return cdr.make(
        cdr.MAP_UPDATE,
        header=cdr.header(frame_id, stamp_ns),
        x=int(left),
        y=int(top),
        width=int(right - left),
        height=int(bottom - top),
        data=np.ascontiguousarray(grid.cells_yx[top:bottom, left:right]).reshape(-1),
    )


def pose_message(pose: Pose2) -> Any:
    """A pose as a message."""
    return cdr.make(
        "geometry_msgs/msg/Pose",
        position=cdr.make("geometry_msgs/msg/Point", x=pose.x_m, y=pose.y_m, z=0.0),
        orientation=quaternion(pose.yaw_rad),
    )


def quaternion(yaw_rad: float) -> Any:
    """A rotation about z."""
    z, w = math.sin(yaw_rad / 2), math.cos(yaw_rad / 2)
    return cdr.make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=z, w=w)
