"""PNG: today's 8-bit grey of the cells, and a palette of three colours at 2 bits a cell."""

from __future__ import annotations

import io

import numpy as np

from fleetmap.codecs.baselines.protocol import HEADER_BYTES, Cells
from fleetmap.model.grid import OccupancyGrid

STATE_BITS = 2

GREYS = (254, 0, 205)
"""Of free, occupied and unknown cells in the images of map_server."""


def png_grid(grid: OccupancyGrid) -> int:
    """Return the bytes of the grid as an 8-bit grey PNG with best compression, and a header."""
    return HEADER_BYTES + len(pack_cells(grid.cells_yx))


def pack_cells(cells_yx: Cells) -> bytes:
    """(height, width) int8 cells -> an 8-bit grey image, 255 for unknown."""
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(cells_yx.view(np.uint8)).save(file, format="PNG", optimize=True)
    return file.getvalue()


def unpack_cells(data: bytes, shape: tuple[int, int]) -> Cells:
    """(height, width) int8 cells."""
    return unpack_states(data, shape).view(np.int8)


def pack_states(states_yx: Cells) -> bytes:
    """(height, width) states -> an image with a palette."""
    from PIL import Image

    image = Image.fromarray(states_yx)
    image.putpalette([channel for grey in GREYS for channel in (grey, grey, grey)])
    file = io.BytesIO()
    image.save(file, format="PNG", optimize=True, bits=STATE_BITS)
    return file.getvalue()


def unpack_states(data: bytes, shape: tuple[int, int]) -> Cells:
    """(height, width) uint8 states."""
    from PIL import Image

    with Image.open(io.BytesIO(data), formats=["PNG"]) as image:
        return np.array(image).reshape(shape)
