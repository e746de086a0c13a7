"""Numba kernels that fill specks: small components of free and unknown cells."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.kernel import kernel
from fleetmap.vectorize.cells_kernels import find_cracks

# Literals, since numba compiles globals in: FREE = 0, OCCUPIED = 1, UNKNOWN = 2.


@kernel("i8(u1[:,::1], u1[:,::1], i8, i8, i8, i4[:,::1], i8)")
def gather(
    states: NDArray[np.uint8],
    seen: NDArray[np.uint8],
    y: int,
    x: int,
    most: int,
    queue: NDArray[np.int32],
    at: int,
) -> int:
    """Collect the component of cell (y, x) in ``queue`` from ``at`` on; returns its size, or -1 if above ``most``.

    Components are 4-connected; free cells also meet at a corner if the two other cells there are unknown, as a
    beam leaves them. What touches the rim of the array counts as large. ``seen`` is zero before and after.
    """
    height, width = states.shape
    state = states[y, x]
    queue[at, 0], queue[at, 1] = y, x
    seen[y, x] = 1
    count = 1
    head = 0
    large = False
    while head < count and not large:
        y, x = queue[at + head, 0], queue[at + head, 1]
        head += 1
        if y <= 0 or x <= 0 or y >= height - 1 or x >= width - 1:
            large = True
            break
        for d in range(8 if state == 0 else 4):
            if d < 4:
                ny, nx = y + (d == 1) - (d == 3), x + (d == 0) - (d == 2)
                if states[ny, nx] != state or seen[ny, nx]:
                    continue
            else:
                ny, nx = y + 2 * (d & 1) - 1, x + (d & 2) - 1
                if states[ny, nx] != state or seen[ny, nx] or states[ny, x] != 2 or states[y, nx] != 2:
                    continue
            if count == most:
                large = True
                break
            seen[ny, nx] = 1
            queue[at + count, 0], queue[at + count, 1] = ny, nx
            count += 1
    for k in range(at, at + count):
        seen[queue[k, 0], queue[k, 1]] = 0
    return -1 if large else count


FILLED = 16
"""Added, in the array of visited cells, to the state that a cell is about to be given."""


@kernel("b1(u1[:,::1], i8, i8, i8, i8, i8)", inline="always")
def is_long(states: NDArray[np.uint8], y: int, x: int, most: int, dy: int, dx: int) -> bool:
    """Whether more than ``most`` cells of one state lie in a line from cell (y, x) on, or it meets the rim."""
    state = states[y, x]
    for _ in range(most):
        y += dy
        x += dx
        if states[y, x] != state:
            return False
        if y >= len(states) - 1 or x >= states.shape[1] - 1:
            return True
    return True


@kernel("b1(i4[:,::1], i8, i8)", inline="always")
def starts_with_its_first(queue: NDArray[np.int32], at: int, count: int) -> bool:
    """Whether the component's cell at the front is its lowest, and of those the leftmost."""
    for k in range(at + 1, at + count):
        if queue[k, 0] < queue[at, 0] or (queue[k, 0] == queue[at, 0] and queue[k, 1] < queue[at, 1]):
            return False
    return True


@kernel("i8(i8, i8)", inline="always")
def priority(y: int, x: int) -> int:
    """A number for a cell of the lattice, different from those of its neighbours, and in no order."""
    return ((np.int64(y) + (1 << 22)) * 40503 + (np.int64(x) + (1 << 22)) * 30011) * 48271 % 2147483647


@kernel("b1(u1[:,::1], u1[:,::1], i4[:,::1], i8, i8, i8, i8, i8)")
def is_near_large(
    states: NDArray[np.uint8],
    seen: NDArray[np.uint8],
    queue: NDArray[np.int32],
    at: int,
    y0: int,
    x0: int,
    most: int,
    apart: int,
) -> bool:
    """Whether a free cell within ``apart`` rows and columns of (y0, x0) belongs to a component above ``most``."""
    height, width = states.shape
    for y in range(max(y0 - apart, 0), min(y0 + apart + 1, height)):
        for x in range(max(x0 - apart, 0), min(x0 + apart + 1, width)):
            if states[y, x] == 0 and gather(states, seen, y, x, most, queue, at) < 0:
                return True
    return False


