"""One epoch's maps from one update to the next."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetmap.model.errors import ConfigError
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.pose import Pose2
from fleetmap.vectorize import Vectorizer, rasterize, vectorize, verify


def world(seed=0, size=240):
    """Slanted and straight thick walls and pillars in a closed hall: signed distances in cells."""
    rng = np.random.default_rng(seed)
    yy, xx = np.mgrid[:size, :size] + 0.5
    distance = np.minimum.reduce([yy, xx, size - yy, size - xx]) - 8
    for k in range(10):
        angle, reach = (rng.uniform(0, np.pi), rng.uniform(15, 40)) if k % 2 else (0.0, 30.0)
        cy, cx = rng.uniform(30, size - 30, 2)
        u = (xx - cx) * np.cos(angle) + (yy - cy) * np.sin(angle)
        v = -(xx - cx) * np.sin(angle) + (yy - cy) * np.cos(angle)
        distance = np.minimum(distance, np.maximum(abs(u) - reach, abs(v) - 5))
        cy, cx = rng.uniform(30, size - 30, 2)
        distance = np.minimum(distance, np.hypot(yy - cy, xx - cx) - rng.uniform(4, 10))
    return distance


def observe(distance, noise, rng):
    """A grid as a lidar leaves it: free, a skin of occupied cells, unknown behind."""
    seen = distance + noise * rng.normal(size=distance.shape)
    cells = np.where(seen > 0, 0, 100)
    return OccupancyGrid(np.where(distance < -3, -1, cells).astype(np.int8), 0.05)


def rows(vector_map):
    return set(map(tuple, vector_map.edges.tolist()))


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.floats(0, 0.5))
def test_the_same_grid_twice_is_the_same_map(seed, share):
    rng = np.random.default_rng(seed)
    grid = observe(world(seed, 80), 0.4, rng)
    noise = rng.random(grid.cells_yx.shape) < share
    cells = np.where(noise, rng.choice([-1, 0, 100], noise.shape), grid.cells_yx)
    grid = OccupancyGrid(cells.astype(np.int8), 0.05)
    vectorizer = Vectorizer()
    first = vectorizer.update(grid)
    assert vectorizer.update(grid).digest == first.digest
    assert vectorize(grid).digest == first.digest


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.tuples(*[st.integers(0, 30)] * 4))
def test_a_grid_that_grows_by_whole_cells_changes_nothing(seed, margins):
    grid = observe(world(seed, 80), 0.3, np.random.default_rng(seed))
    vectorizer = Vectorizer()
    first = vectorizer.update(grid)
    bottom, top, left, right = margins
    cells = np.pad(grid.cells_yx, ((bottom, top), (left, right)), constant_values=-1)
    grown = OccupancyGrid(cells, 0.05, Pose2(-left * 0.05 + 1e-4, -bottom * 0.05 - 1e-4))
    assert vectorizer.update(grown).digest == first.digest


def test_a_turned_grid_keeps_its_lattice_when_it_grows():
    grid = observe(world(3, 80), 0.3, np.random.default_rng(3))
    turned = OccupancyGrid(grid.cells_yx, 0.05, Pose2(1.0, -2.0, 0.7))
    vectorizer = Vectorizer()
    first = vectorizer.update(turned)
    corner = turned.origin @ Pose2(-5 * 0.05, -3 * 0.05)
    cells = np.pad(grid.cells_yx, ((3, 0), (5, 0)), constant_values=-1)
    assert vectorizer.update(OccupancyGrid(cells, 0.05, corner)).digest == first.digest


def test_noise_moves_far_fewer_edges_than_a_fresh_run():
    distance, rng = world(), np.random.default_rng(5)
    vectorizer, sticky, fresh = Vectorizer(), [], []
    for _ in range(6):
        grid = observe(distance, 0.2, rng)
        sticky.append(rows(vectorizer.update(grid)))
        fresh.append(rows(vectorize(grid)))
    changed = [sum(len(b - a) for a, b in zip(maps, maps[1:], strict=False)) for maps in (sticky, fresh)]
    assert changed[1] > 50
    assert changed[0] * 3 < changed[1]
    # It isn't bought with more edges.
    assert len(sticky[-1]) <= 1.15 * len(fresh[-1])


def test_thickness_doesnt_flicker():
    distance, rng = world(), np.random.default_rng(5)
    vectorizer = Vectorizer()
    last, changes, kept = {}, 0, 0
    for _ in range(6):
        vector_map = vectorizer.update(observe(distance, 0.2, rng))
        now = {tuple(e): t for e, t in zip(vector_map.edges.tolist(), vector_map.thickness.tolist(), strict=True)}
        changes += sum(last[e] != now[e] for e in last.keys() & now.keys())
        kept += len(last.keys() & now.keys())
        last = now
    assert kept > 100
    assert changes * 10 < kept


def test_a_change_in_one_place_moves_no_edge_elsewhere():
    distance = world()
    grid = observe(distance, 0.3, np.random.default_rng(1))
    vectorizer = Vectorizer()
    before = vectorizer.update(grid)
    cells = grid.cells_yx.copy()
    cells[100:106, 100:106] = np.where(cells[100:106, 100:106] == 0, 100, 0)
    after = vectorizer.update(OccupancyGrid(cells, 0.05))
    touched = rows(before) ^ rows(after)
    assert touched
    longest = max(np.hypot(e[2] - e[0], e[3] - e[1]) for e in touched)
    for y0, x0, y1, x1, _ in touched:
        away = min(np.hypot(y - 103, x - 103) for y, x in ((y0, x0), (y1, x1)))
        assert away <= 10 + 2 * longest


def test_the_history_doesnt_cost_edges():
    distance, rng = world(), np.random.default_rng(2)
    vectorizer = Vectorizer()
    for _ in range(10):
        vector_map = vectorizer.update(observe(distance, 0.5, rng))
    grid = observe(distance, 0.0, rng)
    vector_map = vectorizer.update(grid)
    assert len(vector_map) <= 1.15 * len(vectorize(grid)) + 20


def test_a_map_without_edges_is_followed_by_any_other():
    nothing, room = np.full((20, 20), -1, np.int8), np.full((20, 20), 100, np.int8)
    room[2:-2, 2:-2] = 0
    vectorizer = Vectorizer()
    for cells in (nothing, room, nothing, room):
        grid = OccupancyGrid(cells, 0.05)
        assert vectorizer.update(grid).digest == vectorize(grid).digest


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.lists(st.tuples(*[st.integers(-8, 7)] * 2), min_size=1, max_size=3))
def test_the_verifier_finds_updates_valid_at_any_phase(seed, phases):
    rng = np.random.default_rng(seed)
    cells = observe(world(seed, 60), 0.4, rng).cells_yx
    vectorizer = Vectorizer()
    for y16, x16 in [(0, 0), *phases]:
        noisy = np.where(rng.random(cells.shape) < 0.03, rng.choice([-1, 0, 100], cells.shape), cells)
        grid = OccupancyGrid(noisy.astype(np.int8), 0.05, Pose2(x16 / 16 * 0.05, y16 / 16 * 0.05))
        assert verify(grid, vectorizer.update(grid)).violations == ()


def test_another_resolution_or_yaw_needs_a_new_epoch():
    cells = np.zeros((50, 50), np.int8)
    vectorizer = Vectorizer()
    first = vectorizer.update(OccupancyGrid(cells, 0.05))
    for other in (OccupancyGrid(cells, 0.1), OccupancyGrid(cells, 0.05, Pose2(0, 0, 0.1))):
        with pytest.raises(ConfigError, match="new epoch"):
            vectorizer.update(other)
    assert vectorizer.update(OccupancyGrid(cells, 0.05)).digest == first.digest


def test_a_phase_beyond_a_small_epsilon_needs_a_new_epoch():
    cells = np.zeros((50, 50), np.int8)
    vectorizer = Vectorizer(epsilon_cells=0.5)
    vectorizer.update(OccupancyGrid(cells, 0.05))
    with pytest.raises(ConfigError, match="new epoch"):
        vectorizer.update(OccupancyGrid(cells, 0.05, Pose2(0.025, 0.025)))


def test_without_the_compiler_the_maps_are_the_same():
    script = """
