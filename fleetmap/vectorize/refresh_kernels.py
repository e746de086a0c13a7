"""Numba kernels that bring the states of cells up to date where a grid has changed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.kernel import kernel
from fleetmap.vectorize.cells_kernels import find_cracks
from fleetmap.vectorize.speck_kernels import fill_specks


# The cells of a grid are read-only, which numba has no short notation for.
@kernel(
    "i8(Array(i1, 2, 'C', readonly=True), i8, i8, u1[:,::1], i8, i8, i8, i8, i8, i8, i8[:,::1])",
)
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


@kernel("Tuple((i8, i8))(i8[:,::1], i8, i8, i8[:,::1])")
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


@kernel("i8(u1[:,::1], u1[:,::1], i8[:,::1], i8, i8, i8, i8, i8, i8[::1])")
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
