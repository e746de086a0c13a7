"""Bytes of one map in each format: the paper's four, and our own. Each is a function of the map alone."""

from __future__ import annotations

import io
import zipfile

import numpy as np

from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.vectormap import VectorMap

ZIP_LEVEL = 9
"""Of deflate, in a zip archive with one entry; the paper says "zipped" and no more."""

FORMATS = {
    "pgm": "grid PGM",
    "pgm_zip": "grid PGM, zip",
    "plain": "plain vectors",
    "plain_zip": "plain vectors, zip",
    "fleetmap": "fleetmap",
}
"""Keys of sizes, and what they are called in tables. The first four are the paper's P, PZ, V and VZ."""


def grid_sizes(grid: OccupancyGrid) -> dict[str, int]:
    """Bytes of the grid as an image, and of that zipped."""
    image = pgm(grid)
    return {"pgm": len(image), "pgm_zip": len(zipped(image, "map.pgm"))}


def vector_sizes(vector_map: VectorMap) -> dict[str, int]:
    """Bytes of the vector map as plain segments, of those zipped, and of a snapshot as it goes on the air."""
    from fleetmap.codecs.protocol import encode_snapshot

    segments = plain(vector_map)
    return {
        "plain": len(segments),
        "plain_zip": len(zipped(segments, "map.bin")),
        "fleetmap": len(encode_snapshot(vector_map, mode=None)),
    }


def pgm(grid: OccupancyGrid) -> bytes:
    """The image that map_saver writes, one byte a cell, as ``save_map`` does."""
    from PIL import Image

    from fleetmap.model.map_server import GREY_FREE, GREY_OCCUPIED, GREY_UNKNOWN

    file = io.BytesIO()
    greys = np.array([GREY_FREE, GREY_OCCUPIED, GREY_UNKNOWN], np.uint8)
    Image.fromarray(greys[grid.states_yx()[::-1]]).save(file, format="PPM")
    return file.getvalue()


def plain(vector_map: VectorMap) -> bytes:
    """Per edge x0, y0, x1, y1 in metres as little-endian float32: 16 B, without label and thickness."""
    return vector_map.segments_xy.astype("<f4").tobytes()


def zipped(data: bytes, name: str) -> bytes:
    """A zip archive with this one file in it; no time goes into it."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr(zipfile.ZipInfo(name), data, zipfile.ZIP_DEFLATED, ZIP_LEVEL)
    return file.getvalue()
