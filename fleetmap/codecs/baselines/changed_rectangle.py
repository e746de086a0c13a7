"""Updates as the map_msgs of ROS send them: the smallest rectangle with all changes, gzipped."""

from __future__ import annotations

import numpy as np

from fleetmap.codecs.baselines.gzip_cells import gzip_grid, pack
from fleetmap.codecs.baselines.protocol import HEADER_BYTES
from fleetmap.model.grid import OccupancyGrid

WHOLE_CELL = 1 / 32
"""Two grids are on one lattice if their origins are whole cells apart but for this; YAML rounds origins."""


def gzip_changed_rectangle(old: OccupancyGrid | None, new: OccupancyGrid, level: int = 6) -> int:
    """Return the bytes of an update as in map_msgs/OccupancyGridUpdate: the smallest rectangle with all changes.

    Cells that the old grid did not have count as changed, so that a grown grid is told of its extent. A grid
    that only shrank costs a header; an unchanged one is not sent: 0. With no old grid, or one of another
    resolution, yaw or phase, the whole grid is sent.
    """
    shift_yx = None if old is None else _whole_cell_shift(old, new)
    if old is None or shift_yx is None:
        return gzip_grid(new, level)
    # Overlap of both grids, in cells of the new one; the old one's cell (0, 0) is its cell shift_yx.
    row, column = shift_yx
    rows = slice(max(row, 0), max(min(row + old.height, new.height), max(row, 0)))
    columns = slice(max(column, 0), max(min(column + old.width, new.width), max(column, 0)))
    changed = np.ones(new.cells_yx.shape, bool)
    before = old.cells_yx[rows.start - row : rows.stop - row, columns.start - column : columns.stop - column]
    changed[rows, columns] = new.cells_yx[rows, columns] != before
    if not changed.any():
        same_extent = shift_yx == (0, 0) and old.cells_yx.shape == new.cells_yx.shape
        return 0 if same_extent else HEADER_BYTES
    y, x = np.flatnonzero(changed.any(axis=1)), np.flatnonzero(changed.any(axis=0))
    return HEADER_BYTES + len(pack(new.cells_yx[y[0] : y[-1] + 1, x[0] : x[-1] + 1], level=level))


def _whole_cell_shift(old: OccupancyGrid, new: OccupancyGrid) -> tuple[int, int] | None:
    """Cell (row, column) of ``new`` where cell (0, 0) of ``old`` lies; None if they share no lattice."""
    if old.resolution_m != new.resolution_m or old.origin.yaw_rad != new.origin.yaw_rad:
        return None
    T_new_old = new.origin.inverse() @ old.origin
    shift = np.array([T_new_old.y_m, T_new_old.x_m]) / new.resolution_m
    if np.abs(shift - shift.round()).max() > WHOLE_CELL:
        return None
    row, column = shift.round().astype(np.int64).tolist()
    return row, column
