"""How wrong the robot's believed poses are: a few centimetres, smooth, and bounded, as after loop closures.

Most of the error belongs to the place: a SLAM that comes back closes the loop onto the map that it already has, bent
as it is. A smaller part changes along the way, so that a wall seen twice isn't seen at quite the same place.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fleetmap.paper.tour import Tour

WAVES = 6
"""Sines that each part of the error is the mean of."""

PLACE_M, PLACE_RAD, PLACE_WAVES_M = 0.06, math.radians(0.3), (4.0, 20.0)
WAY_M, WAY_RAD, WAY_WAVES_M = 0.02, math.radians(0.15), (6.0, 45.0)
"""Bounds (each sine at its peak) of the error by place and along the way, and their wavelengths."""

MATCH_M, MATCH_RAD = 0.005, math.radians(0.1)
"""Sigma of what is left over from scan to scan: half of Karto's finest search step, about."""


def pose_errors(tour: Tour, resolution_m: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """(n, 3): metres in x and in y, radians, that the believed pose of each scan is off."""
    places_m = tour.places_xy * resolution_m
    errors = np.empty((len(places_m), 3))
    for k, (place, way, match) in enumerate(
        [(PLACE_M, WAY_M, MATCH_M), (PLACE_M, WAY_M, MATCH_M), (PLACE_RAD, WAY_RAD, MATCH_RAD)]
    ):
        errors[:, k] = (
            place * waves(along_directions(places_m, rng), PLACE_WAVES_M, rng)
            + way * waves(np.repeat(tour.travelled_m[:, None], WAVES, axis=1), WAY_WAVES_M, rng)
            + rng.normal(0.0, match, len(places_m))
        )
    return errors


def along_directions(places_m: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    """(n, WAVES) metres: how far each place lies in so many random directions."""
    angles = rng.uniform(0.0, 2 * math.pi, WAVES)
    far: NDArray[np.float64] = np.outer(places_m[:, 0], np.cos(angles)) + np.outer(places_m[:, 1], np.sin(angles))
    return far


def waves(
    phase_m: NDArray[np.float64], wavelengths_m: tuple[float, float], rng: np.random.Generator
) -> NDArray[np.float64]:
    """(n,) mean of the sines of the columns, within -1 to 1; wavelengths are drawn evenly in their logarithm."""
    count = phase_m.shape[1]
    lengths = np.exp(rng.uniform(math.log(wavelengths_m[0]), math.log(wavelengths_m[1]), count))
    starts = rng.uniform(0.0, 1.0, count)
    mean: NDArray[np.float64] = np.sin(2 * math.pi * (phase_m / lengths + starts)).mean(axis=1)
    return mean
