"""JPEG XL without loss: the strongest codec for images that one can install today."""

from __future__ import annotations

import numpy as np

from fleetmap.codecs.baselines.protocol import Cells, require

EFFORT = 9
"""The highest that the format's own tool offers without asking for its experts' mode."""

ONE_THREAD = {"threads": 1, "pool_size": 1}
"""As all the others, so that times compare; the bytes do not depend on it."""


def pack(states_yx: Cells) -> bytes:
    """(height, width) states -> a grey image."""
    with require("pylibjxl").JXL(effort=EFFORT, lossless=True, **ONE_THREAD) as codec:
        return bytes(codec.encode(states_yx))


def unpack(data: bytes, shape: tuple[int, int]) -> Cells:
    """(height, width) uint8 states."""
    with require("pylibjxl").JXL(**ONE_THREAD) as codec:
        return np.asarray(codec.decode(data), np.uint8).reshape(shape)
