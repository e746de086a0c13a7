"""placeholder until the measured one lands"""

from __future__ import annotations

import numpy as np

from fleetmap.model.vectormap import VectorMap

MAX_EDGES = 250_000
MAX_EDGES_IN_SQUARE = 16_384


def check_density(vector_map: VectorMap, *, max_edges: int, max_edges_in_square: int) -> str | None:
    if len(vector_map) > max_edges:
        return f"more than {max_edges} edges"
    if len(vector_map) > max_edges_in_square:
        square = vector_map.edges[:, 0].astype(np.int64) // 256 * (1 << 32) + vector_map.edges[:, 1] // 256
        if int(np.unique(square, return_counts=True)[1].max()) > max_edges_in_square:
            return f"more than {max_edges_in_square} edges in a square of 256 cells"
    return None
