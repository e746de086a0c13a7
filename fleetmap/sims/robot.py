"""A differential-drive robot in a world: drives a path, stops before what it sees, scans, maps."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.pose import Pose2, wrap
from fleetmap.sims.lidar import Lidar, scan_points
from fleetmap.sims.mapping import Mapper
from fleetmap.sims.worlds import World

SCAN_EVERY_M = 0.25
SCAN_EVERY_RAD = math.radians(20)
FIRST_SCANS = 4
"""Taken before the first step, so that far cells, which need several votes, are decided."""
WAYPOINT_M = 0.06
"""A waypoint counts as passed within this distance: less than the margin that paths keep from walls."""
STOP_GAP_M = 0.03
"""The robot drives no nearer than its radius plus this to anything that its last scan shows ahead."""
SIDE_GAP_M = 0.015
"""What passes beside the disc with more room than this doesn't stop it."""
CLEAR_M = 0.015
LOOKED_AT = 3
"""A path is thought over when the scan shows something nearer than this to one of its next waypoints' legs."""
SMOOTHED_BEAMS = 9
"""Ranges for the stop are medians of so many beams: the least of 720 noisy ones would stop it in every door."""


@dataclass(frozen=True, slots=True)
class Drive:
    """What the body can do: disc radius, speeds, and how wrong the pose is that it believes.

    ``pose_noise_m`` is the sigma of x and of y, drawn anew at each scan (white: a SLAM that doesn't drift);
    the heading's is as much as moves a point at 10 m by the same distance.
    """

    radius_m: float = 0.20
    speed_mps: float = 0.6
    yaw_rate_radps: float = 1.5
    pose_noise_m: float = 0.01


