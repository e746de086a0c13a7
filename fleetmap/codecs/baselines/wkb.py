"""Well-known binary, as PostGIS and shapely exchange geometry: one MultiLineString of float64 metres."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.codecs.baselines.lines import metre_lines
from fleetmap.model.vectormap import VectorMap

LITTLE_ENDIAN = 1


def encode(vector_map: VectorMap) -> bytes:
    """16 B a vertex and 9 B a line."""
    import shapely

    data: bytes = shapely.to_wkb(shapely.MultiLineString(metre_lines(vector_map)), byte_order=LITTLE_ENDIAN)
    return data


def decode(data: bytes) -> list[NDArray[np.float64]]:
    """Lines in metres, exact."""
    import shapely

    return [shapely.get_coordinates(line) for line in shapely.get_parts(shapely.from_wkb(data))]
