"""Plans on the merged map for requests in the robot's own frame."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from fleetmap.model.mergedmap import MergedMap
from fleetmap.model.pose import Pose2

if TYPE_CHECKING:
    from fleetmap.planners.protocol import Path


def plan_in_frame(
    merged: MergedMap,
    start_xy: tuple[float, float],
    goal_xy: tuple[float, float],
    *,
    T_frame_fleet: Pose2,
    radius_m: float,
    margin_m: float,
) -> Path:
    """A path in the frame of the request, into which ``T_frame_fleet`` maps the merged map's."""
    from fleetmap.planners import plan

    (x0, y0), (x1, y1) = T_frame_fleet.inverse().apply([start_xy, goal_xy]).tolist()
    path = plan(merged, (x0, y0), (x1, y1), radius_m=radius_m, margin_m=margin_m)
    return replace(path, points_xy=T_frame_fleet.apply(path.points_xy))
