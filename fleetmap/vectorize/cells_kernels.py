"""Numba kernels that look at cells: their states, the cracks between them, and specks."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

# Literals, since numba compiles globals in: FREE = 0, OCCUPIED = 1, UNKNOWN = 2.


@njit("void(i1[:,::1], u1[:,::1], i8, i8, i8, i8)", cache=True, nogil=True)
def read_states(
    cells: NDArray[np.int8], states: NDArray[np.uint8], low_y: int, low_x: int, free: int, occupied: int
) -> None:
    """Write the states of cells (-1, or 0 to 100 per cent) into ``states``, cell (0, 0) at (low_y, low_x).

    Up to ``free`` per cent a cell is free, from ``occupied`` on it is occupied, else unknown.
    """
    height, width = cells.shape
    least, most = np.int8(free), np.int8(occupied)
    for i in range(height):
        # Slices, and no index with an offset: only so does the compiler see that it may use vector instructions.
        source, target = cells[i], states[low_y + i, low_x : low_x + width]
        for j in range(width):
            cell = source[j]
            known = np.uint8(0) if cell <= least else np.uint8(2)
            known = np.uint8(1) if cell >= most else known
            target[j] = known if cell >= 0 else np.uint8(2)


@njit("void(u1[:,::1], u1[:,::1], i8, i8, i8, i8)", cache=True, nogil=True)
def find_cracks(states: NDArray[np.uint8], cracks: NDArray[np.uint8], y0: int, x0: int, y1: int, x1: int) -> None:
    """Set ``cracks`` for the lattice points y0 <= y < y1, x0 <= x < x1, all at least 1.

    Point (y, x) is the lower left corner of cell (y, x). Bits: a crack, that is cells of different states on both
    its sides, leaves the point to the right (1), up (2), to the left (4), down (8).
    """
    one, two, three = np.uint8(1), np.uint8(2), np.uint8(3)
    for y in range(y0, y1):
        above, above_left = states[y, x0:x1], states[y, x0 - 1 : x1 - 1]
        below, below_left = states[y - 1, x0:x1], states[y - 1, x0 - 1 : x1 - 1]
        out = cracks[y, x0:x1]
        for j in range(x1 - x0):
            here, left, under, corner = above[j], above_left[j], below[j], below_left[j]
            out[j] = (
                np.uint8(here != under)
                | (np.uint8(here != left) << one)
                | (np.uint8(left != corner) << two)
                | (np.uint8(under != corner) << three)
            )


@njit("i8(u8[:,::1], u1[:,::1], i8, i8, i8, i8, i4[:,::1])", cache=True, nogil=True)
def find_corners(
    words: NDArray[np.uint64],
    cracks: NDArray[np.uint8],
    y0: int,
    x0: int,
    y1: int,
    x1: int,
    corners: NDArray[np.int32],
) -> int:
    """List the points (y, x) of a window where cracks meet other than straight on; returns how many.

    ``words`` are the rows of ``cracks``, eight points a number. If ``corners`` is too short, -1 is returned.
    """
    count = 0
    most = len(corners)
    one, two, three = np.uint64(1), np.uint64(2), np.uint64(3)
    lowest, every = np.uint64(0x0101010101010101), np.uint64(0xFFFFFFFFFFFFFFFF)
    first, last = x0 >> 3, (x1 + 7) >> 3
    before, beyond = np.uint64(8 * (x0 & 7)), np.uint64(8 * (8 * last - x1))
    for y in range(y0, y1):
        row = words[y]
        for w in range(first, last):
            word = row[w]
            # Left and right, or up and down, are not alike; or all four are there.
            odd = word ^ (word >> two)
            corner = (odd | (odd >> one) | (word & (word >> one) & (word >> two) & (word >> three))) & lowest
            if corner == 0:
                continue
            corner &= every << before if w == first else every
            corner &= every >> beyond if w == last - 1 else every
            if count + 8 > most:
                return -1
            # All eight are written, and those that are none overwritten: that takes no guess which way a branch goes.
            for k in range(8):
                corners[count, 0], corners[count, 1] = y, 8 * w + k
                count += np.int64(corner & one)
                corner >>= np.uint64(8)
    return count


@njit("i8(u1[:,::1], u1[:,::1], i8, i8, i8, i4[:,::1], i8)", cache=True, nogil=True)
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


@njit("b1(u1[:,::1], i8, i8, i8, i8, i8)", cache=True, nogil=True, inline="always")
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


@njit("b1(i4[:,::1], i8, i8)", cache=True, nogil=True, inline="always")
def starts_with_its_first(queue: NDArray[np.int32], at: int, count: int) -> bool:
    """Whether the component's cell at the front is its lowest, and of those the leftmost."""
    for k in range(at + 1, at + count):
        if queue[k, 0] < queue[at, 0] or (queue[k, 0] == queue[at, 0] and queue[k, 1] < queue[at, 1]):
            return False
    return True


