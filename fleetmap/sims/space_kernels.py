"""Compiled loops over grids: clearance from blocked cells, travel cost from one cell, straight lines.

Cells are (row, column); distances between a cell's centre and a blocked cell are to the nearest point of
that cell's *square*, in half cells, squared: whole numbers, and never longer than the true distance.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.kernel import kernel

FAR = np.int32(2**30)
"""Cost of a cell that can't be reached."""


@kernel("int32[:,::1](boolean[:,::1], int64)")
def clearance2(blocked: NDArray[np.bool_], reach: int) -> NDArray[np.int32]:
    """Squared clearance of each cell in half cells, exact up to ``reach`` cells, at most (2 reach)^2 + 1.

    Only blocked cells with an open neighbour are stamped: the others are farther from any open cell.
    """
    height, width = blocked.shape
    cap = np.int32(4 * reach * reach + 1)
    out = np.full((height, width), cap, np.int32)
    for i in range(height):
        for j in range(width):
            if not blocked[i, j]:
                continue
            out[i, j] = 0
            surrounded = (
                i > 0
                and blocked[i - 1, j]
                and i < height - 1
                and blocked[i + 1, j]
                and j > 0
                and blocked[i, j - 1]
                and j < width - 1
                and blocked[i, j + 1]
            )
            if surrounded:
                continue
            for y in range(max(i - reach, 0), min(i + reach + 1, height)):
                dy = max(2 * abs(y - i) - 1, 0)
                for x in range(max(j - reach, 0), min(j + reach + 1, width)):
                    dx = max(2 * abs(x - j) - 1, 0)
                    near = np.int32(dy * dy + dx * dx)
                    if near < out[y, x]:
                        out[y, x] = near
    return out


@kernel("uint8[:,::1](uint8[:,::1], int32[:,::1], int64[::1], uint8[::1])")
def prices(
    states: NDArray[np.uint8], clearance: NDArray[np.int32], least: NDArray[np.int64], price: NDArray[np.uint8]
) -> NDArray[np.uint8]:
    """What entering each cell costs: ``price[k]`` of the last k with clearance >= ``least[k]``; 0 unless free."""
    height, width = states.shape
    out = np.zeros((height, width), np.uint8)
    for i in range(height):
        for j in range(width):
            if states[i, j] == 0:
                for k in range(least.shape[0]):
                    if clearance[i, j] >= least[k]:
                        out[i, j] = price[k]
    return out


@kernel("int64[:,::1](uint8[:,::1], int64)")
def frontier_cells(states: NDArray[np.uint8], least: int) -> NDArray[np.int64]:
    """Free cells (n, 2), row by row, beside an unknown region (4-connected) of at least ``least`` cells."""
    height, width = states.shape
    verdict = np.zeros((height, width), np.uint8)  # of unknown cells: 1 in a large region, 2 in a pocket
    queue = np.empty((least, 2), np.int64)
    found = np.empty((height * width, 2), np.int64)
    count = 0
    for i in range(height):
        for j in range(width):
            if states[i, j] != 0:
                continue
            for side in range(4):
                y = i + (1 if side == 0 else -1 if side == 1 else 0)
                x = j + (1 if side == 2 else -1 if side == 3 else 0)
                if y < 0 or x < 0 or y >= height or x >= width or states[y, x] != 2:
                    continue
                if verdict[y, x] == 0:
                    # Flood until the region is known to be large, or is exhausted.
                    verdict[y, x] = 2
                    queue[0, 0], queue[0, 1] = y, x
                    done, filled, large = 0, 1, least == 1
                    while done < filled and not large:
                        for turn in range(4):
                            v = queue[done, 0] + (1 if turn == 0 else -1 if turn == 1 else 0)
                            u = queue[done, 1] + (1 if turn == 2 else -1 if turn == 3 else 0)
                            if v < 0 or u < 0 or v >= height or u >= width or states[v, u] != 2:
                                continue
                            if verdict[v, u] == 1:
                                large = True
                            elif verdict[v, u] == 0:
                                verdict[v, u] = 2
                                queue[filled, 0], queue[filled, 1] = v, u
                                filled += 1
                                large = large or filled == least
                            if large:
                                break
                        done += 1
                    if large:
                        for k in range(filled):
                            verdict[queue[k, 0], queue[k, 1]] = 1
                if verdict[y, x] == 1:
                    found[count, 0], found[count, 1] = i, j
                    count += 1
                    break
    return found[:count].copy()


