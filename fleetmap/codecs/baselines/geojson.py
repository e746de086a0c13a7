"""GeoJSON, as web tools exchange geometry: one MultiLineString of metres, written out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.codecs.baselines.lines import metre_lines
from fleetmap.model.vectormap import VectorMap

DIGITS = 3
"""Behind the point: millimetres, which a 5 cm cell does not miss."""


def encode(vector_map: VectorMap) -> bytes:
    """Text, coordinates to the millimetre."""
    import shapely

    lines = shapely.MultiLineString([line.round(DIGITS) for line in metre_lines(vector_map)])
    return str(shapely.to_geojson(lines)).encode()


def decode(data: bytes) -> list[NDArray[np.float64]]:
    """Lines in metres, each coordinate to half a millimetre."""
    import shapely

    return [shapely.get_coordinates(line) for line in shapely.get_parts(shapely.from_geojson(data))]
