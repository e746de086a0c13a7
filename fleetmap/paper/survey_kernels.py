"""Compiled beams: what they pass and where they end, counted by cell as Karto counts them; and what is in sight."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.kernel import kernel


@kernel("void(int32[:,::1], int32[:,::1], float64, float64, float64, float64[::1], float64)")
def count_beams(
    passes: NDArray[np.int32],
    hits: NDArray[np.int32],
    x: float,
    y: float,
    yaw: float,
    ranges: NDArray[np.float64],
    reach: float,
) -> None:
    """Add one scan. (x, y) and all lengths are in cells; beam k looks along yaw + 2 pi k / beams.

    Each beam is a Bresenham line from the sensor's cell to that of its end, every cell of which counts a pass.
    Where the beam returned from within ``reach``, its last cell counts one pass and one hit more; else it is cut
    off there.
    """
    height, width = passes.shape
    beams = ranges.shape[0]
    row, column = int(math.floor(y)), int(math.floor(x))
    for k in range(beams):
        angle = yaw + 2.0 * math.pi * k / beams
        returned = ranges[k] < reach
        length = min(ranges[k], reach)
        end_i = int(math.floor(y + length * math.sin(angle)))
        end_j = int(math.floor(x + length * math.cos(angle)))
        rows, columns = abs(end_i - row), abs(end_j - column)
        step_i, step_j = (1 if end_i > row else -1), (1 if end_j > column else -1)
        error = columns - rows
        i, j = row, column
        while True:
            if 0 <= i < height and 0 <= j < width:
                passes[i, j] += 1
            if i == end_i and j == end_j:
                break
            twice = 2 * error
            if twice > -rows:
                error -= rows
                j += step_j
            if twice < columns:
                error += columns
                i += step_i
        if returned and 0 <= end_i < height and 0 <= end_j < width:
            passes[end_i, end_j] += 1
            hits[end_i, end_j] += 1


@kernel("void(boolean[:,::1], boolean[:,::1], float64, float64, int64, float64)")
def look_around(
    solid: NDArray[np.bool_], seen: NDArray[np.bool_], x: float, y: float, beams: int, reach: float
) -> None:
    """Mark the open cells that exact beams from (x, y) pass before they meet a solid one; lengths in cells."""
    height, width = solid.shape
    for k in range(beams):
        angle = 2.0 * math.pi * (k + 0.5) / beams
        dx, dy = math.cos(angle), math.sin(angle)
        i, j = int(math.floor(y)), int(math.floor(x))
        step_i, step_j = (1 if dy > 0 else -1), (1 if dx > 0 else -1)
        per_x, per_y = 1.0 / abs(dx), 1.0 / abs(dy)
        next_x = (j + 1 - x if dx > 0 else x - j) * per_x
        next_y = (i + 1 - y if dy > 0 else y - i) * per_y
        while 0 <= i < height and 0 <= j < width and not solid[i, j]:
            seen[i, j] = True
            if min(next_x, next_y) >= reach:
                break
            if next_x < next_y:
                next_x += per_x
                j += step_j
            else:
                next_y += per_y
                i += step_i
