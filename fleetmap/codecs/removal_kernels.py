"""Numba kernels of payload mode 1: which edges of the base are removed.

They lie in a few windows, bands of the base by columns of 64 cells; for each edge in a window there is a decision. So
both bytes and time depend on what lies around the change, and not on how large the map is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.codecs import mode1_layout as at
from fleetmap.codecs.chain_kernels import class_of, vertex_key
from fleetmap.codecs.range_kernels import (
    GOOD,
    MODE,
    NOT_THERE,
    READ,
    STATUS,
    TOO_MANY,
    TWICE,
    amount,
    signed,
    spend,
    told,
)
from fleetmap.model.kernel import kernel
from fleetmap.model.row_kernels import KEY_BITS
from fleetmap.model.sort_kernels import lower_bound, order_of

FIRST_BAND, BANDS, FIRST_COLUMN, COLUMNS, REMOVED = range(5)
"""Columns of a window: places of bands among the base's, columns of 64 cells, edges removed in it."""

START, END, PLACE = range(3)
"""Columns of a window's span: its bands' rows in the block, and the first one's place in the base."""

MAX_WINDOWS = 16

MOST_TILES = 64
"""Squares of 64 cells with removed edges, before they are taken together: merging them takes their square in time."""

REACH = 2
"""Removed edges go into one window if there is at most one square between them: a window takes about two bytes."""


@kernel("i8(i8[::1], i8[::1], u1[::1], i8[:,::1], i8, i8)")
def code_windows(
    coder: NDArray[np.int64],
    memory: NDArray[np.int64],
    data: NDArray[np.uint8],
    windows: NDArray[np.int64],
    count: int,
    bands: int,
) -> int:
    """The windows, (MAX_WINDOWS, 5), in which edges are removed from a base of so many bands; returns their count."""
    count = amount(coder, memory, data, at.WINDOWS, at.LOWER, -1, count)
    if count > MAX_WINDOWS:
        coder[STATUS] = TOO_MANY
        return 0
    band = column = removed = 0
    for i in range(count):
        window = windows[i]
        band += amount(coder, memory, data, at.FIRST_BAND, at.LOWER, -1, window[FIRST_BAND] - band)
        window[FIRST_BAND] = band
        window[BANDS] = 1 + amount(coder, memory, data, at.BANDS, at.LOWER, -1, window[BANDS] - 1)
        column += signed(coder, memory, data, at.FIRST_COLUMN, at.LOWER, window[FIRST_COLUMN] - column)
        window[FIRST_COLUMN] = column
        window[COLUMNS] = 1 + amount(coder, memory, data, at.COLUMNS, at.LOWER, -1, window[COLUMNS] - 1)
        window[REMOVED] = 1 + amount(coder, memory, data, at.REMOVED, at.LOWER, -1, window[REMOVED] - 1)
        removed += window[REMOVED]
        spend(coder, 1 + window[REMOVED], removed)
        if band + window[BANDS] > bands and coder[STATUS] == GOOD:
            coder[STATUS] = NOT_THERE
        if coder[STATUS] != GOOD:
            return 0
    return count


@kernel("i8(i8[::1], i4[:,::1], i8[::1], i8, i8)")
def _count_in(
    coder: NDArray[np.int64], block: NDArray[np.int32], window: NDArray[np.int64], start: int, end: int
) -> int:
    """How many rows [start, end) lie in a window's columns."""
    count = 0
    for i in range(start, end):
        column = (int(block[i, 1]) >> 6) - window[FIRST_COLUMN]
        if 0 <= column < window[COLUMNS]:
            count += 1
    return count


@kernel("i8(i8[::1], i8)")
def _slot(table: NDArray[np.int64], key: int) -> int:
    """Where a key stands in a hash table of 2^n slots, or where it will."""
    mask = len(table) - 1
    slot = ((key >> KEY_BITS) * 1021 + (key & ((1 << KEY_BITS) - 1))) & mask
    while table[slot] >= 0 and table[slot] != key:
        slot = (slot + 1) & mask
    return slot


