"""Where one map lies in another: found, or refused with a reason, and never wrongly."""

import json
import math
import re

import numpy as np
import pytest
from align import WRONG_M, is_right, off_m
from buildings import KINDS, make_pair
from conftest import two_rooms

from fleetmap.align.align import align, align_walls, decide, hypotheses
from fleetmap.align.protocol import Prior
from fleetmap.align.walls import mirrored, walls_of
from fleetmap.model.errors import ConfigError
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import UNKNOWN
from fleetmap.model.map_server import save_map
from fleetmap.model.pose import Pose2
from fleetmap.vectorize import vectorize

SEEDS = range(1)


def answer(pair):
    return align(vectorize(pair.a), vectorize(pair.b))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", SEEDS)
def test_what_is_committed_is_true(kind, seed):
    pair = make_pair(kind, seed)
    found = answer(pair)
    assert found.outcome != "committed" or is_right(pair, found.T_a_b), (found.text, pair.T_a_b)
    if kind == "same":
        assert found.outcome == "committed", found.text
        assert off_m(found.T_a_b, pair.T_a_b, pair.shared_xy) < 0.1
    if kind in ("rooms", "corridor"):
        assert found.outcome == "ambiguous", found.text


def test_a_map_lies_in_itself_and_turned_where_it_was_turned_to():
    pair = make_pair("same", 0)
    own = walls_of(vectorize(pair.a))
    found = align_walls(own, own)
    assert found.outcome == "committed"
    assert math.hypot(found.T_a_b.x_m, found.T_a_b.y_m) < 0.005
    for yaw_rad in (0.4, math.pi / 2, -2.5):
        moved = Pose2(7.0, -3.0, yaw_rad)
        grid = OccupancyGrid(pair.a.cells_yx, pair.a.resolution_m, moved @ pair.a.origin)
        again = align(vectorize(pair.a), vectorize(grid))
        assert again.outcome == "committed"
        back = again.T_a_b @ moved
        assert (back.x_m, back.y_m, math.sin(back.yaw_rad)) == pytest.approx((0.0, 0.0, 0.0), abs=0.02)


def test_both_ways_are_each_others_inverse_and_the_same_each_time():
    pair = make_pair("same", 2)
    maps = vectorize(pair.a), vectorize(pair.b)
    there, back = align(*maps), align(*maps[::-1])
    around = there.T_a_b @ back.T_a_b
    assert (around.x_m, around.y_m, around.yaw_rad) == pytest.approx((0.0, 0.0, 0.0), abs=0.03)
    assert align(*maps) == there


def test_the_true_error_is_about_as_large_as_stated():
    pair = make_pair("same", 5)
    found = answer(pair)
    sigma_m = math.sqrt(max(np.linalg.eigvalsh(np.array(found.covariance)[:2, :2])))
    assert 0.0005 < sigma_m < 0.05
    assert off_m(found.T_a_b, pair.T_a_b, pair.shared_xy) < WRONG_M / 5


def test_a_wing_that_looks_the_same_in_a_mirror_is_not_told_from_its_mirror_image():
    """The hall that both have seen is its own mirror image."""
    pair = make_pair("mirrored", 20331)
    a, b = walls_of(vectorize(pair.a)), walls_of(vectorize(pair.b))
    assert decide(a, b, hypotheses(a, b)).outcome == "committed"
    found = align_walls(a, b)
    assert found.outcome == "ambiguous"
    assert re.fullmatch(r"its mirror image fits as well: 37\.\d m and 37\.\d m explained", found.text)
    assert not np.any(found.covariance)
    # Who knows about where it is isn't in the other wing.
    assert align_walls(a, b, Prior(found.T_a_b, 0.3, 0.05)).outcome == "committed"


def test_a_map_in_a_mirror_is_the_map_of_the_mirrored_grid():
    grid = make_pair("same", 1).a
    flipped = OccupancyGrid.from_states(
        grid.states_yx()[:, ::-1].copy(),
        grid.resolution_m,
        Pose2(-grid.origin.x_m - grid.width * grid.resolution_m, grid.origin.y_m),
    )
    one, other = mirrored(walls_of(vectorize(grid))), walls_of(vectorize(flipped))
    np.testing.assert_allclose(one.corner_xy, other.corner_xy, atol=0.1 + 1e-9)
    found = align_walls(one, other)
    assert found.outcome == "committed"
    assert math.hypot(found.T_a_b.x_m, found.T_a_b.y_m) < 0.01
    assert abs(found.T_a_b.yaw_rad) < 0.001
    np.testing.assert_array_equal(mirrored(one).points_xy, walls_of(vectorize(grid)).points_xy)


def test_a_map_that_would_take_all_memory_is_refused():
    states = np.zeros((300, 300), np.uint8)
    states[::299] = states[:, ::299] = 100
    yard = vectorize(OccupancyGrid(states, 3.0, Pose2()))
    with pytest.raises(ConfigError, match=r"894 m x 894 m in cells of 3 m.*expected at most 360000 m2"):
        align(yard, yard)


def test_maps_without_walls_are_too_small():
    nothing = OccupancyGrid.from_states(np.full((20, 20), UNKNOWN, np.uint8), 0.05)
    field = OccupancyGrid(np.zeros((20, 20), np.int8), 0.05)
    for other in (nothing, field):
        for pair in ((other, two_rooms()), (two_rooms(), other), (other, other)):
            found = align(*map(vectorize, pair))
            assert found.outcome == "too_small"
            assert found.text


def test_the_command_prints_the_transform_and_draws_it(fleetmap_command, tmp_path):
    pair = make_pair("same", 1)
    for name, grid in (("a", pair.a), ("b", pair.b)):
        save_map(grid, tmp_path / f"{name}.yaml")
    run = fleetmap_command("align", "a.yaml", "b.yaml", "--png", "both.png", "--json", cwd=tmp_path)
    assert run.code == 0, run.err
    document = run.document
    assert document["outcome"] == "committed"
    assert (document["x_m"], document["y_m"]) == pytest.approx((pair.T_a_b.x_m, pair.T_a_b.y_m), abs=0.1)
    assert (tmp_path / "both.png").stat().st_size > 1000
    said = fleetmap_command("align", "a.yaml", "b.yaml", cwd=tmp_path)
    assert "static_transform_publisher --x" in said.out
    save_map(two_rooms(), tmp_path / "small.yaml")
    refused = fleetmap_command("align", "a.yaml", "small.yaml", "--json", cwd=tmp_path)
    assert refused.code == 1
    assert json.loads(refused.out)["outcome"] in ("too_small", "conflict", "ambiguous")
    for arguments in (["a.yaml", "b.yaml", "--png", "both.jpg"], ["a.yaml"]):
        assert fleetmap_command("align", *arguments, cwd=tmp_path).code == 2
