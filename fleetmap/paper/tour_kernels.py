"""The compiled walk of a tour: always to the nearest place that was not visited yet."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.kernel import kernel


@kernel("int64[:,::1](boolean[:,::1], boolean[:,::1], int64, int64)")
def nearest_first(passable: NDArray[np.bool_], targets: NDArray[np.bool_], row: int, column: int) -> NDArray[np.int64]:
    """Cells (n, 2) of a walk from (row, column) past every target that can be reached.

    From each target a breadth-first search (eight neighbours, straight steps first, no cutting of corners)
    finds the next one. It ends there, so that a step costs about what lies between two targets.
    """
    height, width = passable.shape
    left = targets.copy()
    stamp = np.full((height, width), -1, np.int64)  # number of the search that has reached the cell
    came_from = np.empty((height, width), np.int64)
    queue = np.empty(height * width, np.int64)
    walk = np.empty((height * width, 2), np.int64)
    count = 1
    walk[0, 0], walk[0, 1] = row, column
    left[row, column] = False
    search = 0
    while True:
        stamp[row, column] = search
        queue[0] = row * width + column
        first, last, found = 0, 1, -1
        while first < last and found < 0:
            cell = queue[first]
            first += 1
            i, j = cell // width, cell % width
            for k in range(8):
                di, dj = (-1, 1, 0, 0, -1, -1, 1, 1)[k], (0, 0, -1, 1, -1, 1, -1, 1)[k]
                y, x = i + di, j + dj
                if y < 0 or x < 0 or y >= height or x >= width or not passable[y, x] or stamp[y, x] == search:
                    continue
                if k >= 4 and not (passable[i, x] and passable[y, j]):
                    continue
                stamp[y, x] = search
                came_from[y, x] = cell
                queue[last] = y * width + x
                last += 1
                if left[y, x]:
                    found = y * width + x
                    break
        if found < 0:
            return walk[:count].copy()
        steps, cell = 0, found
        while cell != row * width + column:
            steps += 1
            cell = came_from[cell // width, cell % width]
        if count + steps > walk.shape[0]:
            longer = np.empty((2 * walk.shape[0] + steps, 2), np.int64)
            longer[:count] = walk[:count]
            walk = longer
        cell = found
        for k in range(steps):
            i, j = cell // width, cell % width
            walk[count + steps - 1 - k, 0], walk[count + steps - 1 - k, 1] = i, j
            left[i, j] = False
            cell = came_from[i, j]
        count += steps
        row, column = found // width, found % width
        search += 1
