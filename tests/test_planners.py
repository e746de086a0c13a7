"""Planners: paths keep the radius from every obstacle edge, exactly, and every failure has a type."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from fleetmap.model.errors import ConfigError, NoPath
from fleetmap.model.mergedmap import MergedMap
from fleetmap.planners import plan


def room(walls_m, size_m=8.0):
    """A square room of free space with obstacle edges; ``walls_m`` are two-sided walls (x0, y0, x1, y1)."""
    n = round(size_m * 200)
    square = [(0, 0, n, 0), (n, 0, n, n), (0, n, n, n), (0, 0, 0, n)]
    rows = []
    for x0, y0, x1, y1 in square:
        # Left and right, seen from the lower end (least y, then least x).
        left = 0 if (y0 == y1 == 0) or (x0 == x1 == n) else 2
        rows.append((y0, x0, y1, x1, left, 2 - left, 1, 10))
    for wall in walls_m:
        (y0, x0), (y1, x1) = sorted(
            [(round(wall[1] * 200), round(wall[0] * 200)), (round(wall[3] * 200), round(wall[2] * 200))]
        )
        rows.append((y0, x0, y1, x1, 0, 0, 1, 10))
    return MergedMap(np.array(sorted(rows), np.int32))


def least_distance(path, merged):
    walls = shapely.MultiLineString(list(merged.segments_xy[merged.obstacle]))
    return shapely.LineString(path.points_xy).distance(walls)


def test_an_empty_room_gives_the_straight_line():
    path = plan(room([]), (1.0, 1.0), (7.0, 5.0), radius_m=0.25)
    assert path.points_xy.tolist() == [[1.0, 1.0], [7.0, 5.0]]
    assert path.length_m == pytest.approx(math.hypot(6, 4))


def test_a_path_goes_around_a_wall_and_keeps_the_radius():
    merged = room([(4.0, 0.0, 4.0, 6.0)])
    path = plan(merged, (1.0, 1.0), (7.0, 1.0), radius_m=0.25)
    assert path.points_xy[0].tolist() == [1.0, 1.0]
    assert path.points_xy[-1].tolist() == [7.0, 1.0]
    assert least_distance(path, merged) >= 0.25 - 1e-9
    assert path.clearance_m == pytest.approx(least_distance(path, merged))
    shortest = 2 * math.hypot(3.0, 5.0 + 0.25)
    assert shortest * 0.99 < path.length_m < shortest * 1.03


@pytest.mark.parametrize(("door_m", "passes"), [(0.70, True), (0.60, True), (0.48, False)])
def test_a_door_is_passed_when_it_is_wide_enough(door_m, passes):
    merged = room([(4.0, 0.0, 4.0, 3.0), (4.0, 3.0 + door_m, 4.0, 8.0)])
    if passes:
        assert least_distance(plan(merged, (1.0, 1.0), (7.0, 1.0), radius_m=0.25), merged) >= 0.25 - 1e-9
    else:
        with pytest.raises(NoPath) as caught:
            plan(merged, (1.0, 1.0), (7.0, 1.0), radius_m=0.25)
        assert caught.value.status == "unreachable"


@pytest.mark.parametrize(
    ("start", "goal", "status"),
    [
        ((9.0, 1.0), (7.0, 1.0), "outside"),
        ((0.1, 1.0), (7.0, 1.0), "start_blocked"),
        ((1.0, 1.0), (3.9, 1.0), "goal_blocked"),
    ],
)
def test_every_failure_has_a_type(start, goal, status):
    with pytest.raises(NoPath) as caught:
        plan(room([(4.0, 0.0, 4.0, 6.0)]), start, goal, radius_m=0.25)
    assert caught.value.status == status


def test_an_empty_map_has_no_path():
    with pytest.raises(NoPath):
        plan(MergedMap(np.zeros((0, 8), np.int32)), (0, 0), (1, 1))


@pytest.mark.parametrize("bad", [{"radius_m": -1.0}, {"margin_m": math.nan}, {"method": "teleport"}])
def test_impossible_options_are_refused(bad):
    with pytest.raises(ConfigError):
        plan(room([]), (1.0, 1.0), (2.0, 2.0), **bad)


@given(st.lists(st.tuples(*[st.floats(0.5, 7.5)] * 4), max_size=6), st.floats(0.0, 0.5))
def test_no_path_ever_comes_nearer_than_the_radius(walls, radius_m):
    walls = [w for w in walls if abs(w[0] - w[2]) + abs(w[1] - w[3]) > 0.1]
    merged = room(walls)
    try:
        path = plan(merged, (0.7, 0.7), (7.3, 7.3), radius_m=radius_m)
    except NoPath as error:
        assert error.status in {"unreachable", "start_blocked", "goal_blocked"}
    else:
        assert least_distance(path, merged) >= radius_m - 1e-9
        if radius_m > 0:
            assert path.clearance_m >= radius_m - 1e-9
