"""gzip of one byte a cell: nav_msgs/OccupancyGrid as bridges compress it. No time goes into its header."""

from __future__ import annotations

import gzip

import numpy as np

from fleetmap.codecs.baselines.protocol import HEADER_BYTES, Cells
from fleetmap.model.grid import OccupancyGrid


def gzip_grid(grid: OccupancyGrid, level: int = 6) -> int:
    """Return the bytes of the whole grid: a header and gzip of one byte a cell, as in nav_msgs/OccupancyGrid."""
    return HEADER_BYTES + len(pack(grid.cells_yx, level=level))


def pack(cells_yx: Cells, *, level: int) -> bytes:
    """(height, width) int8 cells -> a gzip file."""
    return gzip.compress(cells_yx.tobytes(), level, mtime=0)


def unpack(data: bytes, shape: tuple[int, int]) -> Cells:
    """(height, width) int8 cells."""
    return np.frombuffer(gzip.decompress(data), np.int8).reshape(shape)
