"""A numba kernel that traces what of the boundary may have changed: the arcs that meet a window, vertex to vertex.

Outside of the window all is as it was, and points that a stored vertex stands for are marked. So an arc that enters
the window is followed back to the last vertex before it, and on to the first one behind it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.kernel import kernel
from fleetmap.vectorize.index_kernels import find_record, passage_key
from fleetmap.vectorize.obstacle_kernels import NEAR_STEPS, is_behind
from fleetmap.vectorize.walk_kernels import NODE, left_of, pass_through, right_of, step_x, step_y

WITH_RIGHT, WITHOUT_RIGHT = 16, 64
"""Bits of ``cracks`` within the window: the passage through the point's right crack, or the other one, was walked."""

VERTEX = 32
"""Bit of ``cracks``: a stored vertex stands for the point."""


@kernel("i8(i4[:,::1], u1[::1], i8, i8, i8, i8)", inline="always")
def put(units: NDArray[np.int32], leaves: NDArray[np.uint8], size: int, y: int, x: int, d: int) -> int:
    """Append a point, and the direction in which it is left; returns the new size."""
    units[size, 0], units[size, 1] = y, x
    leaves[size] = d
    return size + 1


@kernel(
    "i8(u1[:,::1], u1[:,::1], i8[:,::1], i8, i8, i8, i8, i8, i8, i8, i8, i8, b1, i4[:,::1], u1[::1], i8, i8[::1])",
)
def follow(
    states: NDArray[np.uint8],
    cracks: NDArray[np.uint8],
    table: NDArray[np.int64],
    oy: int,
    ox: int,
    y0: int,
    x0: int,
    y1: int,
    x1: int,
    y: int,
    x: int,
    d: int,
    close: bool,
    units: NDArray[np.int32],
    leaves: NDArray[np.uint8],
    size: int,
    ending: NDArray[np.int64],
) -> int:
    """Walk from (y, x) in direction d to the next vertex outside of the window, a node, or once around if ``close``.

    Appends all points, the first one too; of an open arc also the last one, which is left in direction 4 + that of
    the last step. ``ending`` gets the record of the vertex, or -1. Returns the new size, or -1 if there is no room.
    """
    first_y, first_x, first_d = y, x, d
    room = len(units) - 2
    ending[0] = -1
    while True:
        if size >= room:
            return -1
        size = put(units, leaves, size, y + oy, x + ox, d)
        if y0 <= y <= y1 and x0 <= x <= x1 and (y != first_y or x != first_x or d != first_d):
            # The passage uses the right crack if it leaves by it, or came in by it.
            cracks[y, x] |= WITH_RIGHT if d == 0 or leaves[size - 2] == 2 else WITHOUT_RIGHT
        y += step_y(d)
        x += step_x(d)
        turned = pass_through(states, cracks, y, x, d)
        inside = y0 <= y <= y1 and x0 <= x <= x1
        if turned == NODE:
            if not inside:
                ending[0] = find_record(table, passage_key(y + oy, x + ox, 4 + d))
            return put(units, leaves, size, y + oy, x + ox, 4 + d)
        if close and y == first_y and x == first_x and turned == first_d:
            cracks[y, x] |= WITH_RIGHT if turned == 0 or d == 2 else WITHOUT_RIGHT
            return size
        if not inside and cracks[y, x] & VERTEX:
            record = find_record(table, passage_key(y + oy, x + ox, turned))
            if record >= 0:
                ending[0] = record
                return put(units, leaves, size, y + oy, x + ox, 4 + d)
        d = turned