import numpy as np
from fleetmap.model.grid import OccupancyGrid
from fleetmap.vectorize import Vectorizer, rasterize
rng = np.random.default_rng(7)
cells = np.kron(rng.choice([-1, 0, 0, 100], (8, 8)), np.ones((4, 4), int))
vectorizer = Vectorizer(specks=3)
for _ in range(3):
    noise = rng.random(cells.shape) < 0.1
    grid = OccupancyGrid(np.where(noise, rng.choice([-1, 0, 100], cells.shape), cells).astype(np.int8), 0.05)
    vector_map = vectorizer.update(grid)
    print(vector_map.digest, rasterize(vector_map, like=grid).cells_yx.sum())
"""
    said = []
    for disabled in ("0", "1"):
        env = os.environ | {"NUMBA_DISABLE_JIT": disabled}
        run = subprocess.run([sys.executable, "-W", "error", "-c", script], env=env, capture_output=True, text=True)
        assert run.returncode == 0, run.stderr
        said.append(run.stdout)
    assert said[0] == said[1]


MAPS = sorted(Path(os.environ.get("FLEETMAP_DATA", "/nonexistent")).glob("maps/*/map.yaml"))


@pytest.mark.data
@pytest.mark.skipif(not MAPS, reason="FLEETMAP_DATA names no folder with maps")
@pytest.mark.parametrize("path", MAPS, ids=[p.parent.name for p in MAPS])
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_real_maps_come_back_faithfully(path):
    from fleetmap.model.map_server import load_map
    from fleetmap.model.metrics import compare

    grid = load_map(path)
    vectorizer = Vectorizer()
    vector_map = vectorizer.update(grid)
    assert vectorizer.update(grid).digest == vector_map.digest
    metrics = compare(grid, rasterize(vector_map, like=grid))
    assert min(metrics.OPDF, metrics.OPDF_reverse) >= 97
    assert min(metrics.UPDF, metrics.UPDF_reverse) >= 99.7
