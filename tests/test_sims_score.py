"""Scores on maps whose errors are known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fleetmap.model.mergedmap import MergedMap
from fleetmap.model.pose import Pose2
from fleetmap.sims.score import along, covered, map_error, visible_solid, wall_cracks
from fleetmap.sims.worlds import World

LOW, HIGH = 0.5, 5.5
START = Pose2(3.0, 3.0)


def world() -> World:
    solid = np.ones((120, 120), bool)
    solid[10:110, 10:110] = False
    return World(solid)


def room(shift_m: float = 0.0) -> MergedMap:
    """The same room as a merged map, moved along x."""
    step = 0.005
    low, high = round(LOW / step), round(HIGH / step)
    a, b = round((LOW + shift_m) / step), round((HIGH + shift_m) / step)
    rows = [
        [low, a, low, b, 0, 1, 1, 10],
        [low, a, high, a, 1, 0, 1, 10],
        [low, b, high, b, 0, 1, 1, 10],
        [high, a, high, b, 1, 0, 1, 10],
    ]
    return MergedMap(np.array(sorted(rows), np.int32))


def test_a_perfect_map_has_no_error_and_covers_everything() -> None:
    truth = world()
    reachable = truth.reachable([START], radius_m=0.2)
    error = map_error(room(), Pose2(), truth, reachable, range_m=10.0)
    assert (error.median, error.p95) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert covered(room(), Pose2(), truth, reachable) == 1.0


def test_a_moved_map_is_wrong_by_as_much_as_its_moved_walls_are_both_ways() -> None:
    truth = world()
    reachable = truth.reachable([START], radius_m=0.2)
    error = map_error(room(0.1), Pose2(), truth, reachable, range_m=10.0)
    assert error.truth_to_map_p95 == pytest.approx(0.1, abs=1e-6)
    assert error.map_to_truth_p95 == pytest.approx(0.1, abs=1e-6)
    assert error.p95 == pytest.approx(0.1, abs=1e-6)
    shifted = covered(room(1.0), Pose2(), truth, reachable)
    assert shifted == pytest.approx(1 - 0.8 / 4.6, abs=0.02)


def test_a_missing_wall_shows_in_one_direction_and_a_phantom_one_in_the_other() -> None:
    truth = world()
    reachable = truth.reachable([START], radius_m=0.2)
    whole = room()
    missing = map_error(MergedMap(whole.edges[:2]), Pose2(), truth, reachable, range_m=10.0)
    assert missing.truth_to_map_p95 > 1.0 > missing.map_to_truth_p95
    phantom = np.vstack([whole.edges, [[600, 300, 600, 900, 0, 0, 1, 10]]])
    extra = map_error(MergedMap(phantom), Pose2(), truth, reachable, range_m=10.0)
    assert extra.map_to_truth_p95 > 1.0 > extra.truth_to_map_p95


def test_an_empty_map_has_no_error_figure() -> None:
    truth = world()
    error = map_error(
        MergedMap(np.zeros((0, 8), np.int32)), Pose2(), truth, truth.reachable([START], radius_m=0.2), range_m=10.0
    )
    assert math.isnan(error.median)


def test_only_walls_that_a_robot_can_see_are_asked_for() -> None:
    solid = world().solid.copy()
    solid[2:5, 2:5] = False  # a closet that nobody can enter
    truth = World(solid)
    seen = visible_solid(truth, truth.reachable([START], radius_m=0.2), range_m=10.0)
    assert seen[9, 20]
    assert seen[60, 110]
    assert not seen[1:6, 1:6].any()
    assert not seen[8, 20]


def test_cracks_lie_between_free_and_solid_cells_in_the_frame_of_the_world() -> None:
    solid = np.zeros((3, 4), bool)
    solid[1, 2] = True
    truth = World(solid, 0.5, Pose2(10.0, 20.0))
    cracks = {tuple(map(tuple, c)) for c in wall_cracks(truth).tolist()}
    assert cracks == {
        ((11.0, 20.5), (11.5, 20.5)),
        ((11.0, 21.0), (11.5, 21.0)),
        ((11.0, 20.5), (11.0, 21.0)),
        ((11.5, 20.5), (11.5, 21.0)),
    }


def test_points_along_an_edge_are_even() -> None:
    points = along(np.array([[[0.0, 0.0], [0.1, 0.0]], [[0.0, 0.0], [0.0, 0.01]]]))
    assert points == pytest.approx(np.array([[0.0125, 0], [0.0375, 0], [0.0625, 0], [0.0875, 0], [0, 0.005]]))
