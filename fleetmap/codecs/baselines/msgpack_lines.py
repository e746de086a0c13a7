"""msgpack, in the two ways that come to mind: lines of float32 metres, and segments of whole numbers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.codecs.baselines.lines import (
    LATTICE_BYTES,
    metre_lines,
    pack_lattice,
    to_metres,
    unpack_lattice,
)
from fleetmap.model.vectormap import VectorMap


def encode_lines(vector_map: VectorMap) -> bytes:
    """A list with 8 B a vertex, x and y in metres as little-endian float32, in one bin for each line."""
    import msgpack

    data: bytes = msgpack.packb([line.astype("<f4").tobytes() for line in metre_lines(vector_map)])
    return data


def decode_lines(data: bytes) -> list[NDArray[np.float64]]:
    """Lines in metres, to float32's seven digits."""
    import msgpack

    return [np.frombuffer(line, "<f4").reshape(-1, 2).astype(np.float64) for line in msgpack.unpackb(data)]


def encode_segments(vector_map: VectorMap) -> bytes:
    """The lattice, and a flat list x0, y0, x1, y1, x0, ... of lattice points in msgpack's integers."""
    import msgpack

    ends_xy = vector_map.edges[:, [1, 0, 3, 2]]
    return pack_lattice(vector_map.lattice) + bytes(msgpack.packb(ends_xy.ravel().tolist()))


def decode_segments(data: bytes) -> list[NDArray[np.float64]]:
    """Lines of two vertices each, in metres, exact."""
    import msgpack

    segments = np.array(msgpack.unpackb(data[LATTICE_BYTES:]), np.int64).reshape(-1, 2, 2)
    return to_metres(list(segments), unpack_lattice(data))
