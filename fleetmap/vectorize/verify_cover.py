"""Is every point of a segment within epsilon of some other segment? Decided exactly, without sampling.

The points within epsilon of a segment form a stadium. It is convex, so it cuts an interval out of any other
segment, and the question is whether those intervals cover it. Their ends are of the form q + sqrt(k) with
rational q and k. Floats with a slightly smaller and a slightly larger epsilon settle nearly all segments; the
rest, among them all whose distance is epsilon itself, are settled by exact comparison.
"""

from __future__ import annotations

import math
from fractions import Fraction
from functools import cmp_to_key
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

UNIT = 32
"""Coordinates are whole 1/32 cells here: grids lie on sixteenths of the lattice, and cell centres halve those."""

MARGIN = 1e-6
"""Relative change of epsilon for the float tests: far above rounding, which is below 1e-12 cells."""


def first_gaps(segments: NDArray[np.int64], others: NDArray[np.int64], epsilon2: Fraction) -> NDArray[np.float64]:
    """Find where each segment first leaves the neighbourhood of all others.

    Parameters
    ----------
    segments, others : (n, 4), (m, 4) rows (y0, x0, y1, x1) in 1/32 cells; both ends may be one point
    epsilon2 : square of epsilon, in cells

    Returns
    -------
    (n,) float64 : NaN where every point of the segment is at most epsilon away from some other one, which is
        decided exactly; else how far along, 0 to 1, the first gap begins, to some thousandths of a cell
    """
    which, other = _near_pairs(segments, others, math.sqrt(epsilon2) * (1 + 2 * MARGIN))
    surely_covered = np.isnan(_float_gaps(segments, others, which, other, math.sqrt(epsilon2) * (1 - MARGIN)))
    gaps = _float_gaps(segments, others, which, other, math.sqrt(epsilon2) * (1 + MARGIN))
    for i in np.flatnonzero(np.isnan(gaps) & ~surely_covered):
        near = others[other[np.searchsorted(which, i) : np.searchsorted(which, i, "right")]]
        gaps[i] = exact_gap(segments[i].tolist(), near.tolist(), epsilon2 * UNIT**2)
    return gaps


