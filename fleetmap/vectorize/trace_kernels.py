"""Numba kernels that look at cells: specks, and the boundary of free space."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

# Literals, since numba compiles globals in: FREE = 0, OCCUPIED = 1, UNKNOWN = 2.


@njit("Tuple((i8, i8))(u1[:,::1], u1[:,::1], i8, i8)", cache=True, nogil=True)
def fill_specks(states: NDArray[np.uint8], filled: NDArray[np.uint8], most: int, apart: int) -> tuple[int, int]:
    """Give free and unknown components of at most ``most`` cells the state that prevails around them.

    ``states`` has a rim of unknown cells; ``filled`` starts as a copy of it. Returns the number of such
    components and of their cells. A free one is kept where no other free cell is within ``apart`` rows and
    columns of its first cell. Unknown ones come last, so that they become free only beside free cells that
    stay. Occupied cells are never touched. Components are 4-connected; free cells also meet at a corner if the
    two other cells there are unknown, as a beam leaves them.
    """
    height, width = states.shape
    seen = np.zeros((height, width), np.uint8)  # 1 visited, 2 part of a component that is large enough
    queue = np.empty((max(most, 1), 2), np.int64)
    around = np.zeros(3, np.int64)
    specks = 0
    cells = 0
    free_cells = 0
    for i in range(height):
        for j in range(width):
            free_cells += states[i, j] == 0
    stack = np.empty((free_cells, 2), np.int32)  # cells of free specks, one after the other
    ends = np.empty(free_cells, np.int64)
    stacked = 0
    free_specks = 0
    for state in (0, 2):
        for i in range(1, height - 1):
            for j in range(1, width - 1):
                if states[i, j] != state or seen[i, j] != 0:
                    continue
                # A neighbour that was already found to be in a large component decides without a search.
                if (states[i, j - 1] == state and seen[i, j - 1] == 2) or (
                    states[i - 1, j] == state and seen[i - 1, j] == 2
                ):
                    seen[i, j] = 2
                    continue
                around[:] = 0
                queue[0, 0], queue[0, 1] = i, j
                seen[i, j] = 1
                count = 1
                head = 0
                large = most < 1
                while head < count and not large:
                    y, x = queue[head, 0], queue[head, 1]
                    head += 1
                    for d in range(8 if state == 0 else 4):
                        ny = y + (d == 1) - (d == 3)
                        nx = x + (d == 0) - (d == 2)
                        if d > 3:
                            ny = y + 2 * (d & 1) - 1
                            nx = x + (d & 2) - 1
                            if states[ny, x] != 2 or states[y, nx] != 2:
                                continue
                        if states[ny, nx] != state:
                            around[filled[ny, nx]] += d < 4
                        elif seen[ny, nx] == 2 or ny == 0 or nx == 0 or ny == height - 1 or nx == width - 1:
                            large = True
                        elif seen[ny, nx] == 0:
                            if count == most:
                                large = True
                            else:
                                seen[ny, nx] = 1
                                queue[count, 0], queue[count, 1] = ny, nx
                                count += 1
                        if large:
                            break
                if large:
                    for k in range(count):
                        seen[queue[k, 0], queue[k, 1]] = 2
                    continue
                if around[1] >= around[0] + around[2]:
                    prevailing = 1
                elif around[0] >= around[2]:
                    prevailing = 0
                else:
                    prevailing = 2
                for k in range(count):
                    filled[queue[k, 0], queue[k, 1]] = prevailing
                    if state == 0:
                        stack[stacked, 0], stack[stacked, 1] = queue[k, 0], queue[k, 1]
                        stacked += 1
                if state == 0:
                    ends[free_specks] = stacked
                    free_specks += 1
                if prevailing != state:
                    specks += 1
                    cells += count
        first = 0
        for s in range(free_specks if state == 0 else 0):
            i, j = stack[first, 0], stack[first, 1]
            alone = True
            for y in range(max(i - apart, 0), min(i + apart + 1, height)):
                for x in range(max(j - apart, 0), min(j + apart + 1, width)):
                    if filled[y, x] == 0:
                        alone = False
                        break
                if not alone:
                    break
            if alone:
                for k in range(first, ends[s]):
                    filled[stack[k, 0], stack[k, 1]] = 0
                specks -= 1
                cells -= ends[s] - first
            first = ends[s]
    return specks, cells


@njit("Tuple((i4[:,::1], u1[::1], u1[::1], i8[::1]))(u1[:,::1])", cache=True, nogil=True)
def trace(
    states: NDArray[np.uint8],
) -> tuple[NDArray[np.int32], NDArray[np.uint8], NDArray[np.uint8], NDArray[np.int64]]:
    """Walk along the boundary of free space, loop after loop, free space on the left.

    ``states`` has a rim of unknown cells. Returns the lattice points (y, x) of all loops, one a unit step,
    (0, 0) being the corner inside the rim; the state to the right of the step that leaves each point; whether
    the walk turns there; and the loops' offsets. Free cells that meet at a corner are connected there if both
    other cells are unknown.
    """
    height, width = states.shape
    total = 0
    for i in range(1, height):
        for j in range(1, width):
            free = states[i, j] == 0
            total += free != (states[i - 1, j] == 0)
            total += free != (states[i, j - 1] == 0)
    points = np.empty((total, 2), np.int32)
    right = np.empty(total, np.uint8)
    turns = np.empty(total, np.uint8)
    offsets = np.empty(total // 4 + 1, np.int64)
    offsets[0] = 0
    loops = 0
    count = 0
    done = np.zeros((height, width), np.uint8)  # steps towards +x below this cell that were walked
    for i in range(1, height - 1):
        for j in range(1, width - 1):
            # Every loop has a step towards +x, with a free cell above and another below.
            if states[i, j] != 0 or states[i - 1, j] == 0 or done[i, j] != 0:
                continue
            y, x, d = i, j, 0  # (y, x) is the corner between the cells y - 1, y and x - 1, x
            beside = states[i - 1, j]
            first = count
            turned = False
            while True:
                points[count, 0] = y - 1
                points[count, 1] = x - 1
                right[count] = beside
                turns[count] = turned
                count += 1
                if d == 0:
                    done[y, x] = 1
                    x += 1
                    ahead_left, ahead_right = states[y, x], states[y - 1, x]
                elif d == 1:
                    y += 1
                    ahead_left, ahead_right = states[y, x - 1], states[y, x]
                elif d == 2:
                    x -= 1
                    ahead_left, ahead_right = states[y - 1, x - 1], states[y, x - 1]
                else:
                    y -= 1
                    ahead_left, ahead_right = states[y - 1, x], states[y - 1, x - 1]
                turned = True
                if ahead_left != 0 and (ahead_right != 0 or ahead_left == 1 or beside == 1):
                    d = (d + 1) & 3
                    beside = ahead_left
                elif ahead_left == 0 and ahead_right != 0:
                    beside = ahead_right
                    turned = False
                else:
                    d = (d + 3) & 3
                if y == i and x == j and d == 0:
                    turns[first] = turned
                    break
            loops += 1
            offsets[loops] = count
    return points, right, turns, offsets[: loops + 1].copy()


@njit("Tuple((i4[:,::1], i8[::1]))(u1[:,::1], i4[:,::1], u1[::1], i8[::1])", cache=True, nogil=True)
def assign_walls(
    states: NDArray[np.uint8], points: NDArray[np.int32], right: NDArray[np.uint8], following: NDArray[np.int64]
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Say for each occupied cell which step of the boundary it lies behind: the one that a search meets first.

    ``following`` is the next point of the same loop. The search starts at all steps with an occupied cell on
    the right and spreads through occupied cells, 8-connected. Returns the cells (y, x) that it reaches, and the
    steps; occupied cells that are connected to no free cell are not among them.
    """
    height, width = states.shape
    seen = np.zeros((height, width), np.uint8)
    most = 0
    for i in range(height):
        for j in range(width):
            most += states[i, j] == 1
    cells = np.empty((most, 2), np.int32)
    owners = np.empty(most, np.int64)
    count = 0
    for m in range(len(points)):
        if right[m] != 1:
            continue
        dy = points[following[m], 0] - points[m, 0]
        dx = points[following[m], 1] - points[m, 1]
        # The cell to the right of the step, in rimmed coordinates.
        y = points[m, 0] + 1 - (dx > 0) - (dy < 0)
        x = points[m, 1] + 1 - (dx < 0) - (dy < 0)
        if seen[y, x] == 0:
            seen[y, x] = 1
            cells[count, 0], cells[count, 1] = y - 1, x - 1
            owners[count] = m
            count += 1
    head = 0
    while head < count:
        y, x = cells[head, 0] + 1, cells[head, 1] + 1
        for ny in range(y - 1, y + 2):
            for nx in range(x - 1, x + 2):
                if states[ny, nx] == 1 and seen[ny, nx] == 0:
                    seen[ny, nx] = 1
                    cells[count, 0], cells[count, 1] = ny - 1, nx - 1
                    owners[count] = owners[head]
                    count += 1
        head += 1
    return cells[:count].copy(), owners[:count].copy()
