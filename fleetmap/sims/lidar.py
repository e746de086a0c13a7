"""A lidar in a world: exact ranges by ray casting, then noise."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.pose import Pose2
from fleetmap.sims.worlds import World


@dataclass(frozen=True, slots=True)
class Lidar:
    """What a scan is made of.

    Parameters
    ----------
    range_m : returns beyond it are none
    beams : over 360 degrees, beam 0 straight ahead, counter-clockwise
    noise_m : sigma of the range error, white over beams and scans
    """

    range_m: float = 10.0
    beams: int = 720
    noise_m: float = 0.02

    @property
    def angles_rad(self) -> NDArray[np.float64]:
        """(beams,) directions in the robot's frame."""
        return np.arange(self.beams, dtype=np.float64) * (2 * math.pi / self.beams)

    def scan(self, world: World, pose: Pose2, *, rng: np.random.Generator) -> NDArray[np.float64]:
        """(beams,) ranges in metres seen from ``pose`` (world frame); exactly ``range_m`` where nothing returned."""
        from fleetmap.sims.lidar_kernels import cast

        x, y, yaw = world.to_cells(pose)
        reach = self.range_m / world.resolution_m
        exact = cast(world.solid, x, y, yaw, self.beams, reach) * world.resolution_m
        noisy = np.clip(exact + rng.normal(0.0, self.noise_m, self.beams), 0.01, np.nextafter(self.range_m, 0))
        ranges: NDArray[np.float64] = np.where(exact < self.range_m, noisy, self.range_m)
        return ranges


def scan_points(ranges_m: NDArray[np.float64], lidar: Lidar) -> NDArray[np.float64]:
    """(k, 2) metres in the robot's frame: where the beams that returned ended."""
    hit = ranges_m < lidar.range_m
    angles = lidar.angles_rad[hit]
    points: NDArray[np.float64] = ranges_m[hit, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    return points
