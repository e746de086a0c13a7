"""The laws on real maps, vectorized as robots do it: each in a frame of its own, with noise of its own."""

import math
import os
from pathlib import Path

import numpy as np
import pytest

from fleetmap.merge import Source, fold, verify
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import UNKNOWN
from fleetmap.model.map_server import load_map
from fleetmap.model.metrics import compare
from fleetmap.model.pose import FixedPose, Pose2
from fleetmap.vectorize import vectorize

DATA = os.environ.get("FLEETMAP_DATA")
pytestmark = [
    pytest.mark.data,
    pytest.mark.skipif(DATA is None, reason="FLEETMAP_DATA names no folder of real maps"),
]
NAMES = ["tuw_office_005", "gh25_ual_010", "duke_loop5_010"]


def noisy(states_yx, rng, share=0.03):
    """Boundary cells take the state of a neighbour now and then."""
    pad = np.pad(states_yx, 1, mode="edge")
    neighbours = np.stack([pad[:-2, 1:-1], pad[2:, 1:-1], pad[1:-1, :-2], pad[1:-1, 2:]])
    boundary = (neighbours != states_yx).any(axis=0)
    pick = np.take_along_axis(neighbours, rng.integers(0, 4, (1, *states_yx.shape)), 0)[0]
    return np.where(boundary & (rng.random(states_yx.shape) < share), pick, states_yx)


def seen_from(states_yx, resolution_m, T_fleet_robot):
    """What a robot's grid holds of a world grid that lies at the fleet's origin: resampled in its own frame."""
    height, width = states_yx.shape
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]]) * resolution_m
    corners = T_fleet_robot.inverse().apply(corners) / resolution_m
    low, high = np.floor(corners.min(axis=0)).astype(int), np.ceil(corners.max(axis=0)).astype(int)
    centres = np.stack(np.meshgrid(np.arange(low[0], high[0]) + 0.5, np.arange(low[1], high[1]) + 0.5), axis=-1)
    cells = np.floor(T_fleet_robot.apply(centres * resolution_m) / resolution_m).astype(int)
    x, y = cells[..., 0], cells[..., 1]
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    states = np.where(inside, states_yx[np.where(inside, y, 0), np.where(inside, x, 0)], UNKNOWN).astype(np.uint8)
    return OccupancyGrid.from_states(states, resolution_m, Pose2(*(low * resolution_m).tolist()))


@pytest.fixture(scope="module", params=NAMES)
def fleet(request):
    """(world, sources): three robots, each with a window of the map, noise, and a start pose that is a bit off."""
    world = load_map(Path(DATA) / "maps" / request.param / "map.yaml")
    states, rng = world.states_yx(), np.random.default_rng(7)
    known = np.argwhere(states != UNKNOWN)
    (y0, x0), (y1, x1) = known.min(axis=0), known.max(axis=0) + 1
    states = states[y0:y1, x0:x1]
    half = states.shape[1] // 2
    windows = [slice(None), slice(0, half + half // 2), slice(half // 2, None)]
    union, sources = OccupancyGrid.from_states(states, world.resolution_m), []
    for k, window in enumerate(windows):
        seen = np.full_like(states, UNKNOWN)
        seen[:, window] = states[:, window]
        pose = Pose2(3.0 * k, -2.0 * k, 1.1 * k)
        grid = seen_from(noisy(seen, rng), world.resolution_m, pose)
        off = Pose2(pose.x_m + 0.01 * k, pose.y_m - 0.01, pose.yaw_rad + math.radians(0.05))
        sources.append(Source((f"r{k}", 1, "0"), FixedPose.from_pose(off), vectorize(grid)))
    return union, sources


def test_real_maps_keep_the_laws(fleet):
    _, sources = fleet
    merged = fold(sources)
    assert verify(sources, merged) == []
    assert fold([*sources[::-1], sources[1]]).to_bytes() == merged.to_bytes()


def test_real_maps_merge_to_the_world_that_was_seen(fleet):
    world, sources = fleet
    merged = fold(sources)
    score = compare(world, merged.to_grid(world.resolution_m))
    assert min(score.OPDF, score.OPDF_reverse) >= 95
    assert min(score.UPDF, score.UPDF_reverse) >= 99

    # One wall for all sights of it: little more than one robot alone needs for the whole map.
    def length_m(m):
        return np.hypot(*(m.segments_xy[:, 1] - m.segments_xy[:, 0]).T)[m.obstacle].sum()

    assert length_m(merged) < 1.25 * length_m(fold(sources[:1]))
