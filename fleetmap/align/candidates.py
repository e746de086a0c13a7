"""Step 1: where the second map might lie. Rotations by direction histograms, then translations by votes of all walls.

Exhaustive and deterministic. The histograms are correlated over the whole circle (Carpin 2008 does so with Hough
spectra); of maps with few directions that leaves few rotations, of cluttered ones most. For each of them all
translations are voted on at once, by FFT: walls on walls that face alike count for a translation, walls in the other's
free space against it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from fleetmap.align.walls import CELL_M, Floats, Walls, rotated

BINS = 720
"""Of the circle: half a degree each."""
BLUR_BINS = 2.0
LIKE_ENOUGH = 0.35
"""Of the best likeness of two histograms: less is no rotation to try. With 0.55 one true place in thirty was missed."""
APART_BINS = 6
"""Rotations that are tried are at least 3 degrees apart: 0.4 m at 8 m from the middle."""
VOTE_M, MOST_CELLS = 0.4, 800
"""A cell of the votes; a larger one, of larger maps, so that they have no more than that along each axis."""
DIRECTIONS = 8
"""In which walls vote apart from each other."""
AGAINST = 1.0
"""How much a wall in the other's free space counts, beside one on a wall."""
DEEP_M = 0.3
"""Free space counts from so far behind its border on: walls are where they are but for so much."""
PEAKS = 20
"""Of one rotation. With 3 of them one place in six was missed where parts of a building are alike, and so a rival."""
PEAK_APART_CELLS = 3
MOST = 200
"""Of all rotations."""


def candidates(a: Walls, b: Walls, within: Window | None = None) -> Floats:
    """Places of b in a, the most voted first: rows (x, y, yaw) with p_a = R(yaw) p_b + (x, y)."""
    votes = Votes(a, b)
    yaws = [yaw_rad for yaw_rad in rotations(a, b) if within is None or within.has_yaw(yaw_rad)]
    found = sorted(place for yaw_rad in yaws for place in votes.peaks(yaw_rad, within))
    return np.array([place for _, place in found[:MOST]], np.float64).reshape(-1, 3)


@dataclass(frozen=True, slots=True)
class Window:
    """Places near one.

    Parameters
    ----------
    pivot_xy : a point of b
    there_xy, yaw_rad : where that one puts it in a, and its yaw
    radius_m, radius_rad : how far from there others may put it
    """

    pivot_xy: tuple[float, float]
    there_xy: tuple[float, float]
    yaw_rad: float
    radius_m: float
    radius_rad: float

    def has_yaw(self, yaw_rad: float) -> bool:
        """Whether a place with that yaw may be one."""
        return abs(math.remainder(yaw_rad - self.yaw_rad, math.tau)) <= self.radius_rad

    def away_m(self, x_m: Floats, y_m: Floats, yaw_rad: float) -> Floats:
        """How far from there places of one yaw put the point."""
        x, y = rotated(yaw_rad, np.array(self.pivot_xy))
        away: Floats = np.hypot(x_m + x - self.there_xy[0], y_m + y - self.there_xy[1])
        return away

    def has(self, row: Floats) -> bool:
        """Whether a place (x, y, yaw) is one."""
        return self.has_yaw(float(row[2])) and bool(self.away_m(row[0], row[1], float(row[2])) <= self.radius_m)


def rotations(a: Walls, b: Walls) -> list[float]:
    """Yaws at which walls of both face alike, the most of them first, each 3 degrees from all before it."""
    spectrum_a, spectrum_b = histogram(a), histogram(b)
    likeness = np.fft.irfft(np.fft.rfft(spectrum_a) * np.conj(np.fft.rfft(spectrum_b)), BINS)
    free, found = np.ones(BINS, bool), []
    for k in np.argsort(-likeness, kind="stable"):
        if likeness[k] < LIKE_ENOUGH * likeness.max():
            break
        if free[k]:
            found.append(float(finer(likeness, int(k)) * 2 * math.pi / BINS))
            free[(k + np.arange(-APART_BINS, APART_BINS + 1)) % BINS] = False
    return found


