"""The range sensor of the experiments, and the three ways in which its ranges are wrong."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fleetmap.sims.worlds import World

BEAMS = 540
"""Over 360 degrees: 0.67 degrees a beam, 14 cm from each other at full reach."""

REACH_M = 12.0
"""Returns beyond it are not used, and the beam counts as free up to here: Karto's default range threshold."""

SIGMA_M = 0.02
"""White noise of every range."""

MIXED, JUMP_M = 0.1, 0.3
"""Chance that a beam beside an edge (a jump to the next beam of at least ``JUMP_M``) ends between the two surfaces."""

POROUS, POROUS_SIZE_M, THROUGH, DEPTH_M = 0.08, 0.3, 0.25, 0.17
"""Share of the terrain whose surfaces are porous (plants, shelves, mesh, glass), in patches of about this size; the
chance that a beam enters such a surface, and the mean of how deep (exponential)."""


class Sensor:
    """A sensor in one terrain. All its randomness comes from ``rng``."""

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        self.world, self.rng = world, rng
        self.porous = self._porous_patches()
        self._angles = np.arange(BEAMS) * (2 * math.pi / BEAMS)

    def scan(self, x: float, y: float, yaw: float) -> NDArray[np.float64]:
        """(BEAMS,) ranges in metres from (x, y), in cells of the world; ``REACH_M`` where nothing returned."""
        from fleetmap.sims.lidar_kernels import cast

        rng, cell_m = self.rng, self.world.resolution_m
        distances = cast(self.world.solid, x, y, yaw, BEAMS, REACH_M / cell_m)
        exact_m = distances * cell_m
        ranges_m = exact_m + rng.normal(0.0, SIGMA_M, BEAMS)

        enters = self._is_porous(x, y, yaw, distances) & (rng.random(BEAMS) < THROUGH)
        ranges_m += np.where(enters, rng.exponential(DEPTH_M, BEAMS), 0.0)

        to_next = np.roll(exact_m, -1) - exact_m
        between = (np.abs(to_next) >= JUMP_M) & (rng.random(BEAMS) < MIXED)
        ranges_m = np.where(between, exact_m + to_next * rng.random(BEAMS), ranges_m)

        returned = (exact_m < REACH_M) | between
        return np.where(returned, np.clip(ranges_m, 0.01, REACH_M), REACH_M)

    def _porous_patches(self) -> NDArray[np.bool_]:
        from scipy import ndimage

        noise = self.rng.normal(size=self.world.solid.shape)
        smooth = ndimage.gaussian_filter(noise, POROUS_SIZE_M / self.world.resolution_m, truncate=3.0)
        patches: NDArray[np.bool_] = smooth > np.quantile(smooth, 1 - POROUS)
        return patches

    def _is_porous(self, x: float, y: float, yaw: float, distances: NDArray[np.float64]) -> NDArray[np.bool_]:
        """(BEAMS,) whether each beam ends in a porous patch."""
        height, width = self.porous.shape
        rows = np.clip(y + distances * np.sin(self._angles + yaw), 0, height - 1).astype(np.int64)
        columns = np.clip(x + distances * np.cos(self._angles + yaw), 0, width - 1).astype(np.int64)
        found: NDArray[np.bool_] = self.porous[rows, columns]
        return found
