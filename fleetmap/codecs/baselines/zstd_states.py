"""Zstandard of one byte a cell, as a fleet that has outgrown gzip would send it."""

from __future__ import annotations

import numpy as np

from fleetmap.codecs.baselines.protocol import Cells, require


def pack(states_yx: Cells, *, level: int) -> bytes:
    """(height, width) states -> a frame of Zstandard."""
    data: bytes = require("zstandard").ZstdCompressor(level=level).compress(states_yx.tobytes())
    return data


def unpack(data: bytes, shape: tuple[int, int]) -> Cells:
    """(height, width) uint8 states."""
    return np.frombuffer(require("zstandard").ZstdDecompressor().decompress(data), np.uint8).reshape(shape)
