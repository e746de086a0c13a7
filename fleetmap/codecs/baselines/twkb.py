"""Tiny well-known binary: one MultiLineString on the lattice, each coordinate a step from the one before.

No library for Python writes it (PostGIS does, ``ST_AsTWKB``), so the few lines that it takes are here. The format:
https://github.com/TWKB/Specification/blob/master/twkb.md
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.codecs.baselines.lines import (
    LATTICE_BYTES,
    lattice_lines,
    pack_lattice,
    to_metres,
    unpack_lattice,
)
from fleetmap.codecs.leb128 import decode_leb128, encode_leb128, unzigzag, zigzag
from fleetmap.model.vectormap import VectorMap

MULTI_LINE_STRING = bytes([5, 0])
"""The type, with no digits behind the point; and no bounding box, size, names or third dimension."""

EMPTY = bytes([5, 16])
"""The same without any line."""


def encode(vector_map: VectorMap) -> bytes:
    """The lattice, how many lines, for each how many vertices and their steps (dx, dy); zigzag, seven bits a byte."""
    lines = lattice_lines(vector_map)
    if not lines:
        return pack_lattice(vector_map.lattice) + EMPTY
    points = np.concatenate(lines)
    steps = zigzag(np.diff(points, axis=0, prepend=[[0, 0]])).ravel()
    counts = np.array([len(line) for line in lines])
    # Each line's count stands in front of its steps, of which it has two a vertex.
    numbers = np.insert(steps, 2 * (np.cumsum(counts) - counts), counts)
    return pack_lattice(vector_map.lattice) + MULTI_LINE_STRING + encode_leb128(np.insert(numbers, 0, len(lines)))


def decode(data: bytes) -> list[NDArray[np.float64]]:
    """Lines in metres, exact."""
    start = LATTICE_BYTES + len(MULTI_LINE_STRING)
    if data[LATTICE_BYTES:start] == EMPTY:
        return []
    numbers = decode_leb128(data[start:])
    lines, at, last = [], 1, np.zeros(2, np.int64)
    for _ in range(numbers[0]):
        end = at + 1 + 2 * int(numbers[at])
        lines.append(last + np.cumsum(unzigzag(numbers[at + 1 : end]).reshape(-1, 2), axis=0))
        at, last = end, lines[-1][-1]
    return to_metres(lines, unpack_lattice(data))
