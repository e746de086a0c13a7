"""WebP without loss, at its slowest and smallest."""

from __future__ import annotations

import io

import numpy as np

from fleetmap.codecs.baselines.protocol import Cells

METHOD, QUALITY = 6, 100
"""Both the most effort; quality is no quality in the lossless mode."""


def pack(states_yx: Cells) -> bytes:
    """(height, width) states -> an image that is grey; at most 16383 cells a side, which is WebP's limit."""
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(states_yx).save(file, format="WEBP", lossless=True, method=METHOD, quality=QUALITY)
    return file.getvalue()


def unpack(data: bytes, shape: tuple[int, int]) -> Cells:
    """(height, width) uint8 states."""
    from PIL import Image

    with Image.open(io.BytesIO(data), formats=["WEBP"]) as image:
        return np.array(image)[..., 0].reshape(shape)
