"""The lines that vector baselines send: the arcs of a map, in metres or on its lattice."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.lattice import Lattice
from fleetmap.model.pose import FixedPose
from fleetmap.model.vectormap import VectorMap

LATTICE = struct.Struct("<I2q2i")
LATTICE_BYTES = LATTICE.size
"""Size of a cell, and where the lattice lies: what whole numbers need to become metres."""


def lattice_lines(vector_map: VectorMap) -> list[NDArray[np.int64]]:
    """Arcs of the map, each (n, 2) lattice points (x, y); a closed one repeats its first point."""
    arcs = vector_map.arcs()
    return np.split(arcs.points_yx[:, ::-1].astype(np.int64), arcs.offsets[1:-1]) if len(arcs) else []


def metre_lines(vector_map: VectorMap) -> list[NDArray[np.float64]]:
    """Arcs of the map, each (n, 2) metres (x, y) in the submap's frame."""
    return to_metres(lattice_lines(vector_map), vector_map.lattice)


def to_metres(lines: list[NDArray[np.int64]], lattice: Lattice) -> list[NDArray[np.float64]]:
    """Lines of lattice points (x, y) -> lines of metres (x, y) in the submap's frame."""
    if not lines:
        return []
    points_yx = np.concatenate(lines)[:, ::-1].astype(np.int32)
    return np.split(lattice.to_metres(points_yx), np.cumsum([len(line) for line in lines[:-1]]))


def pack_lattice(lattice: Lattice) -> bytes:
    """The header of codecs that send lattice points."""
    at = lattice.T_frame_lattice
    return LATTICE.pack(lattice.resolution_um, at.x_um, at.y_um, at.cos_q30, at.sin_q30)


def unpack_lattice(data: bytes) -> Lattice:
    """The lattice in the first ``LATTICE_BYTES`` of ``data``."""
    resolution_um, *at = LATTICE.unpack_from(data)
    return Lattice(resolution_um, FixedPose(*at))
