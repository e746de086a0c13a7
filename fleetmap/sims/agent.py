"""One exploring robot: body, map and choices, in simulated time; it knows of the others only what they share."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from fleetmap.model.lattice import UNKNOWN
from fleetmap.model.mergedmap import MergedMap
from fleetmap.model.pose import Pose2
from fleetmap.sims.explore import Explorer, Teammate
from fleetmap.sims.robot import Robot
from fleetmap.sims.view import View, look

STEP_S = 0.1
PUBLISH_EVERY_M = 1.5
PUBLISH_EVERY_S = 5.0
"""A robot publishes after so much way, or so much time on the way, whichever comes first."""

RETHINK_S = 2.0
"""A robot without a goal looks for one this often: teammates' maps may have opened one."""

THINK_GAP_S = 0.5
"""Between two choices: a robot in a tight place would else think anew at each step."""

MOST_STOPS = 4
"""After so many stops on the way to one goal, the goal is given up for a while."""

AROUND_CELLS = 3
"""A goal is done when the robot's own map has no frontier within this distance of it."""


@dataclass
class Shared:
    """What comes from the fleet, as of the last time that someone looked."""

    merged: MergedMap | None = None
    teammates: list[Teammate] = field(default_factory=list)


class Agent:
    """Drives a ``Robot`` from frontier to frontier.

    Parameters
    ----------
    robot : the body with its map
    T_fleet_robot : of its map frame, as far as it is known; the identity until then
    explorer : makes the choices
    """

    def __init__(self, robot: Robot, *, T_fleet_robot: Pose2, explorer: Explorer) -> None:
        self.robot, self.T_fleet_robot, self.explorer = robot, T_fleet_robot, explorer
        self.shared = Shared()
        self.now_s = 0.0
        self.goal_xy: tuple[float, float] | None = None  # fleet frame
        self.view: View | None = None  # what the last choice was made on
        self.trail_xy: list[tuple[float, float]] = []  # where it really was at its scans
        self._stops = 0
        self._think_at_s, self._thought_s = 0.0, -math.inf
        self._published_m, self._on_the_way_s, self._ever_published = 0.0, 0.0, False

    @property
    def pose(self) -> Pose2:
        """Where the robot takes itself to be, in the fleet frame."""
        return self.T_fleet_robot @ self.robot.believed

    def find_itself(self, T_fleet_robot: Pose2) -> None:
        """Note where the own map frame lies in the fleet's; what is remembered of places moves with it."""
        moved = T_fleet_robot @ self.T_fleet_robot.inverse()
        if T_fleet_robot == self.T_fleet_robot:
            return
        self.T_fleet_robot = T_fleet_robot
        self.explorer.moved(moved)
        if self.goal_xy is not None:
            x, y = moved.apply(self.goal_xy)
            self.goal_xy = float(x), float(y)
        self._think_at_s = self.now_s

    @property
    def idle(self) -> bool:
        """Whether it has nowhere to go."""
        return self.goal_xy is None

    @property
    def publish_due(self) -> bool:
        """Whether it is time to publish the own map."""
        return (
            not self._ever_published
            or self.robot.distance_m - self._published_m >= PUBLISH_EVERY_M
            or self._on_the_way_s >= PUBLISH_EVERY_S
        )

    @property
    def unpublished(self) -> bool:
        """Whether it has moved since it last published."""
        return not self._ever_published or self._on_the_way_s > 0.0

    def published(self) -> None:
        """Note that the map, as it stands, has been published; the way is thought over with what came in."""
        self._published_m, self._on_the_way_s, self._ever_published = self.robot.distance_m, 0.0, True
        self._think_at_s = self.now_s

    def advance(self, until_s: float) -> None:
        """Live on until ``until_s`` of simulated time, or until it is time to publish or to tell a new goal."""
        while self.now_s < until_s - STEP_S / 2 and not self.publish_due:
            if self.now_s >= self._think_at_s:
                before = self.goal_xy
                self._think()
                if self.goal_xy != before:
                    return
            if self.idle:
                self.now_s = min(until_s, max(self._think_at_s, self.now_s + STEP_S))
                continue
            scanned = self.robot.step(STEP_S)
            self.now_s += STEP_S
            self._on_the_way_s += STEP_S
            if scanned:
                self.trail_xy.append((self.robot.pose.x_m, self.robot.pose.y_m))
            self._judge(scanned=scanned)

    def _think(self) -> None:
        """Choose a goal and the way there from all that is known now."""
        self._thought_s = self.now_s
        view = self.view = look(
            self.shared.merged,
            self.robot.mapper,
            T_fleet_robot=self.T_fleet_robot,
            radius_m=self.robot.drive.radius_m,
        )
        here = self.pose
        choice = self.explorer.choose(
            view,
            (here.x_m, here.y_m),
            teammates=self.shared.teammates,
            now_s=self.now_s,
            present_xy=self.goal_xy,
        )
        self._think_at_s = self.now_s + RETHINK_S if choice is None else math.inf
        if choice is None:
            self.goal_xy, self.robot.path_xy = None, np.zeros((0, 2))
            return
        if choice.frontier_xy != self.goal_xy and not self._near_goal(choice.frontier_xy):
            self._stops = 0
        self.goal_xy = choice.frontier_xy
        self.robot.path_xy = self.T_fleet_robot.inverse().apply(choice.path_xy)

    def _judge(self, *, scanned: bool) -> None:
        """After a step: think again if the goal is seen, or was reached in vain, or the way is barred."""
        assert self.goal_xy is not None
        if self._think_at_s < math.inf:
            return  # it will think anyway
        if self.robot.stopped:
            self._stops += 1
            self.robot.scan()
            if self._stops >= MOST_STOPS:
                self.explorer.failed(self.goal_xy, now_s=self.now_s)
                self._stops = 0
        elif not len(self.robot.path_xy):
            self.robot.scan()
            if not self._seen(self.goal_xy):
                self.explorer.failed(self.goal_xy, now_s=self.now_s)
        elif not scanned or (self.robot.path_is_clear() and not self._seen(self.goal_xy)):
            return
        self._think_at_s = max(self.now_s, self._thought_s + THINK_GAP_S)

    def _seen(self, xy: tuple[float, float]) -> bool:
        """Whether the own map has no frontier any more at a place in the fleet frame."""
        from fleetmap.sims.space_kernels import frontier_cells

        mapper = self.robot.mapper
        x, y = self.T_fleet_robot.inverse().apply(xy) / mapper.resolution_m
        row, column = math.floor(y) - mapper.low_yx[0], math.floor(x) - mapper.low_yx[1]
        height, width = mapper.states_yx.shape
        if not (AROUND_CELLS <= row < height - AROUND_CELLS and AROUND_CELLS <= column < width - AROUND_CELLS):
            return False
        around = mapper.states_yx[
            row - AROUND_CELLS : row + AROUND_CELLS + 1, column - AROUND_CELLS : column + AROUND_CELLS + 1
        ]
        known = around != UNKNOWN
        return bool(known.any()) and not len(frontier_cells(np.ascontiguousarray(around), 1))

    def _near_goal(self, xy: tuple[float, float]) -> bool:
        return self.goal_xy is not None and math.dist(self.goal_xy, xy) < 1.0
