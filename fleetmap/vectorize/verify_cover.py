"""Is every point of a segment within epsilon of some other segment? Decided exactly, without sampling.

The points within epsilon of a segment form a stadium. It is convex, so it cuts an interval out of any other
segment, and the question is whether those intervals cover it. Their ends are of the form q + sqrt(k) with
rational q and k. Nearly always one stadium holds both ends of the segment, which is a question of integers, or
floats with a slightly larger epsilon leave a gap. The rest is settled by exact comparison.
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

Segments = NDArray[np.int64]
"""(n, 4) rows (y0, x0, y1, x1) in 1/32 cells of the map's lattice; both ends may be one point."""


def first_gaps(segments: Segments, others: Segments, epsilon2: Fraction) -> NDArray[np.float64]:
    """Find where each segment first leaves the neighbourhood of all others.

    Parameters
    ----------
    epsilon2 : square of epsilon, in cells

    Returns
    -------
    (n,) float64 : NaN where every point of the segment is at most epsilon away from some other one, which is
        decided exactly; else how far along, 0 to 1, the first gap begins, to some thousandths of a cell
    """
    from fleetmap.vectorize.verify_near_kernels import find_gaps

    others = _ascending(others)
    gaps, unsure = np.empty(len(segments)), np.zeros(len(segments), np.uint8)
    find_gaps(np.ascontiguousarray(segments), others, to_radius2(epsilon2), gaps, unsure)
    reach = math.ceil(math.sqrt(epsilon2) * UNIT)
    for i in np.flatnonzero(unsure):
        ends = segments[i].reshape(2, 2)
        low, high = ends.min(axis=0) - reach, ends.max(axis=0) + reach
        near = (others[:, 2] >= low[0]) & (others[:, 0] <= high[0])
        near &= (others[:, 1::2].max(axis=1) >= low[1]) & (others[:, 1::2].min(axis=1) <= high[1])
        gaps[i] = exact_gap(segments[i].tolist(), others[near].tolist(), epsilon2 * UNIT**2)
    return gaps


def find_touched_owners(
    segments: Segments, owners: NDArray[np.int64], count: int, others: Segments, epsilon2: Fraction
) -> NDArray[np.bool_]:
    """(count,) which owners have a point of their segments at most epsilon away from some other segment; exact.

    Parameters
    ----------
    owners : (n,) the owner, 0 to count - 1, of each segment
    epsilon2 : square of epsilon, in cells; a whole number of 2^-20
    """
    from fleetmap.vectorize.verify_near_kernels import find_touched

    touched = np.zeros(count, np.uint8)
    find_touched(_ascending(segments), owners.astype(np.int64), _ascending(others), to_radius2(epsilon2), touched)
    return touched > 0


def to_radius2(epsilon2: Fraction) -> int:
    """The square of a radius as the kernels take it, 1024ths of a square unit: exact from whole 2^-20 cells on."""
    return math.floor(epsilon2 * UNIT**2 * 1024)


def _ascending(segments: Segments) -> Segments:
    """The same segments with y0 <= y1."""
    down = segments[:, 0] > segments[:, 2]
    if down.any():
        segments = np.where(down[:, None], segments[:, [2, 3, 0, 1]], segments)
    return np.ascontiguousarray(segments, np.int64)


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
