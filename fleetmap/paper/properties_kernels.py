"""Compiled: how thick the occupied skin is behind each crack between a free cell and an occupied one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.kernel import kernel


@kernel("int64[::1](uint8[:,::1], int64)")
def skin_counts(states: NDArray[np.uint8], longest: int) -> NDArray[np.int64]:
    """(longest + 1,) how many cracks have so many occupied cells behind them; the last counts longer ones, too.

    States are 0 free, 1 occupied, 2 unknown. From the crack the cells are followed along its normal, away from
    the free cell, until one is not occupied or the grid ends.
    """
    height, width = states.shape
    counts = np.zeros(longest + 1, np.int64)
    for i in range(height):
        for j in range(width):
            if states[i, j] != 0:
                continue
            for side in range(4):
                di, dj = (1, -1, 0, 0)[side], (0, 0, 1, -1)[side]
                y, x, thick = i + di, j + dj, 0
                while 0 <= y < height and 0 <= x < width and states[y, x] == 1:
                    thick += 1
                    y += di
                    x += dj
                if thick > 0:
                    counts[min(thick, longest)] += 1
    return counts
