"""What every baseline has: a name, bytes of a map, and the map back, so that the bytes are known to hold it."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.vectormap import VectorMap

GRID_HEADER = struct.Struct("<4f2I")
HEADER_BYTES = GRID_HEADER.size
"""Origin (3 x 4 B), resolution, width and height (4 B each): less than ROS itself sends."""

EXTRA = "baselines"
"""The extra of the project that installs all their packages."""

Cells = NDArray[np.int8] | NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class GridBaseline:
    """A way to send a grid, without loss.

    Parameters
    ----------
    name : its key in ``GRID_BASELINES``
    keeps : ``cells``, int8 from -1 to 100, or ``states``, uint8 FREE, OCCUPIED, UNKNOWN
    pack : (height, width) array of what it keeps -> bytes
    unpack : those bytes and (height, width) -> the array
    module : what it imports that fleetmap itself does not need
    """

    name: str
    keeps: Literal["cells", "states"]
    pack: Callable[[Cells], bytes]
    unpack: Callable[[bytes, tuple[int, int]], Cells]
    module: str | None = None

    def encode(self, grid: OccupancyGrid) -> bytes:
        """Header and grid, one message to one receiver; the same grid gives the same bytes."""
        at = grid.origin
        header = GRID_HEADER.pack(at.x_m, at.y_m, at.yaw_rad, grid.resolution_m, grid.width, grid.height)
        return header + self.pack(grid.cells_yx if self.keeps == "cells" else grid.states_yx())

    def decode(self, data: bytes) -> Cells:
        """(height, width) what the codec ``keeps`` of the grid. For bytes of one's own: nothing is bounded."""
        *_, width, height = GRID_HEADER.unpack_from(data)
        return self.unpack(data[HEADER_BYTES:], (height, width))


@dataclass(frozen=True, slots=True)
class VectorBaseline:
    """A way to send the lines of a vector map: neither labels nor thickness, so less than fleetmap sends.

    Parameters
    ----------
    name : its key in ``VECTOR_BASELINES``
    encode : map -> bytes, one message to one receiver; the same map gives the same bytes
    decode : those bytes -> lines, each (n, 2) float64 metres (x, y) in the submap's frame
    error_m : how far a decoded vertex may be from the map's own, in metres, within 1 km of the frame's origin
    module : what it imports that fleetmap itself does not need
    """

    name: str
    encode: Callable[[VectorMap], bytes]
    decode: Callable[[bytes], list[NDArray[np.float64]]]
    error_m: float
    module: str | None = None


def available(codec: GridBaseline | VectorBaseline) -> bool:
    """Whether the package that this codec needs is installed; nothing is imported."""
    return codec.module is None or find_spec(codec.module) is not None


def require(module: str) -> ModuleType:
    """Import a package that only the baselines need.

    Raises
    ------
    ImportError : it is missing; the message names the extra
    """
    try:
        return import_module(module)
    except ImportError as error:
        raise ImportError(f"{module}: missing: pip install 'fleetmap[{EXTRA}]' ({error})", name=module) from None
