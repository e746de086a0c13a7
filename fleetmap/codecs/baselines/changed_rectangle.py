"""Updates of grids: the smallest rectangle with all changes, gzipped as in the map_msgs of ROS, or as differences."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.codecs.baselines.gzip_cells import gzip_grid, pack
from fleetmap.codecs.baselines.protocol import HEADER_BYTES
from fleetmap.codecs.context_grid import encode_states, split
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import UNKNOWN

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
    changed = np.ones(new.cells_yx.shape, bool)
    now, before = _overlap(old, new, shift_yx)
    changed[now] = new.cells_yx[now] != old.cells_yx[before]
    window = _bounds(changed)
    if window is None:
        same_extent = shift_yx == (0, 0) and old.cells_yx.shape == new.cells_yx.shape
        return 0 if same_extent else HEADER_BYTES
    return HEADER_BYTES + len(pack(new.cells_yx[window], level=level))


def exact_changed_rectangle(old: OccupancyGrid | None, new: OccupancyGrid) -> int:
    """Return the bytes of the smallest rectangle of changed states through the exact layer, the old ones as its base.

    That is the least that is known for differences of grids. Cells that the old grid did not have were unknown; with no
    old grid, or one of another resolution, yaw or phase, all were. 0 if nothing changed. A rectangle too large for one
    payload counts as several.
    """
    states = new.states_yx()
    was = np.full_like(states, UNKNOWN)
    shift_yx = None if old is None else _whole_cell_shift(old, new)
    if old is not None and shift_yx is not None:
        now, before = _overlap(old, new, shift_yx)
        was[now] = old.states_yx()[before]
    window = _bounds(states != was)
    if window is None:
        return 0
    states, was = states[window], was[window]
    return sum(HEADER_BYTES + len(encode_states(states[part], was[part])) for part in split(states.shape))


Window = tuple[slice, slice]


def _overlap(old: OccupancyGrid, new: OccupancyGrid, shift_yx: tuple[int, int]) -> tuple[Window, Window]:
    """Rows and columns that both grids have, in the new one and in the old one; ``shift_yx`` as below."""
    row, column = shift_yx
    rows = slice(max(row, 0), max(min(row + old.height, new.height), max(row, 0)))
    columns = slice(max(column, 0), max(min(column + old.width, new.width), max(column, 0)))
    return (rows, columns), (
        slice(rows.start - row, rows.stop - row),
        slice(columns.start - column, columns.stop - column),
    )


def _bounds(changed: NDArray[np.bool_]) -> Window | None:
    """The smallest rectangle with all that changed; None if nothing did."""
    if not changed.any():
        return None
    y, x = np.flatnonzero(changed.any(axis=1)), np.flatnonzero(changed.any(axis=0))
    return slice(y[0], y[-1] + 1), slice(x[0], x[-1] + 1)


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
