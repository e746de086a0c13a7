"""What others would have sent: the same map as a compressed grid, or as vectors in a format that others know.

Each size is that of one message to one receiver, with its header. Packages are imported when a codec is used:
``pip install 'fleetmap[baselines]'`` brings those that fleetmap itself does not need.
"""

from __future__ import annotations

from functools import partial

from fleetmap.codecs.baselines import (
    geobuf,
    geojson,
    gzip_cells,
    jpeg_xl,
    msgpack_lines,
    mvt,
    png,
    quadtree,
    run_lengths,
    sparse,
    twkb,
    webp,
    wkb,
    zstd_states,
)
from fleetmap.codecs.baselines.changed_rectangle import exact_changed_rectangle, gzip_changed_rectangle
from fleetmap.codecs.baselines.gzip_cells import gzip_grid
from fleetmap.codecs.baselines.png import png_grid
from fleetmap.codecs.baselines.protocol import EXTRA, HEADER_BYTES, GridBaseline, VectorBaseline, available

__all__ = [
    "GRID_BASELINES",
    "HEADER_BYTES",
    "VECTOR_BASELINES",
    "GridBaseline",
    "VectorBaseline",
    "available",
    "exact_changed_rectangle",
    "gzip_changed_rectangle",
    "gzip_grid",
    "png_grid",
    "unavailable",
]

GRID_BASELINES = {
    codec.name: codec
    for codec in (
        GridBaseline("gzip6", "cells", partial(gzip_cells.pack, level=6), gzip_cells.unpack),
        GridBaseline("gzip9", "cells", partial(gzip_cells.pack, level=9), gzip_cells.unpack),
        GridBaseline("jpeg_xl", "states", jpeg_xl.pack, jpeg_xl.unpack, "pylibjxl"),
        GridBaseline("png", "cells", png.pack_cells, png.unpack_cells),
        GridBaseline("png_states", "states", png.pack_states, png.unpack_states),
        GridBaseline("quadtree", "states", quadtree.pack, quadtree.unpack),
        GridBaseline("run_lengths", "states", run_lengths.pack, run_lengths.unpack),
        GridBaseline("sparse", "states", sparse.pack, sparse.unpack),
        GridBaseline("webp", "states", webp.pack, webp.unpack),
        GridBaseline("zstd3", "states", partial(zstd_states.pack, level=3), zstd_states.unpack, "zstandard"),
        GridBaseline("zstd19", "states", partial(zstd_states.pack, level=19), zstd_states.unpack, "zstandard"),
    )
}
"""Ways to send a grid, by name."""

VECTOR_BASELINES = {
    codec.name: codec
    for codec in (
        VectorBaseline("geobuf", geobuf.encode, geobuf.decode, 0.00071, "geobuf"),
        VectorBaseline("geojson", geojson.encode, geojson.decode, 0.00071),
        VectorBaseline("msgpack_lines", msgpack_lines.encode_lines, msgpack_lines.decode_lines, 0.0001),
        VectorBaseline("msgpack_segments", msgpack_lines.encode_segments, msgpack_lines.decode_segments, 0.0),
        VectorBaseline("mvt", mvt.encode, mvt.decode, 0.0, "mapbox_vector_tile"),
        VectorBaseline("twkb", twkb.encode, twkb.decode, 0.0),
        VectorBaseline("wkb", wkb.encode, wkb.decode, 0.0),
    )
}
"""Ways to send the lines of a vector map, by name."""


def unavailable() -> dict[str, str]:
    """The codecs whose package is missing, each with the extra that installs it."""
    codecs: tuple[GridBaseline | VectorBaseline, ...] = (*GRID_BASELINES.values(), *VECTOR_BASELINES.values())
    return {codec.name: f"fleetmap[{EXTRA}]" for codec in codecs if not available(codec)}
