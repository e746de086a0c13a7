"""Geobuf: GeoJSON in protocol buffers, each coordinate a step from the one before."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.codecs.baselines.lines import metre_lines
from fleetmap.codecs.baselines.protocol import require
from fleetmap.model.vectormap import VectorMap

DIGITS = 3
"""Behind the point: millimetres, which a 5 cm cell does not miss."""


def encode(vector_map: VectorMap) -> bytes:
    """One MultiLineString, coordinates to the millimetre."""
    lines = [line.tolist() for line in metre_lines(vector_map)]
    data: bytes = require("geobuf").encode({"type": "MultiLineString", "coordinates": lines}, DIGITS)
    return data


def decode(data: bytes) -> list[NDArray[np.float64]]:
    """Lines in metres, each coordinate to half a millimetre."""
    lines = require("geobuf").decode(data)["coordinates"]
    return [np.array(line, np.float64) for line in lines if line]  # no lines come back as one without vertices
