"""Vectorizing tile by tile: what holds for any grid, in tiles so small that most boundary crosses their borders."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN
from fleetmap.model.pose import Pose2
from fleetmap.model.vectormap import VectorMap
from fleetmap.vectorize import rasterize, verify
from fleetmap.vectorize.phase import lattice_of, place_on_lattice
from fleetmap.vectorize.tiles.mosaic import Known, Tiles, by_tile, directed
from fleetmap.vectorize.vectorizer import Vectorizer

spec = importlib.util.spec_from_file_location(
    "fuzz_vectorize", Path(__file__).parents[1] / "benchmarks" / "fuzz_vectorize.py"
)
fuzz = importlib.util.module_from_spec(spec)
sys.modules[spec.name] = fuzz
spec.loader.exec_module(fuzz)


class Mosaic:
    """A map that is vectorized in tiles."""

    def __init__(self, profile, size, lattice=None, edges=None, **options):
        self.options = Vectorizer(profile=profile, **options)
        self.tiles = Tiles(
            epsilon2=self.options.epsilon2, specks=self.options.specks, share=profile == "share", size=size
        )
        self.lattice = lattice
        if edges is not None:
            self.tiles.known = Known({}, edges)

    def update(self, grid):
        self.lattice = self.lattice or lattice_of(grid)
        known = self.tiles.update(grid, *place_on_lattice(grid, self.lattice))
        rows = np.concatenate([np.zeros((0, 6), np.int64), *known.edges.values()])
        epsilon_cells, profile = self.options.epsilon_cells, self.options.profile
        return VectorMap(self.lattice, rows[:, :5], rows[:, 5], epsilon_cells, profile)


def grid_at(states, y, x):
    """A grid on the lattice of a grid at the origin."""
    return OccupancyGrid.from_states(states, 0.05, Pose2(x * 0.05, y * 0.05))


def changed(rng, states):
    """The same with noise in a part."""
    part = np.zeros(states.shape, bool)
    (y0, y1), (x0, x1) = (np.sort(rng.integers(0, n + 1, 2)) for n in states.shape)
    part[y0:y1, x0:x1] = True
    part &= rng.random(states.shape) < rng.choice([0.02, 0.1, 0.5])
    return np.where(part, rng.integers(0, 3, states.shape), states).astype(np.uint8)


@pytest.mark.parametrize("profile", ["share", "full", "exact"])
@pytest.mark.parametrize("seed", range(40))
def test_maps_in_small_tiles_hold_all_promises_and_a_restart_goes_on_with_the_same_edges(seed, profile):
    rng = np.random.default_rng(seed)
    size = int(rng.choice([8, 16, 32]))
    y, x = rng.integers(-40, 40, 2)
    states = fuzz.random_states(rng)
    options = (
        {} if profile == "exact" else {"specks": int(rng.choice([0, 12])), "epsilon_cells": rng.choice([1, 2**0.5, 3])}
    )
    mosaic = Mosaic(profile, size, **options)
    mosaic.update(grid_at(np.full((1, 1), UNKNOWN, np.uint8), 0, 0))
    for _ in range(5 if seed % 4 == 0 else 1):
        grid = grid_at(states, y, x)
        found = mosaic.update(grid)
        assert verify(grid, found, specks=int(options.get("specks", 0))).violations == ()
        if profile == "exact":
            assert (rasterize(found, like=grid).states_yx() == states).all()
        edges = by_tile(directed(found.edges, found.thickness), size)
        again = Mosaic(profile, size, mosaic.lattice, edges, **options)
        assert again.update(grid).digest == found.digest
        states = changed(rng, states)


def test_a_grid_that_is_given_again_costs_no_edge():
    rng = np.random.default_rng(0)
    mosaic = Mosaic("share", 16)
    grid = grid_at(fuzz.random_states(rng), 0, 0)
    mosaic.update(grid)
    known = mosaic.tiles.known
    mosaic.update(grid)
    assert mosaic.tiles.known is known


def test_two_rooms_far_apart_cost_no_more_than_what_is_in_them():
    room = np.full((60, 60), OCCUPIED, np.uint8)
    room[2:-2, 2:-2] = FREE
    mosaic = Mosaic("share", 256)
    here, there = grid_at(room, 0, 0), grid_at(room, 400_000, 400_000)
    mosaic.update(here)
    found = mosaic.update(there)
    assert verify(there, found).valid
    assert len(mosaic.tiles.known.slots) <= 4
    assert len(mosaic.tiles._images.raw) <= 16


@pytest.mark.parametrize("step", ["find_changes", "read_tiles", "fill_tiles", "renew_tiles"])
def test_an_update_happens_wholly_or_not_at_all(monkeypatch, step):
    from fleetmap.vectorize.tiles import states_kernels, tile_kernels

    rng = np.random.default_rng(3)
    states = fuzz.random_states(rng)
    mosaic, twin = Mosaic("share", 16), Mosaic("share", 16)
    for each in (mosaic, twin):
        each.update(grid_at(states, 0, 0))
    known = mosaic.tiles.known
    room = tile_kernels if step == "renew_tiles" else states_kernels
    with monkeypatch.context() as patch:
        patch.setattr(room, step, lambda *_: (_ for _ in ()).throw(MemoryError))
        with pytest.raises(MemoryError):
            mosaic.update(grid_at(1 - states % 2, 0, 0))
    assert mosaic.tiles.known is known
    later = grid_at(changed(rng, states), 0, 0)
    assert mosaic.update(later).digest == twin.update(later).digest


def test_the_edges_of_a_hollow_obstacle_say_how_thick_its_walls_are():
    hollow = np.full((8, 12), UNKNOWN, np.uint8)
    hollow[1:7, 1:11] = OCCUPIED
    hollow[2:6, 2:10] = UNKNOWN
    grid = grid_at(hollow, 0, 0)
    found = Mosaic("share", 256, specks=0).update(grid)
    assert (rasterize(found, like=grid).states_yx() == hollow).all()


def test_a_wall_is_as_deep_as_each_part_of_it_is():
    solid = np.full((60, 60), OCCUPIED, np.uint8)
    solid[0:10, 20:40] = FREE
    grid = grid_at(solid, 0, 0)
    drawn = rasterize(Mosaic("share", 256).update(grid), like=grid).states_yx()
    assert (drawn[10:50, 20:40] == OCCUPIED).mean() > 0.95
