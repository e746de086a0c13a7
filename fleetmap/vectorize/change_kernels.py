"""Numba kernels that tell which edges an update took away and added."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.kernel import kernel
from fleetmap.vectorize.index_kernels import AT_X, AT_Y, LABEL, NEXT, THICK, find_record, insert_record


@kernel("i8(i8, i8, i8, i8, i8)", inline="always")
def row_hash(y0: int, x0: int, y1: int, x1: int, label: int) -> int:
    """A number above 0 for an edge; two edges hardly ever have the same."""
    one, two = np.int64(label + 1), np.int64(label + 17)
    for value in (y0, x0, y1, x1):
        one = (one * 48271 + value + (1 << 22)) % 2147483647
        two = (two * 69621 + value + (1 << 22)) % 2147483629
    return (one << 31) + two + 1


@kernel("void(i8[:,::1], i8, i8, i8, i8, i8, i8, i8)", inline="always")
def write_row(rows: NDArray[np.int64], k: int, y0: int, x0: int, y1: int, x1: int, label: int, thickness: int) -> None:
    """Row k: an edge as maps hold it, the lower end first, and its thickness."""
    if y0 > y1 or (y0 == y1 and x0 > x1):
        y0, x0, y1, x1 = y1, x1, y0, x0
        label = 3 * (label % 3) + label // 3
    rows[k, 0], rows[k, 1], rows[k, 2], rows[k, 3], rows[k, 4], rows[k, 5] = y0, x0, y1, x1, label, thickness


@kernel(
    "Tuple((i8, i8, i8))(i4[:,::1], i4[::1], i8, i8[:,::1], i4[::1], i4[::1], u1[::1], u1[::1], i8, i8[:,::1],"
    " i8[:,::1], i8[:,::1])",
)
def list_changes(
    records: NDArray[np.int32],
    touched: NDArray[np.int32],
    touched_count: int,
    edges: NDArray[np.int64],
    tails: NDArray[np.int32],
    arc_of: NDArray[np.int32],
    labels: NDArray[np.uint8],
    thickness: NDArray[np.uint8],
    count: int,
    removed: NDArray[np.int64],
    added: NDArray[np.int64],
    rethickened: NDArray[np.int64],
) -> tuple[int, int, int]:
    """Compare the edges of the touched records with the new ones, by content; returns how many rows of each kind.

    ``thickness`` is that of the edge that leaves each corner.
    """
    size = 16
    while size < 4 * touched_count:
        size *= 2
    table = np.zeros((size, 2), np.int64)
    row = np.empty((1, 6), np.int64)
    stays = np.zeros(touched_count, np.uint8)
    for k in range(touched_count):
        r = touched[k]
        h = records[r, NEXT]
        write_row(row, 0, records[r, AT_Y], records[r, AT_X], records[h, AT_Y], records[h, AT_X], records[r, LABEL], 0)
        insert_record(table, row_hash(row[0, 0], row[0, 1], row[0, 2], row[0, 3], row[0, 4]), k)
    gone, new, changed = 0, 0, 0
    for e in range(count):
        d = thickness[tails[e]]
        write_row(added, new, edges[e, 0], edges[e, 1], edges[e, 2], edges[e, 3], labels[arc_of[e]], d)
        k = find_record(table, row_hash(added[new, 0], added[new, 1], added[new, 2], added[new, 3], added[new, 4]))
        if k < 0:
            new += 1
            continue
        stays[k] = 1
        if records[touched[k], THICK] != d:
            rethickened[changed, :] = added[new, :]
            changed += 1
    for k in range(touched_count):
        if stays[k]:
            continue
        r = touched[k]
        h = records[r, NEXT]
        write_row(
            removed, gone, records[r, AT_Y], records[r, AT_X], records[h, AT_Y], records[h, AT_X], records[r, LABEL], 0
        )
        gone += 1
    return gone, new, changed