def _near_pairs(
    segments: NDArray[np.int64], others: NDArray[np.int64], distance: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Indices (segment, other) of all pairs at most ``distance`` cells apart, ascending."""
    import shapely

    def shapes(ends: NDArray[np.int64]) -> NDArray[np.object_]:
        lines: NDArray[np.object_] = shapely.linestrings(ends.reshape(-1, 2, 2) / UNIT)
        is_point = (ends[:, :2] == ends[:, 2:]).all(axis=1)  # GEOS finds nothing near a line of no length
        lines[is_point] = shapely.points(ends[is_point, :2] / UNIT)
        return lines

    which, other = shapely.STRtree(shapes(others)).query(shapes(segments), predicate="dwithin", distance=distance)
    order = np.lexsort((other, which))
    return which[order], other[order]


def _float_gaps(
    segments: NDArray[np.int64],
    others: NDArray[np.int64],
    which: NDArray[np.int64],
    other: NDArray[np.int64],
    radius: float,
) -> NDArray[np.float64]:
    """``first_gaps`` in floats for a radius in cells, given the pairs that may be near."""
    ends = segments.reshape(-1, 2, 2) / UNIT
    along = ends[:, 1] - ends[:, 0]
    length = np.hypot(*along.T)
    # A point is a segment of length 0 in any direction.
    direction = np.divide(along, length[:, None], out=np.tile([0.0, 1.0], (len(along), 1)), where=length[:, None] > 0)

    # Where the line through each segment, measured from its start, is in the stadium of the other one:
    # in one of the discs around its ends, or in the strip between them.
    start, d = ends[which, 0], direction[which]
    a, b = np.moveaxis(others[other].reshape(-1, 2, 2) / UNIT, 1, 0)
    low, high = np.full(len(which), np.inf), np.full(len(which), -np.inf)
    for centre in (a, b):
        middle, half2 = _dot(d, centre - start), radius**2 - _cross(d, centre - start) ** 2
        half = np.where(half2 >= 0, np.sqrt(np.maximum(half2, 0)), np.nan)
        low, high = np.fmin(low, middle - half), np.fmax(high, middle + half)
    e = b - a
    width = radius * np.hypot(*e.T)
    between = _solve(_dot(e, start - a), _dot(e, d), np.zeros_like(width), _dot(e, e))
    beside = _solve(_cross(e, start - a), _cross(e, d), -width, width)
    strip_low, strip_high = np.maximum(between[0], beside[0]), np.minimum(between[1], beside[1])
    in_strip = (strip_low <= strip_high) & (width > 0)
    low = np.where(in_strip, np.minimum(low, strip_low), low)
    high = np.where(in_strip, np.maximum(high, strip_high), high)

    # Sweep along each segment by the intervals that meet it, in the order of their lower ends.
    meets = (low <= high) & (high >= 0) & (low <= length[which])
    order = np.lexsort((low[meets], which[meets]))
    i, low, high = which[meets][order], np.maximum(low[meets][order], 0), high[meets][order]
    high = np.minimum(high, length[i])
    # All segments end to end on one axis, so that one running maximum serves for all.
    offset = np.cumsum(length + 1) - length
    reach = np.maximum.accumulate(high + offset[i]) - offset[i]
    first = np.diff(i, prepend=-1) > 0
    before = np.where(first, 0, np.roll(reach, 1))
    gaps: NDArray[np.float64] = np.zeros(len(segments))  # nothing meets it: a gap from the start
    last = np.diff(i, append=len(segments)) > 0
    gaps[i[last]] = np.where(reach[last] >= length[i[last]] - 1e-9, np.nan, reach[last])
    broken = np.flatnonzero(low > before + 1e-9)[::-1]  # so that the first gap of a segment is written last
    gaps[i[broken]] = before[broken]
    gaps /= np.maximum(length, 1e-9)
    return gaps


def _dot(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    product: NDArray[np.float64] = (a * b).sum(axis=1)
    return product


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    product: NDArray[np.float64] = a[:, 1] * b[:, 0] - a[:, 0] * b[:, 1]
    return product


def _solve(
    offset: NDArray[np.float64], slope: NDArray[np.float64], least: NDArray[np.float64], most: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The interval of t with least <= offset + slope t <= most; (inf, -inf) if there is none."""
    with np.errstate(divide="ignore", invalid="ignore"):
        p, q = (least - offset) / slope, (most - offset) / slope
    always = (slope == 0) & (least <= offset) & (offset <= most)
    never = (slope == 0) & ~always
    low = np.where(always, -np.inf, np.where(never, np.inf, np.minimum(p, q)))
    return low, np.where(always, np.inf, np.where(never, -np.inf, np.maximum(p, q)))


CLOSE = 1e-6
"""Parameters that differ by more are told apart by floats; near ones are at most some hundred, so these suffice."""


class Root(NamedTuple):
    """The number q + sign * sqrt(k), k >= 0."""

    q: Fraction
    sign: int = 0
    k: Fraction = Fraction(0)

    def approx(self) -> float:
        """The number, to some 1e-12."""
        return float(self.q) + self.sign * math.sqrt(self.k)


def compare_roots(x: Root, y: Root) -> int:
    """-1, 0 or 1 as x is less than, equal to or more than y; exact."""
    difference = x.approx() - y.approx()
    if abs(difference) > CLOSE:
        return 1 if difference > 0 else -1
    rational = x.q - y.q
    roots = _sign(x.sign * x.k - y.sign * y.k)  # sign * sqrt(k) grows with sign * k
    if _sign(rational) * roots >= 0:
        return _sign(rational) or roots
    # Of opposite signs: the larger square wins, and their difference is excess + mixed * sqrt(mixed2).
    excess = rational**2 - x.k - y.k
    mixed, mixed2 = x.sign * y.sign, 4 * x.k * y.k
    if mixed2 == 0:
        larger = _sign(excess)
    elif _sign(excess) * mixed >= 0:
        larger = _sign(excess) or mixed
    else:
        larger = _sign(excess) * _sign(excess**2 - mixed2)
    return larger * _sign(rational)


def _sign(value: Fraction) -> int:
    return (value > 0) - (value < 0)


_by_value = cmp_to_key(compare_roots)
ZERO, ONE = Root(Fraction(0)), Root(Fraction(1))


def exact_gap(segment: list[int], others: list[list[int]], radius2: Fraction) -> float:
    """``first_gaps`` for one segment by rational arithmetic alone; all in one unit."""
    intervals = [found for other in others if (found := _exact_interval(segment, other, radius2)) is not None]
    reach = ZERO
    covered_start = False
    for low, high in sorted(intervals, key=lambda interval: _by_value(interval[0])):
        if compare_roots(high, ZERO) < 0:
            continue
        if compare_roots(low, reach) > 0:
            break
        covered_start = True
        reach = max(reach, high, key=_by_value)
    if covered_start and compare_roots(reach, ONE) >= 0:
        return math.nan
    return reach.approx()


def _exact_interval(segment: list[int], other: list[int], radius2: Fraction) -> tuple[Root, Root] | None:
    """Parameters t between which the line start + t (end - start) is in the stadium of the other segment."""
    (py, px, qy, qx), (ay, ax, by, bx) = segment, other
    dy, dx, ey, ex = qy - py, qx - px, by - ay, bx - ax
    d2, e2 = dy * dy + dx * dx, ey * ey + ex * ex
    if d2 == 0:
        # A point: it has all parameters or none; ask for its distance from the middle of the strip or the ends.
        t = max(Fraction(0), min(Fraction(1), Fraction((py - ay) * ey + (px - ax) * ex, e2))) if e2 else Fraction(0)
        near = (py - ay - t * ey) ** 2 + (px - ax - t * ex) ** 2 <= radius2
        return (ZERO, ONE) if near else None

    found: list[tuple[Root, Root]] = []
    for cy, cx in ((ay, ax), (by, bx)):
        wy, wx = cy - py, cx - px
        half2 = radius2 * d2 - (dx * wy - dy * wx) ** 2
        if half2 >= 0:
            middle = Fraction(dy * wy + dx * wx, d2)
            found.append((Root(middle, -1, half2 / d2**2), Root(middle, 1, half2 / d2**2)))
    if e2:
        wy, wx = py - ay, px - ax
        lows, highs, inside = [], [], True
        offset, slope = wy * ey + wx * ex, dy * ey + dx * ex
        if slope:
            between = sorted((Fraction(-offset, slope), Fraction(e2 - offset, slope)))
            lows.append(Root(between[0]))
            highs.append(Root(between[1]))
        else:
            inside = 0 <= offset <= e2
        offset, slope = ex * wy - ey * wx, ex * dy - ey * dx
        if slope:
            half2 = radius2 * e2 / slope**2
            lows.append(Root(Fraction(-offset, slope), -1, half2))
            highs.append(Root(Fraction(-offset, slope), 1, half2))
        else:
            inside = inside and offset**2 <= radius2 * e2
        low, high = max(lows, key=_by_value), min(highs, key=_by_value)
        if inside and compare_roots(low, high) <= 0:
            found.append((low, high))
    if not found:
        return None
    return min((f[0] for f in found), key=_by_value), max((f[1] for f in found), key=_by_value)
