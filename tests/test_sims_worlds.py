"""Worlds: seeded, closed, and every free place of them within reach of a robot."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import ndimage

from fleetmap.model.errors import ConfigError
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.map_server import save_map
from fleetmap.model.pose import Pose2
from fleetmap.sims.worlds import GENERATORS, START_GAP_M, World, choose_starts, make_world

NAMES = sorted(GENERATORS)
RADIUS_M, MARGIN_M = 0.20, 0.10


@pytest.mark.parametrize("name", NAMES)
def test_the_same_seed_makes_the_same_world_and_another_one_another(name: str) -> None:
    world = make_world(name, size_m=15, seed=3)
    assert (world.solid == make_world(name, size_m=15, seed=3).solid).all()
    assert (world.solid != make_world(name, size_m=15, seed=4).solid).any()


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("size_m", [8.0, 17.3, 40.0])
def test_a_world_is_closed_and_has_the_size_asked_for(name: str, size_m: float) -> None:
    solid = make_world(name, size_m=size_m, seed=1).solid
    assert solid.shape == (round(size_m / 0.05),) * 2
    assert solid[[0, -1]].all()
    assert solid[:, [0, -1]].all()


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("seed", range(6))
def test_a_robot_with_its_margin_reaches_all_places_where_it_could_stand(name: str, seed: int) -> None:
    world = make_world(name, size_m=25, seed=seed)
    standable = world.standable(RADIUS_M + MARGIN_M)
    labels, found = ndimage.label(standable)
    sizes = np.bincount(labels.ravel())[1:]
    assert found >= 1
    # Next to a pillar of the maze or a boulder a few cells may be cut off.
    assert sizes.max() >= 0.999 * standable.sum()
    assert sizes.max() >= 0.5 * (~world.solid).sum()


def test_doors_of_an_office_are_at_least_90_cm_wide() -> None:
    world = make_world("office", size_m=30, seed=2)
    labels, _ = ndimage.label(world.standable(0.449))
    assert np.bincount(labels.ravel())[1:].max() >= 0.995 * (labels > 0).sum()


@pytest.mark.parametrize("name", NAMES)
def test_starts_are_apart_from_each_other_and_from_walls_but_together(name: str) -> None:
    world = make_world(name, size_m=20, seed=5)
    starts = choose_starts(world, 6, radius_m=RADIUS_M, rng=np.random.default_rng(7))
    assert starts == choose_starts(world, 6, radius_m=RADIUS_M, rng=np.random.default_rng(7))
    gaps = [math.dist((a.x_m, a.y_m), (b.x_m, b.y_m)) for i, a in enumerate(starts) for b in starts[:i]]
    assert min(gaps) >= START_GAP_M - 1e-9
    assert max(gaps) < 6.0
    reachable = world.reachable(starts[:1], radius_m=RADIUS_M)
    for start in starts:
        x, y, _ = world.to_cells(start)
        assert reachable[int(y), int(x)]


def test_standable_is_the_exact_distance_of_a_disc_to_the_nearest_solid_square() -> None:
    rng = np.random.default_rng(0)
    solid = rng.random((14, 17)) < 0.06
    world = World(solid, 0.05)
    padded = np.pad(solid, 1, constant_values=True)
    squares = np.argwhere(padded) - 1
    found = world.standable(0.12)
    for i in range(14):
        for j in range(17):
            away = np.maximum(np.maximum(squares - (i + 0.5, j + 0.5), (i + 0.5, j + 0.5) - squares - 1), 0)
            assert found[i, j] == (np.hypot(away[:, 0], away[:, 1]).min() * 0.05 >= 0.12 - 1e-12), (i, j)


def test_a_map_becomes_a_world_in_its_own_frame_with_unknown_cells_solid(tmp_path) -> None:
    states = np.full((40, 60), 0, np.uint8)
    states[10:20, 10] = 1
    states[30:] = 2
    states[0], states[:, [0, -1]] = 2, 2  # closed: nothing is free at the edge
    origin = Pose2(-3.0, 2.0, 0.5)
    save_map(OccupancyGrid.from_states(states, 0.1, origin), tmp_path / "map.yaml")
    world = make_world(str(tmp_path / "map.yaml"))
    assert world.resolution_m == 0.1
    assert (world.solid == (states != 0)).all()
    centre = world.centres_xy(np.array([[12, 34]]))[0]
    x, y, yaw = world.to_cells(Pose2(*centre, 0.75))
    assert (x, y, yaw) == pytest.approx((34.5, 12.5, 0.25))


@pytest.mark.parametrize(
    ("name", "size_m", "option"), [("castle", 20.0, "world"), ("maze", 1.0, "size"), ("office", math.nan, "size")]
)
def test_an_impossible_world_is_refused(name: str, size_m: float, option: str) -> None:
    with pytest.raises(ConfigError) as refused:
        make_world(name, size_m=size_m)
    assert refused.value.option == option


def test_a_world_without_room_for_the_fleet_is_refused() -> None:
    solid = np.ones((30, 30), bool)
    with pytest.raises(ConfigError, match="no room"):
        choose_starts(World(solid), 1, radius_m=RADIUS_M, rng=np.random.default_rng(0))
    solid[5:25, 5:25] = False
    with pytest.raises(ConfigError, match="room for"):
        choose_starts(World(solid), 9, radius_m=RADIUS_M, rng=np.random.default_rng(0))


def test_a_map_that_is_free_up_to_its_edge_gets_a_wall_and_keeps_its_place(tmp_path) -> None:
    import fleetmap
    from fleetmap.model.map_server import save_map

    origin = fleetmap.Pose2(1.0, 2.0, 0.5)
    save_map(fleetmap.OccupancyGrid(np.zeros((4, 6), np.int8), 0.1, origin), tmp_path / "map.yaml")
    world = make_world(str(tmp_path / "map.yaml"))
    assert world.solid.shape == (6, 8)
    assert not world.solid[1:-1, 1:-1].any()
    assert world.solid.sum() == 6 * 8 - 4 * 6
    assert world.to_cells(origin) == pytest.approx((1.0, 1.0, 0.0))