@dataclass
class Robot:
    """The body, its map, and the path that it follows.

    Parameters
    ----------
    world, start : the truth, and where in it this robot begins (world frame); its map frame starts there
    lidar, drive : its make
    rng : draws the noise of scans and poses
    """

    world: World
    start: Pose2
    lidar: Lidar
    drive: Drive
    rng: np.random.Generator
    mapper: Mapper = field(init=False)
    pose: Pose2 = field(init=False)
    """Where it really is (world frame)."""
    distance_m: float = 0.0
    collisions: int = 0
    stopped: bool = False
    """Whether the last step was cut short: by what the scan shows ahead, or by a contact."""
    path_xy: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2)))
    """(n, 2) metres, own map frame: the waypoints that are left."""

    def __post_init__(self) -> None:
        self.mapper = Mapper(self.lidar)
        self.pose = self.start
        self._in_contact = False
        for _ in range(FIRST_SCANS):
            self.scan()

    @property
    def believed(self) -> Pose2:
        """Where it takes itself to be, in its own map frame."""
        return self.start.inverse() @ self.pose @ self._error

    def scan(self) -> None:
        """Take one scan into the map, and note what is near for the stop."""
        sigma = self.drive.pose_noise_m
        x, y, yaw = self.rng.normal(0.0, 1.0, 3) * (sigma, sigma, sigma / 10.0)
        self._error = Pose2(float(x), float(y), float(yaw))
        ranges_m = self.lidar.scan(self.world, self.pose, rng=self.rng)
        self.mapper.add(ranges_m, self.believed)
        around = np.pad(ranges_m, SMOOTHED_BEAMS // 2, mode="wrap")
        smooth = np.median(np.lib.stride_tricks.sliding_window_view(around, SMOOTHED_BEAMS), axis=1)
        points = scan_points(smooth, self.lidar)
        self._near_xy = points[np.hypot(points[:, 0], points[:, 1]) < 1.0]
        self._scanned_at = self.pose

    def step(self, dt_s: float) -> bool:
        """Drive for ``dt_s`` along the path; whether a scan was taken. ``stopped`` says if the way was barred."""
        speed, yaw_rate = self._command(dt_s)
        turned = wrap(self.pose.yaw_rad + yaw_rate * dt_s)
        middle = self.pose.yaw_rad + 0.5 * yaw_rate * dt_s
        moved = Pose2(
            self.pose.x_m + speed * dt_s * math.cos(middle), self.pose.y_m + speed * dt_s * math.sin(middle), turned
        )
        if self._touches(moved):
            # A contact: the body stays where it is, but may turn away.
            self.collisions += not self._in_contact
            self._in_contact = self.stopped = True
            moved = Pose2(self.pose.x_m, self.pose.y_m, turned)
        else:
            self._in_contact = False
            self.distance_m += speed * dt_s
        self.pose = moved
        travelled = math.hypot(moved.x_m - self._scanned_at.x_m, moved.y_m - self._scanned_at.y_m)
        if travelled < SCAN_EVERY_M and abs(wrap(moved.yaw_rad - self._scanned_at.yaw_rad)) < SCAN_EVERY_RAD:
            return False
        self.scan()
        return True

    def _command(self, dt_s: float) -> tuple[float, float]:
        """Speed and yaw rate towards the next waypoint: turn first, then drive, slower while the heading is off."""
        self.stopped = False
        here = self.believed
        while len(self.path_xy) and math.dist(self.path_xy[0], (here.x_m, here.y_m)) < WAYPOINT_M:
            self.path_xy = self.path_xy[1:]
        if not len(self.path_xy):
            return 0.0, 0.0
        dx, dy = self.path_xy[0] - (here.x_m, here.y_m)
        off = wrap(math.atan2(dy, dx) - here.yaw_rad)
        most = self.drive.yaw_rate_radps
        yaw_rate = max(-most, min(most, off / (2 * dt_s)))
        # Full speed when on course, none from 0.35 rad: corners are cut by less than the margin of the path.
        wanted = self.drive.speed_mps * max(0.0, 1.0 - abs(off) / 0.35)
        speed = min(wanted, math.hypot(dx, dy) / dt_s)
        if speed > 0.0 and self._barred(speed * dt_s):
            self.stopped = True
            return 0.0, yaw_rate
        return speed, yaw_rate

    def _barred(self, ahead_m: float) -> bool:
        """Whether the disc, moved ahead, would come too near to a point of the last scan that lies before it."""
        if not len(self._near_xy):
            return False
        # The motion since the scan is known from the wheels, without the error of the pose.
        points = (self.pose.inverse() @ self._scanned_at).apply(self._near_xy)
        gap = np.hypot(points[:, 0] - ahead_m, points[:, 1])
        radius = self.drive.radius_m
        return bool(
            ((gap < radius + STOP_GAP_M) & (points[:, 0] > 0.0) & (abs(points[:, 1]) < radius + SIDE_GAP_M)).any()
        )

    def path_is_clear(self) -> bool:
        """Whether the last scan leaves the next stretch of the path open: known earlier than at the stop."""
        if not len(self._near_xy) or not len(self.path_xy):
            return True
        here = self.believed
        ahead = here.inverse().apply(self.path_xy[:LOOKED_AT])
        points = (self.pose.inverse() @ self._scanned_at).apply(self._near_xy)
        start = np.zeros(2)
        for end in ahead:
            along = end - start
            t = np.clip((points - start) @ along / max(float(along @ along), 1e-12), 0.0, 1.0)
            gap = np.hypot(*(points - start - t[:, None] * along).T)
            # What is near already, as in a narrow door, is no news.
            news = np.hypot(points[:, 0], points[:, 1]) > self.drive.radius_m + CLEAR_M
            if ((gap < self.drive.radius_m + CLEAR_M) & news).any():
                return False
            start = end
        return True

    def _touches(self, pose: Pose2) -> bool:
        from fleetmap.sims.lidar_kernels import touches

        x, y, _ = self.world.to_cells(pose)
        return bool(touches(self.world.solid, x, y, self.drive.radius_m / self.world.resolution_m))
