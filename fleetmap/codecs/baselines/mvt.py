"""Mapbox vector tile, as web maps are served: one layer with one feature, on the lattice."""

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
from fleetmap.codecs.baselines.protocol import require
from fleetmap.model.vectormap import VectorMap

LAYER = "lines"

UPRIGHT = {"y_coord_down": True}
"""Leaves y as it is; else the package turns it around."""


def encode(vector_map: VectorMap) -> bytes:
    """The lattice, and a tile whose coordinates are lattice points, also outside of its nominal extent."""
    from shapely import MultiLineString

    layer = {"name": LAYER, "features": [{"geometry": MultiLineString(lattice_lines(vector_map))}]}
    tile: bytes = require("mapbox_vector_tile").encode(layer, default_options=UPRIGHT)
    return pack_lattice(vector_map.lattice) + tile


def decode(data: bytes) -> list[NDArray[np.float64]]:
    """Lines in metres, exact."""
    from shapely import get_coordinates, get_parts
    from shapely.geometry import shape

    tile = require("mapbox_vector_tile").decode(data[LATTICE_BYTES:], default_options=UPRIGHT)
    lines = get_parts([shape(feature["geometry"]) for feature in tile[LAYER]["features"]])
    return to_metres([get_coordinates(line).astype(np.int64) for line in lines], unpack_lattice(data))