@njit("i8(i8, i8)", cache=True, nogil=True, inline="always")
def priority(y: int, x: int) -> int:
    """A number for a cell of the lattice, different from those of its neighbours, and in no order."""
    return ((np.int64(y) + (1 << 22)) * 40503 + (np.int64(x) + (1 << 22)) * 30011) * 48271 % 2147483647


@njit("b1(u1[:,::1], u1[:,::1], i4[:,::1], i8, i8, i8, i8, i8)", cache=True, nogil=True)
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


@njit("b1(u1[:,::1], u1[:,::1], i4[:,::1], i8, i8, i8, i8, i8, i8)", cache=True, nogil=True)
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

    There is no large free component within ``apart`` rows and columns of its first cell, nor another speck of which
    the same is true and that has a lower number: of a cloud of specks some stay, and which ones depends on the next
    neighbours alone.
    """
    height, width = states.shape
    y0, x0 = queue[at, 0], queue[at, 1]
    first = at + count
    if is_near_large(states, seen, queue, first, y0, x0, most, apart):
        return False
    for y in range(max(y0 - apart, 0), min(y0 + apart + 1, height)):
        for x in range(max(x0 - apart, 0), min(x0 + apart + 1, width)):
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


@njit(
    "Tuple((i8, i8))(u1[:,::1], u1[:,::1], u1[:,::1], i4[:,::1], i8, i8, i8, i8, i8)",
    cache=True,
    nogil=True,
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


@njit("i8(i1[:,::1], i8, i8, u1[:,::1], i8, i8, i8, i8, i8, i8, i8[:,::1])", cache=True, nogil=True)
def read_changes(
    cells: NDArray[np.int8],
    low_y: int,
    low_x: int,
    raw: NDArray[np.uint8],
    y0: int,
    x0: int,
    y1: int,
    x1: int,
    free: int,
    occupied: int,
    spans: NDArray[np.int64],
) -> int:
    """Read the states of a window of cells into ``raw``; returns in how many rows any has changed.

    Parameters
    ----------
    cells : the new grid; its cell (0, 0) is cell (low_y, low_x) of ``raw``; what lies outside of it is unknown
    y0, x0, y1, x1 : cells of ``raw``, half open
    free, occupied : see ``read_states``
    spans : (height, 2) out, for each row of ``raw``: from where to where cells have changed, half open
    """
    height, width = cells.shape
    spans[:, 0] = raw.shape[1]
    spans[:, 1] = 0
    least, most = np.int8(free), np.int8(occupied)
    gx0, gx1 = max(x0, low_x), min(x1, low_x + width)
    new = np.empty(x1 - x0, np.uint8)
    total = 0
    for y in range(y0, y1):
        new[:] = 2
        if low_y <= y < low_y + height and gx0 < gx1:
            source, target = cells[y - low_y, gx0 - low_x : gx1 - low_x], new[gx0 - x0 : gx1 - x0]
            for j in range(len(source)):
                cell = source[j]
                known = np.uint8(0) if cell <= least else np.uint8(2)
                known = np.uint8(1) if cell >= most else known
                target[j] = known if cell >= 0 else np.uint8(2)
        old = raw[y, x0:x1]
        differ = np.uint8(0)
        for j in range(len(new)):
            differ = np.uint8(differ | (new[j] ^ old[j]))
        if differ == 0:
            continue
        total += 1
        first, last = 0, len(new)
        while new[first] == old[first]:
            first += 1
        while new[last - 1] == old[last - 1]:
            last -= 1
        spans[y, 0], spans[y, 1] = x0 + first, x0 + last
        old[:] = new
    return total


@njit("Tuple((i8, i8))(i8[:,::1], i8, i8, i8[:,::1])", cache=True, nogil=True)
def widen_spans(spans: NDArray[np.int64], margin: int, width: int, wide: NDArray[np.int64]) -> tuple[int, int]:
    """Fill ``wide`` with the spans of all rows within ``margin``, ``margin`` wider, but for the array's own rim.

    Returns between which rows, half open, there are any; others are not filled.
    """
    height = len(spans)
    first, last = height, 0
    for y in range(height):
        if spans[y, 0] < spans[y, 1]:
            first, last = min(first, y), y + 1
    if first >= last:
        return 0, 0
    first, last = max(first - margin, 1), min(last + margin, height - 1)
    # The rows within 1, 3, 7... are those within half of it, of the rows in the middle of its two halves.
    low, high = spans[first:last, 0].copy(), spans[first:last, 1].copy()
    reached = 0
    while reached < margin:
        step = min(reached + 1, margin - reached)
        lower, higher = low.copy(), high.copy()
        for y in range(len(low)):
            if y >= step:
                lower[y], higher[y] = min(lower[y], low[y - step]), max(higher[y], high[y - step])
            if y + step < len(low):
                lower[y], higher[y] = min(lower[y], low[y + step]), max(higher[y], high[y + step])
        low, high = lower, higher
        reached += step
    for y in range(first, last):
        wide[y, 0], wide[y, 1] = max(low[y - first] - margin, 1), min(high[y - first] + margin, width - 1)
    return first, last


@njit("i8(u1[:,::1], u1[:,::1], i8[:,::1], i8, i8, i8, i8, i8, i8[::1])", cache=True, nogil=True)
def refresh(
    raw: NDArray[np.uint8],
    states: NDArray[np.uint8],
    spans: NDArray[np.int64],
    most: int,
    apart: int,
    margin: int,
    oy: int,
    ox: int,
    dirty: NDArray[np.int64],
) -> int:
    """Bring ``states``, which have their specks filled, up to date with ``raw``; returns in how many rows any changed.

    Parameters
    ----------
    spans : (height, 2) for each row from where to where cells of ``raw`` have changed
    most, apart : see ``fill_specks``
    margin : so far away a change may have to do with whether a speck is filled
    oy, ox : lattice place of cell (0, 0)
    dirty : out: (y0, x0, y1, x1) the changed states, half open; how many specks were filled there, and their cells
    """
    height, width = states.shape
    # What may change, and what that depends on.
    wide = np.empty((height, 2), np.int64)
    wy0, wy1 = widen_spans(spans, margin, width, wide)
    dirty[0], dirty[1], dirty[2], dirty[3], dirty[4], dirty[5] = height, width, -1, -1, 0, 0
    if wy0 >= wy1:
        return 0
    # Specks that reach into that begin at most so many cells outside.
    wider = np.empty((height, 2), np.int64)
    cy0, cy1 = widen_spans(spans, margin + most, width, wider)
    ry0, rx0, ry1, rx1 = cy0, width, cy1, np.int64(0)
    for y in range(cy0, cy1):
        rx0, rx1 = min(rx0, wider[y, 0]), max(rx1, wider[y, 1])
    ry0, rx0 = max(ry0 - margin, 0), max(rx0 - margin, 0)
    ry1, rx1 = min(ry1 + margin, height), min(rx1 + margin, width)
    rows, columns = ry1 - ry0, min((rx1 - rx0 + 7) // 8 * 8, width)
    rx0 = min(rx0, width - columns)
    filled = raw[ry0:ry1, rx0 : rx0 + columns].copy()
    if most > 0:
        cracks = np.empty((rows, columns), np.uint8)
        cracks[0, :] = 0
        cracks[:, 0] = 0
        find_cracks(filled, cracks, 1, 1, rows, columns)
        corners = np.empty((2048, 2), np.int32)
        words = cracks.view(np.uint64)
        count = 0
        for y in range(max(cy0 - ry0, 1), cy1 - ry0):
            low, high = max(wider[y + ry0, 0] - rx0, 1), min(wider[y + ry0, 1] - rx0, columns)
            line, eight = cracks[y], words[y]
            for w in range(low >> 3, (high + 7) >> 3):
                # Only the first cells of components are of interest: cracks to the right and up. Eight at a time.
                if eight[w] & (eight[w] >> np.uint64(1)) & np.uint64(0x0101010101010101) == 0:
                    continue
                for x in range(max(8 * w, low), min(8 * w + 8, high)):
                    if line[x] & 3 != 3 or filled[y, x] == 1:
                        continue
                    if count == len(corners):
                        longer = np.empty((2 * count, 2), np.int32)
                        longer[:count] = corners
                        corners = longer
                    corners[count, 0], corners[count, 1] = y, x
                    count += 1
        seen = np.zeros((rows, columns), np.uint8)
        dirty[4], dirty[5] = fill_specks(filled, cracks, seen, corners, count, most, apart, ry0 + oy, rx0 + ox)
    changed = 0
    for y in range(wy0, wy1):
        low, high = wide[y, 0], wide[y, 1]
        new, old = filled[y - ry0, low - rx0 : high - rx0], states[y, low:high]
        differ = np.uint8(0)
        for j in range(len(new)):
            differ = np.uint8(differ | (new[j] ^ old[j]))
        if differ == 0:
            continue
        changed += 1
        first, last = 0, len(new)
        while new[first] == old[first]:
            first += 1
        while new[last - 1] == old[last - 1]:
            last -= 1
        dirty[0], dirty[2] = min(dirty[0], y), max(dirty[2], y + 1)
        dirty[1], dirty[3] = min(dirty[1], low + first), max(dirty[3], low + last)
        old[:] = new
    return changed