@kernel(
    "void(i8[::1], i8[::1], u1[::1], i4[:,::1], i8[:,::1], i8[:,::1], i8[::1], i4[:,::1], i8[::1])",
)
def code_removed(
    coder: NDArray[np.int64],
    memory: NDArray[np.int64],
    data: NDArray[np.uint8],
    block: NDArray[np.int32],
    windows: NDArray[np.int64],
    spans: NDArray[np.int64],
    places: NDArray[np.int64],
    removed: NDArray[np.int32],
    thickness: NDArray[np.int64],
) -> None:
    """A decision for each edge in a window until all of it are found: edges go with those that they touch.

    ``places``, (R,), and ``removed``, (R, 5), are written or read; R is what the windows say in all. ``thickness``,
    (R,), becomes that of the removed edges.
    """
    seen = 0
    for w in range(len(windows)):
        seen += _count_in(coder, block, windows[w], spans[w, START], spans[w, END])
    spend(coder, seen, 0)
    if coder[STATUS] != GOOD:
        return
    slots = 64
    while slots < 4 * seen:
        slots *= 2
    table, touch = np.full(slots, -1), np.zeros(slots, np.int64)  # 1: an edge here stays, 2: one goes, 3: both
    found_places = np.empty(len(places), np.int64)
    found_rows = np.empty(len(places), np.int64)
    found = 0
    for w in range(len(windows)):
        window, last, until = windows[w], 0, found + windows[w, REMOVED]
        next_gone = lower_bound(places, 0, len(places), spans[w, PLACE]) if coder[MODE] != READ else 0
        for i in range(spans[w, START], spans[w, END]):
            if found == until:
                break
            column = (int(block[i, 1]) >> 6) - window[FIRST_COLUMN]
            if column < 0 or column >= window[COLUMNS]:
                continue
            a = _slot(table, vertex_key(int(block[i, 0]), int(block[i, 1])))
            table[a] = vertex_key(int(block[i, 0]), int(block[i, 1]))
            b = _slot(table, vertex_key(int(block[i, 2]), int(block[i, 3])))
            table[b] = vertex_key(int(block[i, 2]), int(block[i, 3]))
            place, goes = spans[w, PLACE] + i - spans[w, START], 0
            if coder[MODE] != READ:
                while next_gone < len(places) and places[next_gone] < place:
                    next_gone += 1
                goes = 1 if next_gone < len(places) and places[next_gone] == place else 0
            context = 2 * (16 * class_of(int(block[i, 4])) + 4 * touch[a] + touch[b]) + last
            last = told(coder, memory, data, at.GOES + context, goes)
            touch[a] |= 1 + last
            touch[b] |= 1 + last
            if last:
                found_places[found] = place
                found_rows[found] = i
                found += 1
        if found < until:
            coder[STATUS] = NOT_THERE
            return
    for nth, k in enumerate(order_of(found_places)):
        places[nth] = found_places[k]
        for c in range(5):
            removed[nth, c] = block[found_rows[k], c]
        thickness[nth] = block[found_rows[k], 5]
        if nth > 0 and places[nth] == places[nth - 1]:
            coder[STATUS] = TWICE
            return


@kernel("i8(i8[:,::1], i8, i8)")
def _merge_near(boxes: NDArray[np.int64], count: int, reach: int) -> int:
    """Merge boxes (low band, high band, low column, high column) that are near each other; how many are left."""
    i = 1
    while i < count:
        merged = False
        for j in range(i):
            if (
                boxes[i, 0] - boxes[j, 1] <= reach
                and boxes[j, 0] - boxes[i, 1] <= reach
                and boxes[i, 2] - boxes[j, 3] <= reach
                and boxes[j, 2] - boxes[i, 3] <= reach
            ):
                boxes[j, 0], boxes[j, 1] = min(boxes[i, 0], boxes[j, 0]), max(boxes[i, 1], boxes[j, 1])
                boxes[j, 2], boxes[j, 3] = min(boxes[i, 2], boxes[j, 2]), max(boxes[i, 3], boxes[j, 3])
                count -= 1
                boxes[i] = boxes[count]
                merged = True
                break
        # A box that grew may have come near any other.
        i = 1 if merged else i + 1
    return count


@kernel("i8(i4[:,::1], i8[::1], i8[::1], i8[:,::1])")
def choose_windows(
    removed: NDArray[np.int32], numbers: NDArray[np.int64], places: NDArray[np.int64], windows: NDArray[np.int64]
) -> int:
    """Windows that hold the removed edges, (R, 5), one around each group of them; returns their count.

    ``numbers``, ascending, are those of the bands in which the edges lie, ``places`` these bands' places in the base.
    """
    tiles = np.empty(len(removed), np.int64)
    for i in range(len(removed)):
        tiles[i] = (int(removed[i, 0]) >> 6) << 20 | ((int(removed[i, 1]) >> 6) + (1 << 19))
    boxes = np.empty((MOST_TILES, 4), np.int64)
    count, before = 0, 0
    order = order_of(tiles)
    for nth in range(len(order)):
        tile = tiles[order[nth]]
        if nth > 0 and tile == before:
            continue
        if count == MOST_TILES:
            # Scattered all over: one window around everything.
            count = _merge_near(boxes, count, 1 << 30)
        band, column = tile >> 20, (tile & ((1 << 20) - 1)) - (1 << 19)
        boxes[count, 0], boxes[count, 1], boxes[count, 2], boxes[count, 3] = band, band, column, column
        before = tile
        count += 1
    reach = REACH
    count = _merge_near(boxes, count, reach)
    while count > MAX_WINDOWS:
        reach *= 2
        count = _merge_near(boxes, count, reach)
    for i in range(count):
        low = places[lower_bound(numbers, 0, len(numbers), boxes[i, 0])]
        high = places[lower_bound(numbers, 0, len(numbers), boxes[i, 1])]
        window = np.array([low, high - low + 1, boxes[i, 2], boxes[i, 3] - boxes[i, 2] + 1, 0])
        for k in range(len(removed)):
            band, column = int(removed[k, 0]) >> 6, int(removed[k, 1]) >> 6
            if boxes[i, 0] <= band <= boxes[i, 1] and boxes[i, 2] <= column <= boxes[i, 3]:
                window[REMOVED] += 1
        j = i
        while j > 0 and windows[j - 1, FIRST_BAND] > low:
            windows[j] = windows[j - 1]
            j -= 1
        windows[j] = window
    return count
