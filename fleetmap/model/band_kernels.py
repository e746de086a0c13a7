"""Numba kernels of ``model.bands``: sort rows (y0, x0, y1, x1, label, thickness), find them, apply a delta, make one.

Whatever order a caller's rows come in, no index leaves an array: rows out of order are reported, never trusted.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.kernel import kernel
from fleetmap.model.row_kernels import (
    GOOD,
    KEY_BITS,
    LIMIT,
    MISSING,
    THERE,
    THICK,
    TURNED,
    bound,
    check_edge,
    compare,
    modular,
    row_hash,
)
from fleetmap.model.sort_kernels import lower_bound, order_of


@kernel("Tuple((i8, i4[:,::1]))(i8[:,::1], i8[::1])")
def canonical_rows(edges: NDArray[np.int64], thickness: NDArray[np.int64]) -> tuple[int, NDArray[np.int32]]:
    """Check edges, (n, 5), turn each with its lower end first, sort them, drop repeated ones: (GOOD, (m, 6) rows)."""
    n = len(edges)
    rows = np.empty((n, 6), np.int32)
    keys = np.empty(n, np.int64)
    ascending = True
    for i in range(n):
        y0, x0, y1, x1, label = edges[i, 0], edges[i, 1], edges[i, 2], edges[i, 3], edges[i, 4]
        found = check_edge(y0, x0, y1, x1, label)
        if found != GOOD:
            return found, rows[:0]
        if thickness[i] < 0 or thickness[i] > 255:
            return THICK, rows[:0]
        if y0 > y1 or (y0 == y1 and x0 > x1):
            y0, x0, y1, x1, label = y1, x1, y0, x0, 3 * (label % 3) + label // 3
        rows[i, 0], rows[i, 1], rows[i, 2], rows[i, 3], rows[i, 4], rows[i, 5] = y0, x0, y1, x1, label, thickness[i]
        keys[i] = (y0 + LIMIT) << KEY_BITS | (x0 + LIMIT)
        if ascending and i > 0 and compare(rows, i - 1, rows, i) >= 0:
            ascending = False
    if ascending:
        return GOOD, rows
    order = order_of(keys)
    # Few edges share their lower end; among those the sort is by insertion, and keeps the order of equal ones.
    for i in range(1, n):
        j, moved = i, order[i]
        while j > 0 and keys[order[j - 1]] == keys[moved] and compare(rows, order[j - 1], rows, moved) > 0:
            order[j] = order[j - 1]
            j -= 1
        order[j] = moved
    result = np.empty((n, 6), np.int32)
    count = 0
    for i in range(n):
        if i == 0 or compare(rows, order[i - 1], rows, order[i]) != 0:
            for k in range(6):
                result[count, k] = rows[order[i], k]
            count += 1
    return GOOD, result[:count]


@kernel("i8[::1](i4[:,::1], i8[:,::1], i4[:,::1])")
def find_places(block: NDArray[np.int32], bands: NDArray[np.int64], needles: NDArray[np.int32]) -> NDArray[np.int64]:
    """(k,) place of each needle in the map, -1 where it is missing.

    ``bands``, (b, 4): number of the band, ascending; where its rows start and end in ``block``; its first row's
    place in the map.
    """
    places = np.empty(len(needles), np.int64)
    numbers = bands[:, 0].copy()
    for i in range(len(needles)):
        band = lower_bound(numbers, 0, len(numbers), int(needles[i, 0]) >> 6)
        places[i] = -1
        if band < len(numbers) and numbers[band] == int(needles[i, 0]) >> 6:
            start, end = bands[band, 1], bands[band, 2]
            at = bound(block, start, end, needles, i)
            if at < end and compare(block, at, needles, i) == 0:
                places[i] = bands[band, 3] + at - start
    return places


@kernel("i8[::1](i4[:,::1], i4[:,::1], i4[:,::1])")
def numbers_of_bands(a: NDArray[np.int32], b: NDArray[np.int32], c: NDArray[np.int32]) -> NDArray[np.int64]:
    """The numbers of the bands of three lists of edges, ascending, each once."""
    keys = np.empty(len(a) + len(b) + len(c), np.int64)
    for i in range(len(a)):
        keys[i] = int(a[i, 0]) >> 6
    for i in range(len(b)):
        keys[len(a) + i] = int(b[i, 0]) >> 6
    for i in range(len(c)):
        keys[len(a) + len(b) + i] = int(c[i, 0]) >> 6
    order = order_of(keys)
    numbers = np.empty(len(keys), np.int64)
    count = 0
    for at in order:
        if count == 0 or keys[at] != numbers[count - 1]:
            numbers[count] = keys[at]
            count += 1
    return numbers[:count]


@kernel("void(i4[::1], i8, i4[::1], i8, i8)")
def _copy(target: NDArray[np.int32], at: int, source: NDArray[np.int32], start: int, end: int) -> None:
    """Rows [start, end) of six numbers to row ``at``."""
    target[6 * at : 6 * (at + end - start)] = source[6 * start : 6 * end]


@modular
@kernel(
    "Tuple((i8, i4[:,::1], i8[::1], u8))(i4[:,::1], i4[:,::1], i4[:,::1], u1[::1], i4[:,::1], u1[::1], i8[::1])",
)
def apply_rows(
    block: NDArray[np.int32],
    removed: NDArray[np.int32],
    added: NDArray[np.int32],
    added_thickness: NDArray[np.uint8],
    rethickened: NDArray[np.int32],
    rethickened_to: NDArray[np.uint8],
    numbers: NDArray[np.int64],
) -> tuple[int, NDArray[np.int32], NDArray[np.int64], np.uint64]:
    """``block``, (n, 6), with a delta applied: what was found, the rows, where each band ends, what the digest gains.

    The three lists ascend, or an edge of theirs counts as missing or as there already. ``numbers``, (b,): the bands.
    """
    result = np.empty((len(block) + len(added), 6), np.int32)
    ends = np.zeros(len(numbers), np.int64)
    flat, source = result.reshape(-1), block.reshape(-1)
    change = np.uint64(0)
    at = count = r = a = h = 0
    while r < len(removed) or a < len(added) or h < len(rethickened):
        # The least of the three next edges; one that goes and comes back goes first.
        which = 0 if r < len(removed) else -1
        if h < len(rethickened) and (which < 0 or compare(rethickened, h, removed, r) < 0):
            which = 1
        if a < len(added):
            if which < 0 or (which == 0 and compare(added, a, removed, r) < 0):
                which = 2
            elif which == 1 and compare(added, a, rethickened, h) < 0:
                which = 2
        edges = removed if which == 0 else rethickened if which == 1 else added
        i = r if which == 0 else h if which == 1 else a
        place = bound(block, at, len(block), edges, i)
        there = place < len(block) and compare(block, place, edges, i) == 0
        if there == (which == 2):
            return (THERE if there else MISSING), result[:0], ends, change
        _copy(flat, count, source, at, place)
        count += place - at
        at = place
        if which == 0:
            change -= row_hash(block, place, int(block[place, 5]))
            at += 1
            r += 1
        elif which == 1:
            change -= row_hash(block, place, int(block[place, 5]))
            change += row_hash(block, place, int(rethickened_to[h]))
            _copy(flat, count, source, place, place + 1)
            result[count, 5] = rethickened_to[h]
            count += 1
            at += 1
            h += 1
        else:
            y0, x0, y1, x1 = added[a, 0], added[a, 1], added[a, 2], added[a, 3]
            found = check_edge(y0, x0, y1, x1, added[a, 4])
            if found == GOOD and (y0 > y1 or (y0 == y1 and x0 > x1)):
                found = TURNED
            if found == GOOD and count > 0 and compare(result, count - 1, added, a) >= 0:
                found = THERE
            if found != GOOD:
                return found, result[:0], ends, change
            change += row_hash(added, a, int(added_thickness[a]))
            for k in range(5):
                result[count, k] = added[a, k]
            result[count, 5] = added_thickness[a]
            count += 1
            a += 1
    _copy(flat, count, source, at, len(block))
    count += len(block) - at
    low = 0
    for i in range(len(numbers)):
        high = count
        while low < high:
            middle = (low + high) // 2
            if int(result[middle, 0]) >> 6 <= numbers[i]:
                low = middle + 1
            else:
                high = middle
        ends[i] = low
    return GOOD, result[:count], ends, change


@kernel(
    "Tuple((i4[:,::1], i4[:,::1], u1[::1], i4[:,::1], u1[::1]))(i4[:,::1], i4[:,::1])",
)
def diff_rows(
    old: NDArray[np.int32], new: NDArray[np.int32]
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.uint8], NDArray[np.int32], NDArray[np.uint8]]:
    """The fields of the ``MapDelta`` between two lists of rows, (n, 6) and (m, 6), both in canonical order."""
    gone, come = np.empty(len(old), np.int64), np.empty(len(new), np.int64)
    thick = np.empty(min(len(old), len(new)), np.int64)
    r = a = h = i = j = 0
    # Rows of six 32-bit numbers are compared as three 64-bit ones: most are equal.
    old_words, new_words = old.view(np.int64), new.view(np.int64)
    while i < len(old) and j < len(new):
        if (
            old_words[i, 0] == new_words[j, 0]
            and old_words[i, 1] == new_words[j, 1]
            and old_words[i, 2] == new_words[j, 2]
        ):
            i += 1
            j += 1
            continue
        order = compare(old, i, new, j)
        if order < 0:
            gone[r] = i
            r += 1
            i += 1
        elif order > 0:
            come[a] = j
            a += 1
            j += 1
        else:
            thick[h] = j
            h += 1
            i += 1
            j += 1
    while i < len(old):
        gone[r] = i
        r += 1
        i += 1
    while j < len(new):
        come[a] = j
        a += 1
        j += 1
    removed, added, rethickened = np.empty((r, 5), np.int32), np.empty((a, 5), np.int32), np.empty((h, 5), np.int32)
    added_thickness, rethickened_to = np.empty(a, np.uint8), np.empty(h, np.uint8)
    for k in range(r):
        for c in range(5):
            removed[k, c] = old[gone[k], c]
    for k in range(a):
        for c in range(5):
            added[k, c] = new[come[k], c]
        added_thickness[k] = new[come[k], 5]
    for k in range(h):
        for c in range(5):
            rethickened[k, c] = new[thick[k], c]
        rethickened_to[k] = new[thick[k], 5]
    return removed, added, added_thickness, rethickened, rethickened_to
