"""Numba kernels that find the stored edges which an update has to do with: see ``index_kernels`` for the words."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.kernel import kernel
from fleetmap.vectorize.conflict_kernels import conflict
from fleetmap.vectorize.fewest_kernels import is_near
from fleetmap.vectorize.index_kernels import AT_X, AT_Y, BUCKET, LABEL, NEXT, OUT, POINT_X, POINT_Y
from fleetmap.vectorize.jump_kernels import count_passes


@kernel(
    "i8(i4[:,::1], i4[:,::1], i4[:,::1], u1[::1], i8, i8, i8, i8, i8, i8, i8, b1, i8, i4[::1])",
)
def gather_touched(
    records: NDArray[np.int32],
    buckets: NDArray[np.int32],
    links: NDArray[np.int32],
    marks: NDArray[np.uint8],
    oy: int,
    ox: int,
    y0: int,
    x0: int,
    y1: int,
    x1: int,
    reach: int,
    share: bool,
    around: int,
    touched: NDArray[np.int32],
) -> int:
    """List and mark the records whose edges leave a point of the window y0 <= y <= y1, x0 <= x <= x1 (lattice).

    Of the outlines of hidden obstacles in the profile ``share``, all records, if an edge comes within ``around``.
    Returns how many.
    """
    count = 0
    wide = max(reach, around if share else 0)
    for row in range(max(y0 - wide - oy, 0) // BUCKET, min((y1 + wide - oy) // BUCKET + 1, len(buckets))):
        for column in range(max(x0 - wide - ox, 0) // BUCKET, min((x1 + wide - ox) // BUCKET + 1, buckets.shape[1])):
            link = buckets[row, column]
            while link >= 0:
                r = np.int64(links[link, 0])
                link = links[link, 1]
                if marks[r]:
                    continue
                y, x = records[r, POINT_Y], records[r, POINT_X]
                hidden = share and records[r, LABEL] == 5
                ny, nx, by, bx = y, x, y, x
                more = 0
                if hidden:
                    # The whole edge: nothing else tells that its run passes through the window.
                    h = records[r, NEXT]
                    more = around + reach
                    ny, nx = min(y, records[h, POINT_Y]), min(x, records[h, POINT_X])
                    by, bx = max(y, records[h, POINT_Y]), max(x, records[h, POINT_X])
                if y0 - more <= by and ny <= y1 + more and x0 - more <= bx and nx <= x1 + more:
                    while not marks[r]:
                        marks[r] = 2 if hidden else 1
                        touched[count] = r
                        count += 1
                        if not hidden:
                            break
                        r = np.int64(records[r, NEXT])
    return count


@kernel(
    "i8(i4[::1], i4[::1], i4[::1], i4[:,::1], i4[::1], u1[::1], i4[:,::1], i4[:,::1], i4[:,::1], u1[::1],"
    " i8[:,::1], u1[::1], i8, i8, i8, i8, i4[::1])",
)
def find_foreign(
    tails: NDArray[np.int32],
    heads: NDArray[np.int32],
    arc_of: NDArray[np.int32],
    points: NDArray[np.int32],
    offsets: NDArray[np.int32],
    closed: NDArray[np.uint8],
    records: NDArray[np.int32],
    buckets: NDArray[np.int32],
    links: NDArray[np.int32],
    marks: NDArray[np.uint8],
    edges: NDArray[np.int64],
    is_new: NDArray[np.uint8],
    count: int,
    oy: int,
    ox: int,
    reach: int,
    found: NDArray[np.int32],
) -> int:
    """List and mark stored edges, not marked so far, that new ones conflict with or have jumped over.

    Beside the first vertex of a closed arc every stored edge within reach is listed: it may have jumped over that.
    ``edges`` as in ``edge_kernels``, with one unused row at the end. Returns how many were found.
    """
    total = 0
    wide2 = (16 * (reach + 1)) ** 2
    for k in range(count):
        arc = arc_of[k]
        witness = closed[arc] and (k == 0 or arc_of[k - 1] != arc)
        if not is_new[k] and not witness:
            continue
        y0, y1 = min(edges[k, 0], edges[k, 2]) - reach, max(edges[k, 0], edges[k, 2]) + reach
        x0, x1 = min(edges[k, 1], edges[k, 3]) - reach, max(edges[k, 1], edges[k, 3]) + reach
        for row in range(max(y0 - oy, 0) // BUCKET, min((y1 - oy) // BUCKET + 1, len(buckets))):
            for column in range(max(x0 - ox, 0) // BUCKET, min((x1 - ox) // BUCKET + 1, buckets.shape[1])):
                link = buckets[row, column]
                while link >= 0:
                    r = np.int64(links[link, 0])
                    link = links[link, 1]
                    h = records[r, NEXT]
                    if (
                        marks[r]
                        or max(records[r, AT_Y], records[h, AT_Y]) < y0
                        or min(records[r, AT_Y], records[h, AT_Y]) > y1
                        or max(records[r, AT_X], records[h, AT_X]) < x0
                        or min(records[r, AT_X], records[h, AT_X]) > x1
                    ):
                        continue
                    f = count
                    edges[f, 0], edges[f, 1] = records[r, AT_Y], records[r, AT_X]
                    edges[f, 2], edges[f, 3] = records[h, AT_Y], records[h, AT_X]
                    edges[f, 4], edges[f, 5] = records[r, POINT_Y], records[r, POINT_X]
                    edges[f, 6], edges[f, 7] = records[h, POINT_Y], records[h, POINT_X]
                    hit = is_new[k] and conflict(edges, k, f)
                    if not hit and is_new[k]:
                        hit = (
                            count_passes(
                                points, tails[k], heads[k], offsets[arc], offsets[arc + 1], edges, k,
                                edges[f, 4], edges[f, 5], edges[f, 0], edges[f, 1], records[r, OUT],
                            )
                            != 0
                        )  # fmt: skip
                    if not hit and witness:
                        hit = is_near(
                            16 * edges[k, 0], 16 * edges[k, 1], 16 * edges[f, 0], 16 * edges[f, 1],
                            16 * edges[f, 2], 16 * edges[f, 3], wide2,
                        )  # fmt: skip
                    if hit and total < len(found):
                        marks[r] = 1
                        found[total] = r
                        total += 1
    return total