@kernel(
    "Tuple((i8, i8))(u1[:,::1], u1[:,::1], u1[:,::1], i8[:,::1], i4[:,::1], i8, i4[:,::1], i8, i8, i8, i8, i8, i8, i8,"
    " b1, b1, i4[::1], i4[::1], i8, i8, i4[:,::1], u1[::1], i4[::1], u1[::1], u1[::1], i4[::1], i4[::1])",
)
def trace_window(
    states: NDArray[np.uint8],
    cracks: NDArray[np.uint8],
    seen: NDArray[np.uint8],
    table: NDArray[np.int64],
    records: NDArray[np.int32],
    count: int,
    corners: NDArray[np.int32],
    oy: int,
    ox: int,
    y0: int,
    x0: int,
    y1: int,
    x1: int,
    forced: int,
    whole: bool,
    share: bool,
    starts: NDArray[np.int32],
    touched: NDArray[np.int32],
    touched_count: int,
    most: int,
    units: NDArray[np.int32],
    leaves: NDArray[np.uint8],
    offsets: NDArray[np.int32],
    labels: NDArray[np.uint8],
    closed: NDArray[np.uint8],
    first: NDArray[np.int32],
    last: NDArray[np.int32],
) -> tuple[int, int]:
    """Trace all arcs that meet the window of points y0 <= y <= y1, x0 <= x <= x1, in coordinates of the arrays.

    Parameters
    ----------
    table, records : see ``index_kernels``; lattice coordinates are those of the arrays plus (oy, ox)
    count, corners : corners in and around the window, in raster order
    forced, starts : this many records outside of the window whose edges are traced in any case
    whole : the window is everything
    share : arcs between occupied and unknown are left out, but for closed outlines of hidden obstacles
    touched : records whose edges are given up; outlines among them are looked for where they were
    most : room for arcs
    units, leaves : out: points (y, x) on the lattice, a unit step apart, and the direction in which each is left
    offsets, labels, closed : out, of arcs
    first, last : out: records at the ends of open arcs outside of the window, else -1

    Returns
    -------
    arcs, points : how many; -1, 0 if there is no room
    """
    ending = np.empty(1, np.int64)
    queue = np.empty(((2 * NEAR_STEPS + 1) ** 2, 2), np.int32)
    used = np.zeros(len(records) + 1, np.uint8)
    arcs, size = 0, 0
    offsets[0] = 0

    # 1. Arcs that begin at a stored vertex: those that are forced, and those that enter the window.
    ring = 0 if whole else 2 * (y1 - y0 + 1) + 2 * (x1 - x0 + 1)
    for k in range(forced + ring):
        record = -1
        if k < forced:
            record = starts[k]
        else:
            n = k - forced
            if n < x1 - x0 + 1:
                y, x, d = y0, x0 + n, 1
            elif n < 2 * (x1 - x0 + 1):
                y, x, d = y1, x0 + n - (x1 - x0 + 1), 3
            elif n < 2 * (x1 - x0 + 1) + y1 - y0 + 1:
                y, x, d = y0 + n - 2 * (x1 - x0 + 1), x0, 0
            else:
                y, x, d = y0 + n - 2 * (x1 - x0 + 1) - (y1 - y0 + 1), x1, 2
            # Who enters in direction d came along the crack on the other side.
            back = (d + 2) & 3
            if not (cracks[y, x] >> back) & 1:
                continue
            y, x = y + step_y(back), x + step_x(back)
            left, right = left_of(states, y, x, d), right_of(states, y, x, d)
            if left > right or (share and left == 1):
                continue
            while True:
                # At (y, x), left in direction d; is there a vertex?
                if cracks[y, x] & VERTEX:
                    record = find_record(table, passage_key(y + oy, x + ox, d))
                    if record >= 0:
                        break
                came = pass_through(states, cracks, y, x, (d + 2) & 3)
                if came == NODE:
                    break
                d = (came + 2) & 3
                y, x = y - step_y(d), x - step_x(d)
                if y0 <= y <= y1 and x0 <= x <= x1:
                    break
        if record < 0 or used[record]:
            continue
        used[record] = 1
        if arcs + 1 >= most:
            return -1, 0
        y, x, d = records[record, 2] - oy, records[record, 3] - ox, records[record, 4]
        labels[arcs] = 3 * left_of(states, y, x, d) + right_of(states, y, x, d)
        closed[arcs] = 0
        first[arcs] = record
        size = follow(states, cracks, table, oy, ox, y0, x0, y1, x1, y, x, d, False, units, leaves, size, ending)
        if size < 0:
            return -1, 0
        last[arcs] = ending[0]
        arcs += 1
        offsets[arcs] = size

    # 2. Arcs that begin at nodes in the window, then closed ones.
    for close in (False, True):
        for c in range(count):
            y, x = corners[c, 0], corners[c, 1]
            if y < y0 or y > y1 or x < x0 or x > x1:
                continue
            bits = cracks[y, x]
            four = bits & 15 == 15
            if close:
                # With two cracks there is one passage: is it walked already?
                if not four and bits & (WITH_RIGHT if bits & 1 else WITHOUT_RIGHT):
                    continue
            elif not four and bits & 15 not in (7, 11, 13, 14):
                continue
            for crack in range(4):
                if not (bits >> crack) & 1:
                    continue
                d = crack
                other = pass_through(states, cracks, y, x, (crack + 2) & 3)
                if (other == NODE) == close:
                    continue
                if left_of(states, y, x, d) > right_of(states, y, x, d):
                    if not close:
                        continue
                    d = other
                left, right = left_of(states, y, x, d), right_of(states, y, x, d)
                if share and left == 1:
                    continue
                if close:
                    # Each closed arc once, whichever of its points comes first.
                    bit = WITH_RIGHT if (crack == 0 or other == 0) else WITHOUT_RIGHT
                    if cracks[y, x] & bit:
                        continue
                if arcs + 1 >= most:
                    return -1, 0
                labels[arcs] = 3 * left + right
                closed[arcs] = close
                first[arcs] = -1
                begin = size
                size = follow(
                    states, cracks, table, oy, ox, y0, x0, y1, x1, y, x, d, close, units, leaves, size, ending
                )
                if size < 0:
                    return -1, 0
                last[arcs] = ending[0]
                if close and leaves[size - 1] >= 4:
                    # It leads to a vertex outside, and was traced from there.
                    size = begin
                    continue
                arcs += 1
                offsets[arcs] = size
    if not share:
        return arcs, size

    # 3. Outlines of hidden obstacles, always as a whole.
    for c in range(count + touched_count):
        if c < count:
            y, x = np.int64(corners[c, 0]), np.int64(corners[c, 1])
        else:
            r = touched[c - count]
            if records[r, 6] != 5:
                continue
            y, x = np.int64(records[r, 2] - oy), np.int64(records[r, 3] - ox)
        bits = cracks[y, x]
        for crack in range(4):
            if not (bits >> crack) & 1 or left_of(states, y, x, crack) != 1 or right_of(states, y, x, crack) != 2:
                continue
            begin = size
            area = np.int64(0)
            least = np.int64(1) << 60
            start = size
            ny, nx, d = y, x, np.int64(crack)
            alone = True
            while True:
                if size >= len(units) - 2:
                    return -1, 0
                cy, cx = ny - (d >= 2), nx - (d == 1 or d == 2)
                if (size == begin or leaves[size - 1] != d) and is_behind(states, seen, queue, cy, cx):
                    alone = False
                    break
                key = passage_key(ny + oy, nx + ox, d)
                if key < least:
                    least, start = key, size
                size = put(units, leaves, size, ny + oy, nx + ox, d)
                area += step_y(d) * nx - step_x(d) * ny
                ny, nx = ny + step_y(d), nx + step_x(d)
                d = pass_through(states, cracks, ny, nx, d)
                if d == NODE:
                    alone = False
                    break
                if ny == y and nx == x and d == crack:
                    break
            # Found from each of its corners: the first one of all wins.
            known = False
            for arc in range(arcs):
                if (
                    labels[arc] == 5
                    and passage_key(units[offsets[arc], 0], units[offsets[arc], 1], leaves[offsets[arc]]) == least
                ):
                    known = True
            if not alone or area < 0 or known:
                size = begin
                continue
            if arcs + 1 >= most:
                return -1, 0
            length = size - begin
            if size + length >= len(units) - 2:
                return -1, 0
            for q in range(length):
                source = start + q if start + q < begin + length else start + q - length
                size = put(units, leaves, size, units[source, 0], units[source, 1], leaves[source])
            for q in range(length):
                units[begin + q, 0], units[begin + q, 1] = units[begin + length + q, 0], units[begin + length + q, 1]
                leaves[begin + q] = leaves[begin + length + q]
            size = begin + length
            labels[arcs], closed[arcs], first[arcs], last[arcs] = 5, 1, -1, -1
            arcs += 1
            offsets[arcs] = size
    return arcs, size
