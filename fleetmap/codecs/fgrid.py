"""``.fgrid`` files: a grid of three states, lossless; alone, or as what a vector map of it leaves out.

``FGRD``, then one msgpack array: version, resolution, origin, digest of the vector map, checksum, the exact layer.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from pathlib import Path

import msgpack
import numpy as np

from fleetmap.codecs.context_grid import MAX_CELLS, decode_states, encode_states, read_size
from fleetmap.codecs.files import MAX_FILE_BYTES, read_behind, write_whole
from fleetmap.model.errors import FleetmapError, MapFormatError, WireError
from fleetmap.model.graded import warn_of_lost_values
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import UNKNOWN
from fleetmap.model.pose import Pose2

MAGIC = b"FGRD"
VERSION = 1

Draw = Callable[[OccupancyGrid], OccupancyGrid]
"""Draws a vector map upon the cells of a grid: ``lambda like: rasterize(vector_map, like=like)``."""


def save_fgrid(grid: OccupancyGrid, path: str | Path, *, base: tuple[int, Draw] | None = None) -> None:
    """Write the states of a grid; the file appears whole or not at all.

    Warns with ``MapWarning`` if cells have values between 0 and 100, which are not kept.

    Parameters
    ----------
    base : digest of a vector map of the grid, and what draws it: then only what it leaves out is written

    Raises
    ------
    OSError : the folder can't be written
    MapFormatError : the grid has more cells than the exact layer takes
    """
    check_size(grid, path)
    warn_of_lost_values(grid, "an .fgrid file")
    states = grid.states_yx()
    drawn = None if base is None else base[1](grid).states_yx()
    fields = [
        VERSION,
        grid.resolution_m,
        [grid.origin.x_m, grid.origin.y_m, grid.origin.yaw_rad],
        None if base is None else base[0],
        zlib.crc32(states.tobytes()),
        encode_states(states, drawn),
    ]
    write_whole(Path(path), MAGIC + msgpack.packb(fields))


def check_size(grid: OccupancyGrid, path: str | Path) -> None:
    """Refuse a grid that ``save_fgrid`` would refuse.

    Raises
    ------
    MapFormatError : it has more cells than the exact layer takes
    """
    if grid.cells_yx.size > MAX_CELLS:
        reason = f"expected at most {MAX_CELLS} cells; the grid has {grid.cells_yx.size}"
        raise MapFormatError(path=path, field="grid", reason=reason)


def load_fgrid(path: str | Path, *, base: tuple[int, Draw] | None = None) -> OccupancyGrid:
    """Read a grid.

    Parameters
    ----------
    base : as it was written with; it is not needed for a file without one

    Raises
    ------
    MapFormatError : the file is missing, is no .fgrid file, is damaged, or needs another base
    """
    path = Path(path)
    data = read_behind(path, MAGIC)
    try:
        fields = msgpack.unpackb(
            data,
            use_list=False,
            max_array_len=6,
            max_str_len=0,
            max_map_len=0,
            max_ext_len=0,
            max_bin_len=MAX_FILE_BYTES,
        )
        resolution_m, origin, needed, checksum, payload = _checked(fields)
        height, width = read_size(payload)
        like = OccupancyGrid.from_states(np.full((height, width), UNKNOWN, np.uint8), resolution_m, origin)
    except MapFormatError as error:  # of the grid, which knows no file
        raise MapFormatError(path=path, field=error.field, reason=error.reason) from None
    except (ValueError, TypeError, FleetmapError, msgpack.exceptions.UnpackException) as error:
        raise MapFormatError(path=path, field="envelope", reason=str(error) or type(error).__name__) from None
    if needed is not None and (base is None or base[0] != needed):
        given = "none was named" if base is None else f"{base[0]:016x} was named"
        reason = f"the file holds what the vector map with digest {needed:016x} leaves out; {given}"
        raise MapFormatError(path=path, field="base", reason=reason)
    try:
        states = decode_states(payload, None if needed is None or base is None else base[1](like).states_yx())
    except WireError as error:
        raise MapFormatError(path=path, field="states", reason=error.reason) from None
    if zlib.crc32(states.tobytes()) != checksum:
        raise MapFormatError(path=path, field="checksum", reason="the file is damaged, or its base was drawn otherwise")
    return OccupancyGrid.from_states(states, resolution_m, origin)


def _checked(fields: object) -> tuple[float, Pose2, int | None, int, bytes]:
    if not isinstance(fields, tuple) or len(fields) != 6:
        raise ValueError("expected an array of 6")
    version, resolution_m, origin, needed, checksum, payload = fields
    if version != VERSION:
        raise ValueError(f"version {version!r}; this one reads version {VERSION}")
    numbers = (resolution_m, *origin) if isinstance(origin, tuple) else ()
    if len(numbers) != 4 or not all(isinstance(number, float) and math.isfinite(number) for number in numbers):
        raise ValueError("expected a resolution and an origin of three numbers")
    if not (needed is None or type(needed) is int) or type(checksum) is not int or not isinstance(payload, bytes):
        raise ValueError("expected a digest or nil, a checksum and bytes")
    return resolution_m, Pose2(*origin), needed, checksum, payload