def finer(values: Floats, k: int) -> float:
    """The place of a peak between bins, by the parabola through it and its neighbours."""
    before, at, after = values[k - 1], values[k], values[(k + 1) % len(values)]
    bend = before - 2 * at + after
    return k + (0.5 * (before - after) / bend if bend < 0 else 0.0)


def histogram(walls: Walls) -> Floats:
    """(BINS,) metres of wall by the direction that they face, blurred."""
    direction = np.arctan2(walls.normals_xy[:, 1], walls.normals_xy[:, 0])
    where = np.floor(direction / (2 * math.pi) * BINS).astype(np.int64) % BINS
    counts = np.bincount(where, walls.lengths_m, BINS)
    blurred: Floats = ndimage.gaussian_filter1d(counts, BLUR_BINS, mode="wrap")
    return blurred


def vote_cell_m(a: Walls, b: Walls) -> float:
    """The size of a cell of their votes."""
    longest_m = float(sum(max(walls.states_yx.shape) for walls in (a, b))) * CELL_M
    return VOTE_M * max(1, math.ceil(longest_m / (MOST_CELLS * VOTE_M)))


class Votes:
    """All translations of b at once, for one rotation after the other."""

    def __init__(self, a: Walls, b: Walls) -> None:
        self._b, self._cell_m = b, vote_cell_m(a, b)
        reach = float(np.hypot(*np.ptp(np.vstack([b.points_xy, corners(b)]), axis=0)))
        self._low_a = np.minimum(a.points_xy.min(axis=0), a.corner_xy)
        high_a = np.maximum(a.points_xy.max(axis=0), a.corner_xy + CELL_M * np.array(a.states_yx.shape[::-1]))
        self._most = np.ceil((high_a - self._low_a) / self._cell_m).astype(int)
        extent = high_a - self._low_a + reach
        self._shape = tuple(fft.next_fast_len(int(n), real=True) for n in np.ceil(extent[::-1] / self._cell_m) + 2)
        # Whose walls are there counts once, however many points stand for them: votes are metres of b.
        self._walls_a = self._transform(self._there(a))
        self._all_a = self._transform(self._raster(a.points_xy, a.lengths_m, self._low_a))
        self._free_a = self._transform(self._free(a, 0.0, self._low_a))

    def peaks(self, yaw_rad: float, within: Window | None = None) -> list[tuple[float, tuple[float, float, float]]]:
        """The translations with the most votes: their negative, and (x, y, yaw)."""
        points, normals = rotated(yaw_rad, self._b.points_xy), rotated(yaw_rad, self._b.normals_xy)
        low = np.minimum(points.min(axis=0), rotated(yaw_rad, corners(self._b)).min(axis=0))
        walls_b = self._transform(self._by_direction(points, normals, self._b.lengths_m, low))
        all_b = walls_b.sum(axis=0)
        free_b = self._transform(self._free(self._b, yaw_rad, low))
        for_it = (self._walls_a * np.conj(walls_b)).sum(axis=0)
        against = self._free_a * np.conj(all_b) + self._all_a * np.conj(free_b)
        votes = fft.irfft2(for_it - AGAINST * against, self._shape)
        highest = ndimage.maximum_filter(votes, 2 * PEAK_APART_CELLS + 1, mode="wrap")
        rows, columns = np.nonzero((votes == highest) & (votes > 0))
        # Farther than a is wide, a shift is one the other way.
        first = self._low_a - low
        x = np.where(columns <= self._most[0], columns, columns - self._shape[1]) * self._cell_m + first[0]
        y = np.where(rows <= self._most[1], rows, rows - self._shape[0]) * self._cell_m + first[1]
        height = votes[rows, columns]
        if within is not None:
            there = within.away_m(x, y, yaw_rad) <= within.radius_m
            x, y, height = x[there], y[there], height[there]
        order = np.argsort(-height, kind="stable")[:PEAKS]
        return [(-float(height[k]), (float(x[k]), float(y[k]), yaw_rad)) for k in order]

    def _there(self, a: Walls) -> NDArray[np.float32]:
        """Whether a has walls in each cell, 0 to 1: a layer for each direction, with those that face the next ones."""
        below, _ = between_directions(a.normals_xy)
        layers = []
        for k in range(DIRECTIONS):
            alike = (below % DIRECTIONS == k) | ((below + 1) % DIRECTIONS == k)
            layers.append(spread(self._raster(a.points_xy, a.lengths_m * alike, self._low_a) / self._cell_m))
        return np.stack(layers)

    def _by_direction(self, points: Floats, normals: Floats, lengths: Floats, low: Floats) -> NDArray[np.float32]:
        """Metres of wall in each cell: a layer for each direction; a wall between two counts for both in part."""
        below, part = between_directions(normals)
        cells = np.floor((points - low) / self._cell_m).astype(np.int64)
        flat, size = cells[:, 1] * self._shape[1] + cells[:, 0], self._shape[0] * self._shape[1]
        where = np.concatenate([(below + k) % DIRECTIONS * size + flat for k in (0, 1)])
        counted = np.bincount(where, np.concatenate([lengths * (1 - part), lengths * part]), DIRECTIONS * size)
        return counted.reshape(DIRECTIONS, *self._shape).astype(np.float32)

    def _raster(self, points: Floats, weights: Floats, low: Floats) -> NDArray[np.float32]:
        cells = np.floor((points - low) / self._cell_m).astype(np.int64)
        flat = cells[:, 1] * self._shape[1] + cells[:, 0]
        counted = np.bincount(flat, weights, self._shape[0] * self._shape[1])
        return counted.reshape(self._shape).astype(np.float32)

    def _free(self, walls: Walls, yaw_rad: float, low: Floats) -> NDArray[np.float32]:
        """1 where that map has seen free space, well away from its border."""
        each = max(1, int(self._cell_m / (2 * CELL_M)))  # two along each axis of a cell are enough
        rows, columns = np.nonzero(walls.clearance_m[::each, ::each] > DEEP_M)
        centres = walls.corner_xy + (each * np.stack([columns, rows], axis=-1) + 0.5) * CELL_M
        share = (each * CELL_M / self._cell_m) ** 2
        raster = self._raster(rotated(yaw_rad, centres), np.full(len(centres), share), low)
        return np.minimum(raster, np.float32(1.0))

    def _transform(self, raster: NDArray[np.float32]) -> NDArray[np.complex64]:
        transformed: NDArray[np.complex64] = fft.rfft2(raster)
        return transformed


def between_directions(normals: Floats) -> tuple[NDArray[np.int64], Floats]:
    """(n,) the direction below that of each wall, and how much of the way to the next one it is."""
    place = np.arctan2(normals[:, 1], normals[:, 0]) / (2 * math.pi) * DIRECTIONS
    below = np.floor(place).astype(np.int64)
    return below, place - below


def spread(raster: NDArray[np.float32]) -> NDArray[np.float32]:
    """Into the next cells, where it counts half: walls that are a cell apart meet."""
    full = np.minimum(raster, np.float32(1.0))
    around: NDArray[np.float32] = ndimage.maximum_filter(full, 3)
    spread_out: NDArray[np.float32] = np.maximum(full, np.float32(0.5) * around)
    return spread_out


def corners(walls: Walls) -> Floats:
    """(4, 2) of the raster of states."""
    height, width = walls.states_yx.shape
    box = np.array([(0, 0), (width, 0), (0, height), (width, height)], np.float64)
    found: Floats = walls.corner_xy + CELL_M * box
    return found
