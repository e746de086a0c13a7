"""Numba kernels of the verifier about what is near: an index of segments, gaps, and what is touched.

Segments are (n, 4) rows (y0, x0, y1, x1) in whole units, here 1/32 cells: |coordinate| <= 2^25, so that differences
are at most 2^26, and cross and dot products 2^53. A radius is given by its square, in 1024ths of a square unit.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.kernel import kernel

Segments = NDArray[np.int64]

MARGIN = 1e-6
"""Relative change of the radius for the float tests: far above rounding, which is below 1e-10 units."""

SLACK = 1e-8
"""Units by which float intervals may miss each other: above rounding, and far below what MARGIN does."""


@kernel("UniTuple(i8, 2)(i8, i8, i8, i8, i8, i8)")
def x_range(ay: int, ax: int, by: int, bx: int, low: int, high: int) -> tuple[int, int]:
    """Least and most x of the part of segment ab with low <= y <= high, rounded outwards; ay <= by."""
    if ay == by:
        return min(ax, bx), max(ax, bx)
    slope = (bx - ax) / (by - ay)
    first, last = ax + (max(low, ay) - ay) * slope, ax + (min(high, by) - ay) * slope
    return int(math.floor(min(first, last))) - 1, int(math.ceil(max(first, last))) + 1


@kernel("Tuple((i8[::1], i8[::1], i8[::1]))(i8[:,::1], i8)")
def make_index(segments: Segments, reach: int) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Sort segments with y0 <= y1 into square buckets, each into all that it comes within ``reach`` of.

    Returns (low_y, low_x, step, rows, columns); the first item of each bucket; the items, bucket by bucket.
    """
    n = len(segments)
    frame = np.zeros(5, np.int64)
    if n == 0:
        return frame, np.zeros(1, np.int64), np.zeros(0, np.int64)
    low_y, high_y = segments[:, 0].min() - reach, segments[:, 2].max() + reach
    low_x = min(segments[:, 1].min(), segments[:, 3].min()) - reach
    high_x = max(segments[:, 1].max(), segments[:, 3].max()) + reach
    step = max(reach, int(math.sqrt((high_y - low_y + 1.0) * (high_x - low_x + 1.0) / (2 * n)))) + 1
    rows, columns = (high_y - low_y) // step + 1, (high_x - low_x) // step + 1
    frame[0], frame[1], frame[2], frame[3], frame[4] = low_y, low_x, step, rows, columns
    first = np.zeros(rows * columns + 1, np.int64)
    items = np.zeros(0, np.int64)
    for filling in range(2):
        for i in range(n):
            ay, ax, by, bx = segments[i]
            for r in range(max((ay - reach - low_y) // step, 0), min((by + reach - low_y) // step + 1, rows)):
                top = low_y + r * step
                left, right = x_range(ay, ax, by, bx, top - reach, top + step + reach)
                for c in range(
                    max((left - reach - low_x) // step, 0), min((right + reach - low_x) // step + 1, columns)
                ):
                    bucket = r * columns + c
                    if filling:
                        first[bucket] -= 1
                        items[first[bucket]] = i
                    else:
                        first[bucket] += 1
        if not filling:
            first[:] = np.cumsum(first)
            items = np.empty(first[-1], np.int64)
    return frame, first, items


@kernel("i8(i8[::1], i8[::1], i8[::1], i8, i8, i8, i8, i8, i8[::1], i8[::1])")
def look_up(
    frame: NDArray[np.int64],
    first: NDArray[np.int64],
    items: NDArray[np.int64],
    ay: int,
    ax: int,
    by: int,
    bx: int,
    stamp: int,
    seen: NDArray[np.int64],
    found: NDArray[np.int64],
) -> int:
    """Write all that may be within reach of segment ab, ay <= by, into ``found``; returns how many.

    ``stamp`` is another number for each call; ``seen`` (n,) holds the last one of each item.
    """
    low_y, low_x, step, rows, columns = frame
    count = 0
    if rows == 0:
        return count
    for r in range(max((ay - low_y) // step, 0), min((by - low_y) // step + 1, rows)):
        top = low_y + r * step
        left, right = x_range(ay, ax, by, bx, top, top + step)
        for c in range(max((left - low_x) // step, 0), min((right - low_x) // step + 1, columns)):
            for k in range(first[r * columns + c], first[r * columns + c + 1]):
                if seen[items[k]] != stamp:
                    seen[items[k]] = stamp
                    found[count] = items[k]
                    count += 1
    return count


@kernel("UniTuple(u8, 2)(u8, u8)")
def multiply(a: np.uint64, b: np.uint64) -> tuple[np.uint64, np.uint64]:
    """High and low 64 bits of a product."""
    mask, half = np.uint64(0xFFFFFFFF), np.uint64(32)
    a0, a1, b0, b1 = a & mask, a >> half, b & mask, b >> half
    low = a0 * b0
    middle = a1 * b0 + (low >> half)
    other = a0 * b1 + (middle & mask)
    return a1 * b1 + (middle >> half) + (other >> half), (other << half) | (low & mask)


@kernel("b1(i8, i8, i8, i8, i8, i8, i8)")
def is_near(py: int, px: int, ay: int, ax: int, by: int, bx: int, radius2: int) -> bool:
    """Whether point p is at most the radius away from segment ab; exact, ``radius2`` <= 2^32."""
    dy, dx, ry, rx = by - ay, bx - ax, py - ay, px - ax
    along, length2 = dy * ry + dx * rx, dy * dy + dx * dx
    if along > 0 and along < length2:
        cross = abs(dx * ry - dy * rx)
        if cross < 1 << 26 and length2 < 1 << 30:
            return 1024 * cross * cross <= radius2 * length2
        # Floats settle what is clearly too far, so that 1024 cross fits.
        if float(cross) * float(cross) > 0.001 * radius2 * length2:
            return False
        mine, most = (
            multiply(np.uint64(cross), np.uint64(1024 * cross)),
            multiply(np.uint64(radius2), np.uint64(length2)),
        )
        return bool(mine[0] < most[0] or (mine[0] == most[0] and mine[1] <= most[1]))
    if along > 0:
        ry, rx = py - by, px - bx
    return ry * ry + rx * rx <= radius2 >> 10


@kernel("UniTuple(f8, 2)(f8, f8, f8, f8)")
def solve(offset: float, slope: float, least: float, most: float) -> tuple[float, float]:
    """The interval of t with least <= offset + slope t <= most; (inf, -inf) if there is none."""
    if slope == 0:
        return (-np.inf, np.inf) if least <= offset <= most else (np.inf, -np.inf)
    p, q = (least - offset) / slope, (most - offset) / slope
    return min(p, q), max(p, q)


@kernel("UniTuple(f8, 2)(f8, f8, f8, f8, f8, f8, f8)")
def stadium_interval(
    dy: float, dx: float, ay: float, ax: float, by: float, bx: float, radius: float
) -> tuple[float, float]:
    """Where the line from the origin in the unit direction d is within the radius of segment ab; or (inf, -inf)."""
    low, high = np.inf, -np.inf
    for k in range(2):
        cy, cx = (ay, ax) if k == 0 else (by, bx)
        middle, off = dy * cy + dx * cx, dx * cy - dy * cx
        half2 = radius * radius - off * off
        if half2 >= 0:
            half = math.sqrt(half2)
            low, high = min(low, middle - half), max(high, middle + half)
    ey, ex = by - ay, bx - ax
    length2 = ey * ey + ex * ex
    if length2 > 0:
        width = radius * math.sqrt(length2)
        p, q = solve(-(ey * ay + ex * ax), ey * dy + ex * dx, 0.0, length2)
        r, s = solve(ey * ax - ex * ay, ex * dy - ey * dx, -width, width)
        p, q = max(p, r), min(q, s)
        if p <= q:
            low, high = min(low, p), max(high, q)
    return low, high


@kernel("f8(f8[:,::1], i8[::1], i8, f8)")
def sweep(intervals: NDArray[np.float64], order: NDArray[np.int64], column: int, length: float) -> float:
    """How far from 0 the intervals cover; at least ``length`` if all of it. ``order`` is by their lower ends."""
    reach = 0.0
    met = False
    for k in order:
        low, high = intervals[k, column], intervals[k, column + 1]
        if high < -SLACK:
            continue
        if low > reach + SLACK:
            break
        met = True
        reach = max(reach, high)
    if not met:
        return -1.0
    return length if reach >= length - SLACK else reach


@kernel("void(i8[:,::1], i8[:,::1], i8, f8[::1], u1[::1])")
def find_gaps(
    segments: Segments, others: Segments, radius2: int, gaps: NDArray[np.float64], unsure: NDArray[np.uint8]
) -> None:
    """Say how far along, 0 to 1, each segment first leaves the neighbourhood of the others; NaN: it doesn't.

    ``unsure`` is set where that is all up to how floats round. The others have y0 <= y1.
    """
    radius = math.sqrt(radius2 / 1024)
    frame, first, items = make_index(others, int(math.ceil(radius)) + 1)
    seen = np.full(len(others), -1, np.int64)
    found = np.empty(len(others), np.int64)
    intervals = np.empty((len(others), 4), np.float64)
    for i in range(len(segments)):
        py, px, qy, qx = segments[i]
        vy, vx = float(qy - py), float(qx - px)
        length = math.sqrt(vy * vy + vx * vx)
        dy, dx = (vy / length, vx / length) if length > 0 else (0.0, 1.0)
        count = 0
        whole = False
        if py <= qy:
            candidates = look_up(frame, first, items, py, px, qy, qx, i, seen, found)
        else:
            candidates = look_up(frame, first, items, qy, qx, py, px, i, seen, found)
        for k in range(candidates):
            ay, ax, by, bx = others[found[k]]
            # Mostly one of them alone does it, and that is decided in integers.
            whole = is_near(py, px, ay, ax, by, bx, radius2) and is_near(qy, qx, ay, ax, by, bx, radius2)
            if whole:
                break
            ends = float(ay - py), float(ax - px), float(by - py), float(bx - px)
            low, high = stadium_interval(dy, dx, *ends, radius * (1 + MARGIN))
            if low <= high:
                intervals[count, 0], intervals[count, 1] = low, high
                low, high = stadium_interval(dy, dx, *ends, radius * (1 - MARGIN))
                intervals[count, 2], intervals[count, 3] = low, high
                count += 1
        gaps[i] = np.nan
        if whole:
            continue
        reach = sweep(intervals, np.argsort(intervals[:count, 0]), 0, length)
        if reach < length:
            gaps[i] = max(reach, 0.0) / max(length, 1e-9)
        elif sweep(intervals, np.argsort(intervals[:count, 2]), 2, length) < length:
            unsure[i] = 1


@kernel("i8(i8, i8, i8, i8, i8, i8)")
def side(ay: int, ax: int, by: int, bx: int, py: int, px: int) -> int:
    """1, 0 or -1: p lies left of, on or right of the line from a to b."""
    cross = (bx - ax) * (py - ay) - (by - ay) * (px - ax)
    return int(cross > 0) - int(cross < 0)


@kernel("void(i8[:,::1], i8[::1], i8[:,::1], i8, u1[::1])")
def find_touched(
    segments: Segments, owners: NDArray[np.int64], others: Segments, radius2: int, touched: NDArray[np.uint8]
) -> None:
    """Set ``touched`` for each owner of a segment that comes within the radius of some other one; exact.

    All have y0 <= y1.
    """
    frame, first, items = make_index(others, int(math.ceil(math.sqrt(radius2 / 1024))) + 1)
    seen = np.full(len(others), -1, np.int64)
    found = np.empty(len(others), np.int64)
    for i in range(len(segments)):
        if touched[owners[i]]:
            continue
        py, px, qy, qx = segments[i]
        for k in range(look_up(frame, first, items, py, px, qy, qx, i, seen, found)):
            ay, ax, by, bx = others[found[k]]
            # The least distance is at an end of one of both, unless they cross.
            if (
                is_near(py, px, ay, ax, by, bx, radius2)
                or is_near(qy, qx, ay, ax, by, bx, radius2)
                or is_near(ay, ax, py, px, qy, qx, radius2)
                or is_near(by, bx, py, px, qy, qx, radius2)
                or (
                    side(py, px, qy, qx, ay, ax) * side(py, px, qy, qx, by, bx) < 0
                    and side(ay, ax, by, bx, py, px) * side(ay, ax, by, bx, qy, qx) < 0
                )
            ):
                touched[owners[i]] = 1
                break


@kernel("i8[:,::1](i8[:,::1], i8[:,::1], i8[::1], i8)")
def find_near_numbers(
    points: NDArray[np.int64], segments: Segments, numbers: NDArray[np.int64], radius2: int
) -> NDArray[np.int64]:
    """(m, 2) the different (point, number) where a segment of that number is within the radius of the point.

    Segments have y0 <= y1.
    """
    frame, first, items = make_index(segments, int(math.ceil(math.sqrt(radius2 / 1024))) + 1)
    seen = np.full(len(segments), -1, np.int64)
    found = np.empty(len(segments), np.int64)
    last = np.full(numbers.max() + 1 if len(numbers) else 0, -1, np.int64)  # the point that had each number
    pairs = np.empty((64, 2), np.int64)
    count = 0
    for i in range(len(points)):
        py, px = points[i]
        for k in range(look_up(frame, first, items, py, px, py, px, i, seen, found)):
            number = numbers[found[k]]
            ay, ax, by, bx = segments[found[k]]
            if last[number] == i or not is_near(py, px, ay, ax, by, bx, radius2):
                continue
            last[number] = i
            if count == len(pairs):
                longer = np.empty((2 * count, 2), np.int64)
                longer[:count] = pairs
                pairs = longer
            pairs[count, 0], pairs[count, 1] = i, number
            count += 1
    return pairs[:count].copy()
