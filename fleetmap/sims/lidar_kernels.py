"""Compiled ray casting on a grid of solid cells."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.kernel import kernel


@kernel("float64[::1](boolean[:,::1], float64, float64, float64, int64, float64)")
def cast(solid: NDArray[np.bool_], x: float, y: float, yaw: float, beams: int, reach: float) -> NDArray[np.float64]:
    """Distance to the first solid cell along each of ``beams`` rays, in cells; ``reach`` where there is none.

    (x, y) in cells from the grid's lower left corner. Beam k looks along yaw + 2 pi k / beams. The ray is
    followed from one cell border to the next, so the distance is that of the border: exact, no step size.
    """
    height, width = solid.shape
    out = np.full(beams, reach)
    for k in range(beams):
        angle = yaw + 2.0 * math.pi * k / beams
        dx, dy = math.cos(angle), math.sin(angle)
        i, j = int(math.floor(y)), int(math.floor(x))
        step_i, step_j = (1 if dy > 0 else -1), (1 if dx > 0 else -1)
        per_x = 1.0 / abs(dx) if dx != 0.0 else math.inf
        per_y = 1.0 / abs(dy) if dy != 0.0 else math.inf
        next_x = (j + 1 - x if dx > 0 else x - j) * per_x if dx != 0.0 else math.inf
        next_y = (i + 1 - y if dy > 0 else y - i) * per_y if dy != 0.0 else math.inf
        while True:
            if next_x < next_y:
                distance = next_x
                next_x += per_x
                j += step_j
            else:
                distance = next_y
                next_y += per_y
                i += step_i
            if distance >= reach or i < 0 or j < 0 or i >= height or j >= width:
                break
            if solid[i, j]:
                out[k] = distance
                break
    return out


@kernel("boolean(boolean[:,::1], float64, float64, float64)")
def touches(solid: NDArray[np.bool_], x: float, y: float, radius: float) -> bool:
    """Whether the open disc of ``radius`` cells about (x, y) meets a solid cell's square; outside is solid."""
    height, width = solid.shape
    for i in range(int(math.floor(y - radius)), int(math.floor(y + radius)) + 1):
        dy = max(i - y, y - (i + 1), 0.0)
        for j in range(int(math.floor(x - radius)), int(math.floor(x + radius)) + 1):
            dx = max(j - x, x - (j + 1), 0.0)
            if dx * dx + dy * dy >= radius * radius:
                continue
            if i < 0 or j < 0 or i >= height or j >= width or solid[i, j]:
                return True
    return False
