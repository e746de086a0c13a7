"""The lidar against brute force, and the map against the truth."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import ndimage

from fleetmap.model.pose import Pose2
from fleetmap.sims.lidar import Lidar, scan_points
from fleetmap.sims.lidar_kernels import cast, touches
from fleetmap.sims.mapping import BLOCK, Mapper
from fleetmap.sims.worlds import World

EXACT = Lidar(noise_m=0.0)


def box(size: int = 120, wall: int = 3) -> World:
    solid = np.ones((size, size), bool)
    solid[wall:-wall, wall:-wall] = False
    return World(solid)


@pytest.mark.parametrize("seed", range(4))
def test_a_ray_ends_where_a_fine_walk_along_it_meets_the_first_solid_cell(seed: int) -> None:
    rng = np.random.default_rng(seed)
    solid = rng.random((30, 40)) < 0.08
    x, y, yaw = rng.uniform(5, 35), rng.uniform(5, 25), rng.uniform(-4, 4)
    solid[int(y), int(x)] = False
    found = cast(solid, x, y, yaw, 90, 18.0)
    along = np.arange(0, 18.0, 1e-3)
    for k in range(90):
        angle = yaw + 2 * math.pi * k / 90
        i, j = np.floor(y + along * math.sin(angle)).astype(int), np.floor(x + along * math.cos(angle)).astype(int)
        out = (i < 0) | (j < 0) | (i >= 30) | (j >= 40)
        hit = np.zeros(len(along), bool)
        hit[~out] = solid[i[~out], j[~out]]
        ends = np.flatnonzero(hit | out)
        expected = along[ends[0]] if len(ends) and hit[ends[0]] else 18.0
        assert found[k] == pytest.approx(expected, abs=2e-3), k


@pytest.mark.parametrize("seed", range(3))
def test_a_disc_touches_exactly_the_squares_nearer_than_its_radius(seed: int) -> None:
    rng = np.random.default_rng(seed)
    solid = rng.random((12, 12)) < 0.1
    squares = np.argwhere(np.pad(solid, 8, constant_values=True)) - 8
    for x, y in rng.uniform(0.5, 11.5, (200, 2)):
        radius = rng.uniform(0.3, 4.0)
        away = np.maximum(np.maximum(squares - (y, x), (y, x) - squares - 1), 0)
        assert touches(solid, x, y, radius) == (np.hypot(away[:, 0], away[:, 1]).min() < radius)


def test_noise_is_seeded_and_a_beam_without_return_stays_without() -> None:
    world = World(np.zeros((400, 400), bool))
    here = Pose2(10.0, 10.0)
    a = Lidar(range_m=5.0).scan(world, here, rng=np.random.default_rng(1))
    assert (a == 5.0).all()
    b = Lidar().scan(box(), Pose2(3, 3), rng=np.random.default_rng(1))
    assert (b == Lidar().scan(box(), Pose2(3, 3), rng=np.random.default_rng(1))).all()
    exact = EXACT.scan(box(), Pose2(3, 3), rng=np.random.default_rng(1))
    assert 0.015 < (b - exact).std() < 0.025


def test_scan_points_of_a_turned_robot_lie_on_the_walls() -> None:
    pose = Pose2(2.0, 3.5, 0.7)
    points = pose.apply(scan_points(EXACT.scan(box(), pose, rng=np.random.default_rng(0)), EXACT))
    to_wall = np.minimum(np.abs(points - 0.15), np.abs(points - 5.85)).min(axis=1)
    assert to_wall.max() < 1e-6


def mapped(world: World, start: Pose2, *, noise_m: float = 0.02, scans: int = 60) -> Mapper:
    rng = np.random.default_rng(2)
    lidar = Lidar(noise_m=noise_m)
    mapper = Mapper(lidar)
    for _ in range(scans):
        pose = Pose2(*rng.uniform(1.0, 5.0, 2), rng.uniform(-3, 3))
        believed = start.inverse() @ Pose2(pose.x_m + rng.normal(0, 0.01), pose.y_m + rng.normal(0, 0.01), pose.yaw_rad)
        mapper.add(lidar.scan(world, pose, rng=rng), believed)
    return mapper


@pytest.mark.parametrize("yaw_rad", [0.0, 0.3, 2.0])
def test_the_border_of_free_space_lies_on_the_true_walls_on_average_and_nowhere_far_off(yaw_rad: float) -> None:
    world, start = box(), Pose2(2.0, 2.0, yaw_rad)
    mapper = mapped(world, start)
    states, (low_y, low_x) = mapper.states_yx, mapper.low_yx
    free, wall = states == 0, states == 1
    points = []
    for turned in (False, True):
        a, b = (free.T, wall.T) if turned else (free, wall)
        rows, columns = np.nonzero((a[1:] & b[:-1]) | (b[1:] & a[:-1]))
        crack = np.column_stack([rows + 1.0, columns + 0.5])
        points.append(crack[:, ::-1] if turned else crack)
    xy = start.apply((np.concatenate(points) + np.array([low_y, low_x]))[:, ::-1] * 0.05)
    off = np.array([min(x - 0.15, y - 0.15, 5.85 - x, 5.85 - y) for x, y in xy])  # positive: inside the room
    assert abs(np.median(off)) < 0.015
    assert np.median(np.abs(off)) < 0.03
    assert np.percentile(np.abs(off), 95) < 0.06


def test_walls_are_thin_and_let_nothing_through() -> None:
    mapper = mapped(box(), Pose2(2.0, 2.0, 0.4))
    states = mapper.states_yx
    # Free space is sealed from the unknown by occupied cells ...
    assert not (ndimage.binary_dilation(states == 0) & (states == 2)).any()
    # ... of which there are about two in the depth of the wall.
    assert (states == 1).sum() * 0.05**2 / (4 * 5.7) < 2.5 * 0.05


def test_a_static_world_flickers_hardly_at_all() -> None:
    world, rng, lidar = box(), np.random.default_rng(0), Lidar()
    mapper = mapped(world, Pose2())
    before = mapper.states_yx.copy()
    for _ in range(5):
        mapper.add(lidar.scan(world, Pose2(3, 3), rng=rng), Pose2(3 + rng.normal(0, 0.01), 3 + rng.normal(0, 0.01)))
    changed = (mapper.states_yx != before).sum()
    assert changed <= 0.03 * (before == 1).sum()


def test_the_grid_grows_by_blocks_and_keeps_what_it_holds() -> None:
    world = World(np.zeros((2000, 2000), bool))
    lidar = Lidar(range_m=2.0, noise_m=0.0)
    mapper = Mapper(lidar)
    rng = np.random.default_rng(0)
    for _ in range(2):
        mapper.add(lidar.scan(world, Pose2(50, 50), rng=rng), Pose2(0, 0))
    first = mapper.grid()
    area = (mapper.states_yx == 0).sum()
    for _ in range(2):
        mapper.add(lidar.scan(world, Pose2(40, 45), rng=rng), Pose2(-10, -5))
    second = mapper.grid()
    assert second.height % BLOCK == 0
    assert second.width % BLOCK == 0
    row, column = (
        round((first.origin.y_m - second.origin.y_m) / 0.05),
        round((first.origin.x_m - second.origin.x_m) / 0.05),
    )
    kept = second.cells_yx[row : row + first.height, column : column + first.width]
    assert (kept == first.cells_yx).all()
    assert (mapper.states_yx == 0).sum() == 2 * area
    assert area * 0.0025 == pytest.approx(math.pi * 4, rel=0.02)