@kernel("int32[:,::1](uint8[:,::1], int64, int64)")
def cost_field(price: NDArray[np.uint8], row: int, column: int) -> NDArray[np.int32]:
    """Least cost from (row, column) to every cell: steps cost 10 or 14 times the entered cell's ``price``.

    A price of 0 is a wall; the start may lie in one. A diagonal step needs both cells beside it. Dial's
    bucket queue with doubly linked lists: each cell is settled once, and no heap is needed because the
    costs are small whole numbers.
    """
    height, width = price.shape
    dearest = 1
    for i in range(height):
        for j in range(width):
            dearest = max(dearest, int(price[i, j]))
    buckets = 14 * dearest + 1
    out = np.full((height, width), FAR, np.int32)
    head = np.full(buckets, -1, np.int32)
    after = np.full(height * width, -1, np.int32)
    before = np.full(height * width, -1, np.int32)
    out[row, column] = 0
    head[0] = row * width + column
    now, waiting = 0, 1
    while waiting > 0:
        slot = now % buckets
        cell = head[slot]
        if cell < 0:
            now += 1
            continue
        head[slot] = after[cell]
        if after[cell] >= 0:
            before[after[cell]] = -1
        waiting -= 1
        i, j = cell // width, cell % width
        for di in range(-1, 2):
            for dj in range(-1, 2):
                y, x = i + di, j + dj
                if (di == 0 and dj == 0) or y < 0 or x < 0 or y >= height or x >= width or price[y, x] == 0:
                    continue
                if di != 0 and dj != 0 and (price[i, x] == 0 or price[y, j] == 0):
                    continue
                cost = now + (14 if di != 0 and dj != 0 else 10) * int(price[y, x])
                if cost >= out[y, x]:
                    continue
                other = y * width + x
                if out[y, x] < FAR:  # it waits in another bucket: unlink it there
                    if before[other] >= 0:
                        after[before[other]] = after[other]
                    else:
                        head[out[y, x] % buckets] = after[other]
                    if after[other] >= 0:
                        before[after[other]] = before[other]
                else:
                    waiting += 1
                out[y, x] = cost
                first = head[cost % buckets]
                after[other] = first
                before[other] = -1
                if first >= 0:
                    before[first] = other
                head[cost % buckets] = other
    return out


@kernel("int64[:,::1](int32[:,::1], uint8[:,::1], int64, int64)")
def descend(cost: NDArray[np.int32], price: NDArray[np.uint8], row: int, column: int) -> NDArray[np.int64]:
    """Cells (n, 2) from where ``cost`` is 0 to (row, column), which must be reachable."""
    height, width = cost.shape
    cells = np.empty((height * width, 2), np.int64)
    count = 0
    i, j = row, column
    while True:
        cells[count, 0], cells[count, 1] = i, j
        count += 1
        if cost[i, j] == 0:
            break
        best, bi, bj = cost[i, j], i, j
        for di in range(-1, 2):
            for dj in range(-1, 2):
                y, x = i + di, j + dj
                if y < 0 or x < 0 or y >= height or x >= width or cost[y, x] >= best:
                    continue
                # Against the direction of travel, the same corner rule as in cost_field.
                if di != 0 and dj != 0 and (price[y, j] == 0 or price[i, x] == 0):
                    continue
                step = (14 if di != 0 and dj != 0 else 10) * int(price[i, j])
                if cost[y, x] + step == cost[i, j]:
                    best, bi, bj = cost[y, x], y, x
        if bi == i and bj == j:
            break
        i, j = bi, bj
    return cells[:count][::-1].copy()


@kernel("int64(uint8[:,::1], int64, int64, int64, int64)")
def dearest_on_line(price: NDArray[np.uint8], row0: int, column0: int, row1: int, column1: int) -> int:
    """Highest price of the cells that the segment between two cell centres passes; 255 if one is 0."""
    i, j = row0, column0
    rows, columns = abs(row1 - row0), abs(column1 - column0)
    step_i, step_j = (1 if row1 > row0 else -1), (1 if column1 > column0 else -1)
    highest = 0
    side = columns - rows  # sign says which border of the current cell the segment crosses next
    for _ in range(rows + columns + 1):
        if price[i, j] == 0:
            return 255
        highest = max(highest, int(price[i, j]))
        if i == row1 and j == column1:
            break
        if side > 0:
            j += step_j
            side -= 2 * rows
        elif side < 0:
            i += step_i
            side += 2 * columns
        else:  # through a corner: both neighbours count
            if price[i + step_i, j] == 0 or price[i, j + step_j] == 0:
                return 255
            i += step_i
            j += step_j
            side += 2 * (columns - rows)
    return highest


@kernel(
    "void(uint8[:,::1], int64, int64, uint8[:,::1], int64, int64, float64, float64, float64, float64)",
)
def overlay(
    states: NDArray[np.uint8],
    low_y: int,
    low_x: int,
    own: NDArray[np.uint8],
    own_y: int,
    own_x: int,
    cos: float,
    sin: float,
    x: float,
    y: float,
) -> None:
    """Write into ``states`` whatever ``own`` knows at the same place; lattice units are cells on both sides.

    ``own`` lies in a frame that (cos, sin, x, y) turns and moves into that of ``states``; each cell of
    ``states`` takes the cell of ``own`` that its centre falls into.
    """
    height, width = states.shape
    own_height, own_width = own.shape
    for i in range(height):
        fy = low_y + i + 0.5 - y
        for j in range(width):
            fx = low_x + j + 0.5 - x
            column = int(math.floor(cos * fx + sin * fy)) - own_x
            row = int(math.floor(cos * fy - sin * fx)) - own_y
            if 0 <= row < own_height and 0 <= column < own_width and own[row, column] != 2:
                states[i, j] = own[row, column]


@kernel("int64[::1](int32[:,::1], uint8[:,::1], int64, int64, int64)")
def viewpoint(
    cost: NDArray[np.int32], open_cells: NDArray[np.uint8], row: int, column: int, reach: int
) -> NDArray[np.int64]:
    """Cheapest reachable cell within ``reach`` cells from which (row, column) is seen; (-1, -1) if none."""
    height, width = cost.shape
    out = np.full(2, -1, np.int64)
    best = FAR
    for i in range(max(row - reach, 0), min(row + reach + 1, height)):
        for j in range(max(column - reach, 0), min(column + reach + 1, width)):
            if cost[i, j] >= best or (i - row) ** 2 + (j - column) ** 2 > reach * reach:
                continue
            if dearest_on_line(open_cells, i, j, row, column) < 255:
                best = cost[i, j]
                out[0], out[1] = i, j
    return out
