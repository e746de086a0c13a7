"""Unstructured terrain: a cave-like outline with boulders, nothing straight and nothing aligned."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fleetmap.sims.worlds import CELL_M

BORDER_M = 1.0
ROUGHNESS_M = 1.6
"""Correlation length of the terrain's outline."""
BOULDERS_PER_M2 = 0.06
BOULDER_M = (0.2, 1.1)
PASSAGE_M = 0.45
"""Half of the narrowest passage that is left open: what is narrower becomes solid."""


def generate(size_m: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Threshold smooth noise, drop boulders, and fill what a robot could not get to."""
    from scipy import ndimage

    side = round(size_m / CELL_M)
    noise = ndimage.gaussian_filter(rng.normal(size=(side, side)), ROUGHNESS_M / CELL_M, mode="reflect")
    noise /= noise.std()
    # Towards the border the ground rises, so that the outline is closed by terrain, not by a straight wall.
    rows = np.arange(side)
    to_border_m = np.minimum(rows, side - 1 - rows) * CELL_M
    rise = np.clip(1 - np.minimum.outer(to_border_m, to_border_m) / BORDER_M, 0, 1)
    solid: NDArray[np.bool_] = noise + 4 * rise > 1.3
    for _ in range(int(BOULDERS_PER_M2 * size_m**2)):
        draw_boulder(solid, rng)
    solid[:2] = solid[-2:] = True
    solid[:, :2] = solid[:, -2:] = True

    wide = ndimage.distance_transform_edt(~solid) * CELL_M > PASSAGE_M
    labels, found = ndimage.label(wide)
    if found == 0:
        return solid
    largest = 1 + int(np.argmax(np.bincount(labels.ravel())[1:]))
    # All that is within half a passage of the largest space stays open, the rest is filled.
    filled: NDArray[np.bool_] = ndimage.distance_transform_edt(labels != largest) * CELL_M > PASSAGE_M
    return filled


def draw_boulder(solid: NDArray[np.bool_], rng: np.random.Generator) -> None:
    """A random convex-ish polygon, by its radius over the direction."""
    side = len(solid)
    radius = rng.uniform(*BOULDER_M) / CELL_M
    row, column = rng.uniform(0, side, 2)
    corners = int(rng.integers(5, 10))
    radii = radius * rng.uniform(0.6, 1.0, corners)
    low_i, high_i = max(math.floor(row - radius), 0), min(math.ceil(row + radius) + 1, side)
    low_j, high_j = max(math.floor(column - radius), 0), min(math.ceil(column + radius) + 1, side)
    dy = np.arange(low_i, high_i)[:, None] + 0.5 - row
    dx = np.arange(low_j, high_j)[None] + 0.5 - column
    turn = (np.arctan2(dy, dx) / (2 * math.pi) % 1.0) * corners
    before = turn.astype(int) % corners
    part = turn - np.floor(turn)
    outline = radii[before] * (1 - part) + radii[(before + 1) % corners] * part
    solid[low_i:high_i, low_j:high_j] |= np.hypot(dy, dx) < outline
