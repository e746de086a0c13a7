"""Step 1: where the second map might lie. Rotations by direction histograms, then translations by votes of all walls.

Exhaustive and deterministic. The histograms are correlated over the whole circle (Carpin 2008 does so with Hough
spectra); of maps with few directions that leaves few rotations, of cluttered ones most. For each of them all
translations are voted on at once, by FFT, first in coarse cells, then for the best in finer ones: walls on walls that
face alike count for a translation, walls in the other's free space against it.
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
LIKE_ENOUGH = 0.55
"""Of the best likeness of two histograms: less is no rotation to try."""
APART_BINS = 6
"""Rotations that are tried are at least 3 degrees apart: 0.4 m at 8 m from the middle."""
COARSE_M, FINE_M = 0.4, 0.2
"""A cell of the votes."""
FINER = 12
"""So many rotations are voted on in fine cells."""
DIRECTIONS = 8
"""In which walls vote apart from each other."""
AGAINST = 1.0
"""How much a wall in the other's free space counts, beside one on a wall."""
DEEP_M = 0.3
"""Free space counts from so far behind its border on: walls are where they are but for so much."""
PEAKS = 6
PEAK_APART_CELLS = 3


@dataclass(frozen=True, slots=True)
class Candidate:
    """p_a = R(yaw) p_b + (x, y)."""

    x_m: float
    y_m: float
    yaw_rad: float
    votes_m: float


def candidates(a: Walls, b: Walls) -> list[Candidate]:
    """Places of b in a, the most voted first."""
    if not len(a.points_xy) or not len(b.points_xy):
        return []
    coarse = Votes(a, b, COARSE_M)
    tried = [(coarse.peaks(yaw_rad)[:1], yaw_rad) for yaw_rad in rotations(a, b)]
    best = sorted((-peaks[0].votes_m, yaw_rad) for peaks, yaw_rad in tried if peaks)[:FINER]
    fine = Votes(a, b, FINE_M)
    found = [candidate for _, yaw_rad in best for candidate in fine.peaks(yaw_rad)]
    return sorted(found, key=lambda c: (-c.votes_m, c.yaw_rad, c.x_m, c.y_m))


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


class Votes:
    """All translations of b at once, for one rotation after the other."""

    def __init__(self, a: Walls, b: Walls, cell_m: float) -> None:
        self._b, self._cell_m = b, cell_m
        reach = float(np.hypot(*np.ptp(np.vstack([b.points_xy, corners(b)]), axis=0)))
        self._low_a = np.minimum(a.points_xy.min(axis=0), a.corner_xy)
        high_a = np.maximum(a.points_xy.max(axis=0), a.corner_xy + CELL_M * np.array(a.states_yx.shape[::-1]))
        self._most = np.ceil((high_a - self._low_a) / self._cell_m).astype(int)
        extent = high_a - self._low_a + reach
        self._shape = tuple(fft.next_fast_len(int(n), real=True) for n in np.ceil(extent[::-1] / self._cell_m) + 2)
        # Whose walls are there counts once, however many points stand for them: votes are metres of b.
        self._walls_a = self._channels(a.points_xy, a.normals_xy, a.lengths_m, self._low_a, there=True)
        self._all_a = self._transform(self._raster(a.points_xy, a.lengths_m, self._low_a))
        self._free_a = self._transform(self._free(a, 0.0, self._low_a))

    def peaks(self, yaw_rad: float) -> list[Candidate]:
        """The translations with the most votes."""
        points, normals = rotated(yaw_rad, self._b.points_xy), rotated(yaw_rad, self._b.normals_xy)
        low = np.minimum(points.min(axis=0), rotated(yaw_rad, corners(self._b)).min(axis=0))
        walls_b = self._channels(points, normals, self._b.lengths_m, low)
        all_b = self._transform(self._raster(points, self._b.lengths_m, low))
        free_b = self._transform(self._free(self._b, yaw_rad, low))
        for_it = (self._walls_a * np.conj(walls_b)).sum(axis=0)
        against = self._free_a * np.conj(all_b) + self._all_a * np.conj(free_b)
        votes = fft.irfft2(for_it - AGAINST * against, self._shape)
        highest = ndimage.maximum_filter(votes, 2 * PEAK_APART_CELLS + 1, mode="wrap")
        rows, columns = np.nonzero((votes == highest) & (votes > 0))
        order = np.argsort(-votes[rows, columns], kind="stable")[:PEAKS]
        found = []
        for row, column in zip(rows[order], columns[order], strict=True):
            # Farther than a is wide, a shift is one the other way.
            most_x, most_y = self._most
            cells = (
                (int(column) if column <= most_x else column - self._shape[1]),
                (int(row) if row <= most_y else row - self._shape[0]),
            )
            x, y = self._low_a + np.array(cells) * self._cell_m - low
            found.append(Candidate(float(x), float(y), yaw_rad, float(votes[row, column])))
        return found

    def _channels(
        self, points: Floats, normals: Floats, lengths: Floats, low: Floats, *, there: bool = False
    ) -> NDArray[np.complex64]:
        """A transform for each direction: of what walls are there (0 to 1, the next ones' too), or of lengths."""
        place = np.arctan2(normals[:, 1], normals[:, 0]) / (2 * math.pi) * DIRECTIONS
        below = np.floor(place).astype(np.int64)
        part = place - below
        layers = []
        for k in range(DIRECTIONS):
            first, second = below % DIRECTIONS == k, (below + 1) % DIRECTIONS == k
            if there:
                layer = spread(self._raster(points, np.where(first | second, lengths, 0.0), low) / self._cell_m)
            else:
                layer = self._raster(points, lengths * np.where(first, 1 - part, np.where(second, part, 0.0)), low)
            layers.append(self._transform(layer))
        return np.stack(layers)

    def _raster(self, points: Floats, weights: Floats, low: Floats) -> NDArray[np.float32]:
        cells = np.floor((points - low) / self._cell_m).astype(np.int64)
        flat = cells[:, 1] * self._shape[1] + cells[:, 0]
        counted = np.bincount(flat, weights, self._shape[0] * self._shape[1])
        return counted.reshape(self._shape).astype(np.float32)

    def _free(self, walls: Walls, yaw_rad: float, low: Floats) -> NDArray[np.float32]:
        """1 where that map has seen free space, well away from its border."""
        rows, columns = np.nonzero(walls.clearance_m > DEEP_M)
        centres = walls.corner_xy + (np.stack([columns, rows], axis=-1) + 0.5) * CELL_M
        share = (CELL_M / self._cell_m) ** 2
        raster = self._raster(rotated(yaw_rad, centres), np.full(len(centres), share), low)
        return np.minimum(raster, np.float32(1.0))

    def _transform(self, raster: NDArray[np.float32]) -> NDArray[np.complex64]:
        transformed: NDArray[np.complex64] = fft.rfft2(raster)
        return transformed


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
