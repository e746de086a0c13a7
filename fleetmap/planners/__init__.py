"""Paths on maps: ``plan()`` and the registry of planners behind it."""

from __future__ import annotations

import importlib
from typing import cast

from fleetmap.model.checks import check_number, check_type, check_xy
from fleetmap.model.errors import ConfigError
from fleetmap.model.mergedmap import MergedMap
from fleetmap.planners.protocol import Path, Planner

PLANNERS = {"astar": "fleetmap.planners.grid_astar:plan_astar"}
"""Name -> ``module:function``. A new planner is one new file and one line here."""


def find_planner(method: str) -> Planner:
    """The planner of that name; its module is imported now, not before."""
    if method not in PLANNERS:
        raise ConfigError(option="method", value=method, reason=f"expected one of {', '.join(PLANNERS)}")
    module, function = PLANNERS[method].split(":")
    return cast(Planner, getattr(importlib.import_module(module), function))


def plan(
    merged: MergedMap,
    start_xy: tuple[float, float],
    goal_xy: tuple[float, float],
    *,
    radius_m: float = 0.25,
    margin_m: float = 0.0,
    method: str = "astar",
) -> Path:
    """Shortest path that the planner ``method`` finds for a disc of ``radius_m`` through known free space.

    Parameters
    ----------
    merged : the map
    start_xy, goal_xy : metres in the component's frame
    radius_m : radius of the robot; the path keeps it from every obstacle edge, exactly
    margin_m : added to the radius, for whoever doesn't trust the map to its last centimetre

    Raises
    ------
    NoPath : with a ``status``; the goal is never moved silently
    ConfigError : a negative or infinite radius or margin, a point that is none, something else than a merged map, an
        unknown method
    """
    check_type("merged", merged, MergedMap)
    for option, value in (("radius_m", radius_m), ("margin_m", margin_m)):
        check_number(option, value, expected="metres, 0 or more", fits=lambda metres: metres >= 0)
    start_xy, goal_xy = check_xy("start_xy", start_xy), check_xy("goal_xy", goal_xy)
    return find_planner(method)(merged, start_xy, goal_xy, clearance_m=radius_m + margin_m)


__all__ = ["PLANNERS", "Path", "Planner", "find_planner", "plan"]