@kernel("b1(u1[:,::1], u1[:,::1], i4[:,::1], i8, i8, i8, i8, i8, i8)")
def is_alone(
    states: NDArray[np.uint8],
    seen: NDArray[np.uint8],
    queue: NDArray[np.int32],
    at: int,
    count: int,
    most: int,
    apart: int,
    oy: int,
    ox: int,
) -> bool:
    """Whether a free speck is the only trace of the space it lies in, and must stay.

    There is no large free component within ``apart`` rows and columns of its first cell, nor, within half of that,
    another speck of which the same is true and that has a lower number: of a cloud of specks some stay, and which
    ones depends on the next neighbours alone.
    """
    height, width = states.shape
    y0, x0 = queue[at, 0], queue[at, 1]
    first = at + count
    if is_near_large(states, seen, queue, first, y0, x0, most, apart):
        return False
    beside = apart // 2
    for y in range(max(y0 - beside, 0), min(y0 + beside + 1, height)):
        for x in range(max(x0 - beside, 0), min(x0 + beside + 1, width)):
            if states[y, x] != 0:
                continue
            size = gather(states, seen, y, x, most, queue, first)
            lowest = first
            for k in range(first + 1, first + size):
                if queue[k, 0] < queue[lowest, 0] or (
                    queue[k, 0] == queue[lowest, 0] and queue[k, 1] < queue[lowest, 1]
                ):
                    lowest = k
            y1, x1 = queue[lowest, 0], queue[lowest, 1]
            if priority(y1 + oy, x1 + ox) < priority(y0 + oy, x0 + ox) and not is_near_large(
                states, seen, queue, first, y1, x1, most, apart
            ):
                return False
    return True


@kernel(
    "Tuple((i8, i8))(u1[:,::1], u1[:,::1], u1[:,::1], i4[:,::1], i8, i8, i8, i8, i8)",
)
def fill_specks(
    states: NDArray[np.uint8],
    cracks: NDArray[np.uint8],
    seen: NDArray[np.uint8],
    corners: NDArray[np.int32],
    count: int,
    most: int,
    apart: int,
    oy: int,
    ox: int,
) -> tuple[int, int]:
    """Give free and unknown components of at most ``most`` cells the state that prevails around them.

    (oy, ox) is the lattice place of cell (0, 0). Returns the number of specks that were filled, and of their cells.
    Free ones come first, unknown ones become free only beside free cells that stay. A free one that lies apart stays
    (see ``is_alone``). Occupied cells are never touched. Whether a component is filled depends on cells within
    4 ``most`` + 2 ``apart`` of it alone.
    """
    queue = np.empty((max(1024, 8 * most), 2), np.int32)
    around = np.zeros(3, np.int64)
    specks = 0
    cells = 0
    if most < 1:
        return specks, cells
    size = 0  # rows in the queue: for each component its new state and size, then its cells
    for state in (0, 2):
        for c in range(count):
            y, x = corners[c, 0], corners[c, 1]
            # The first cell of a component differs from the cells below and to the left.
            if states[y, x] != state or cracks[y, x] & 3 != 3:
                continue
            if size + 4 * most + 4 > len(queue):
                longer = np.empty((2 * len(queue) + 4 * most, 2), np.int32)
                longer[:size] = queue[:size]
                queue = longer
            # Most are large, and a straight line shows it.
            if is_long(states, y, x, most, 1, 0) or is_long(states, y, x, most, 0, 1):
                continue
            found = gather(states, seen, y, x, most, queue, size + 1)
            if found < 0 or not starts_with_its_first(queue, size + 1, found):
                continue
            around[:] = 0
            for k in range(size + 1, size + 1 + found):
                for d in range(4):
                    ny, nx = queue[k, 0] + (d == 1) - (d == 3), queue[k, 1] + (d == 0) - (d == 2)
                    if states[ny, nx] == state:
                        continue
                    # A free cell that is to be filled counts as what it becomes.
                    mark = seen[ny, nx]
                    around[mark - FILLED if mark >= FILLED else states[ny, nx]] += 1
            if state == 0:
                # Not in case of a draw: it could join an obstacle to another one, and hide it.
                prevailing = 1 if around[1] > around[2] else 2
                if is_alone(states, seen, queue, size + 1, found, most, apart, oy, ox):
                    continue
            elif around[1] >= around[0] + around[2]:
                prevailing = 1
            elif around[0] >= around[2]:
                prevailing = 0
            else:
                continue
            queue[size, 0], queue[size, 1] = prevailing, found
            size += 1 + found
            specks += 1
            cells += found
        if state == 0:
            at = 0
            while at < size:
                for k in range(at + 1, at + 1 + queue[at, 1]):
                    seen[queue[k, 0], queue[k, 1]] = FILLED + queue[at, 0]
                at += 1 + queue[at, 1]
    at = 0
    while at < size:
        prevailing, found = queue[at, 0], queue[at, 1]
        for k in range(at + 1, at + 1 + found):
            states[queue[k, 0], queue[k, 1]] = prevailing
            seen[queue[k, 0], queue[k, 1]] = 0
        at += 1 + found
    at = 0
    while at < size:
        for k in range(at + 1, at + 1 + queue[at, 1]):
            y, x = queue[k, 0], queue[k, 1]
            find_cracks(states, cracks, y, x, y + 2, x + 2)
        at += 1 + queue[at, 1]
    return specks, cells
