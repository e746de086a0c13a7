"""Updates of a map: what a window may cost, and which edges may change."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetmap.model.delta import diff
from fleetmap.model.errors import ConfigError
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN
from fleetmap.model.pose import Pose2
from fleetmap.vectorize import PROFILES, Vectorizer, rasterize, vectorize, verify


def random_states(rng, height, width):
    """Blobs of the three states with some noise."""
    coarse = rng.choice(3, size=(height // 3 + 1, width // 3 + 1), p=[0.5, 0.25, 0.25])
    states = np.kron(coarse, np.ones((3, 3), int))[:height, :width]
    noise = rng.random(states.shape) < rng.choice([0, 0.1, 0.4])
    return np.where(noise, rng.integers(0, 3, states.shape), states).astype(np.uint8)


def change(rng, states):
    """Some cells in a window become something else; the window."""
    (row0, row1), (column0, column1) = (np.sort(rng.integers(0, n + 1, 2)).tolist() for n in states.shape)
    part = states[row0:row1, column0:column1]
    noise = rng.random(part.shape) < rng.choice([0.02, 0.1, 0.5])
    part[noise] = rng.integers(0, 3, int(noise.sum()))
    return row0, column0, row1, column1


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from(PROFILES))
def test_updates_within_a_window_are_valid_and_the_same_as_without_it(seed, profile):
    rng = np.random.default_rng(seed)
    states = random_states(rng, int(rng.integers(1, 40)), int(rng.integers(1, 40)))
    told, untold = Vectorizer(profile=profile), Vectorizer(profile=profile)
    for vectorizer in (told, untold):
        vectorizer.update(OccupancyGrid.from_states(states, 0.05))
    for _ in range(3):
        window = change(rng, states)
        grid = OccupancyGrid.from_states(states.copy(), 0.05)
        vector_map = told.update(grid, window)
        assert untold.update(grid).digest == vector_map.digest
        assert verify(grid, vector_map, specks=told.specks).violations == ()
        if profile == "exact":
            assert (rasterize(vector_map, like=grid).states_yx() == states).all()


def terrain(seed, size=600):
    """Rooms with ragged walls two cells thick, unknown behind; and crumbs."""
    rng = np.random.default_rng(seed)
    states = np.full((size, size), UNKNOWN, np.uint8)
    for _ in range(24):
        y, x = rng.integers(20, size - 140, 2)
        height, width = rng.integers(40, 120, 2)
        states[y : y + height, x : x + width] = FREE
    near = np.zeros(states.shape, bool)
    for dy in range(-2, 3):
        for dx in range(-2, 3):
            near |= np.roll(states == FREE, (dy, dx), (0, 1))
    states[near & (states == UNKNOWN)] = OCCUPIED
    noise = near & (rng.random(states.shape) < 0.03)
    states[noise] = rng.integers(0, 3, int(noise.sum()))
    return states


def exploration(states, steps=20, reach=80):
    """A disc that moves on uncovers the states; yields the grid, the window, and which cells have changed."""
    known = np.full_like(states, UNKNOWN)
    yy, xx = np.mgrid[: states.shape[0], : states.shape[1]]
    for k in range(steps):
        y, x = 300 + int(180 * np.sin(k / 4)), 300 + int(180 * np.cos(k / 4))
        before = known.copy()
        disc = (yy - y) ** 2 + (xx - x) ** 2 <= reach**2
        known[disc] = states[disc]
        window = (max(y - reach, 0), max(x - reach, 0), min(y + reach + 1, 600), min(x + reach + 1, 600))
        yield OccupancyGrid.from_states(known.copy(), 0.05), window, known != before


@pytest.mark.parametrize("profile", ["share", "full"])
def test_over_an_exploration_edges_that_nothing_touched_stay_but_for_those_given_up_for_fewer(profile):
    vectorizer, last = Vectorizer(profile=profile), None
    kept = 0
    for grid, window, changed in exploration(terrain(3)):
        vector_map = vectorizer.update(grid, window)
        if last is not None:
            places = np.argwhere(changed) + 0.5
            gone = diff(last, vector_map).removed.astype(float)
            a, b = gone[:, None, :2], gone[:, None, 2:4]
            t = np.clip(((places - a) * (b - a)).sum(axis=2) / ((b - a) ** 2).sum(axis=2), 0, 1)[:, :, None]
            distance = np.hypot(*np.moveaxis(places - a - t * (b - a), 2, 0)).min(axis=1, initial=np.inf)
            # Within epsilon of an edge lies its run of boundary, and half a cell on the cells beside that.
            assert (distance > 2**0.5 + 1).sum() <= vectorizer.redone
            kept += len(last) - len(gone)
        last = vector_map
    assert kept > 1000
    assert verify(grid, vector_map).violations == ()


@pytest.mark.parametrize("profile", ["share", "full"])
def test_over_an_exploration_stickiness_costs_few_edges(profile):
    vectorizer = Vectorizer(profile=profile)
    for grid, window, _ in exploration(terrain(4)):
        vector_map = vectorizer.update(grid, window)
    assert len(vector_map) <= 1.15 * len(vectorize(grid, profile=profile))


def test_an_update_shares_the_bands_that_it_does_not_touch():
    states = terrain(5)
    vectorizer = Vectorizer()
    before = vectorizer.update(OccupancyGrid.from_states(states, 0.05))
    changed = states.copy()
    changed[300:310, 300:310] = OCCUPIED
    after = vectorizer.update(OccupancyGrid.from_states(changed, 0.05), (300, 300, 310, 310))
    same = sum(any(a is b for b in before.bands.parts) for a in after.bands.parts)
    assert same >= len(after.bands.parts) - 3


@pytest.mark.parametrize("window", [(-1, 0, 2, 2), (0, 0, 6, 2), (3, 0, 2, 2)])
def test_a_window_that_is_none_is_refused(window):
    vectorizer = Vectorizer()
    with pytest.raises(ConfigError, match="changed_window"):
        vectorizer.update(OccupancyGrid(np.zeros((5, 5), np.int8), 0.05), window)


def test_the_profile_exact_takes_no_options():
    for options in ({"epsilon_cells": 1.0}, {"specks": 0}):
        with pytest.raises(ConfigError, match="exact"):
            Vectorizer(profile="exact", **options)
    with pytest.raises(ConfigError, match="share, full, exact"):
        Vectorizer(profile="other")


@pytest.mark.parametrize("epsilon_cells", [8.0, 64.0])
def test_a_large_epsilon_leaves_no_array(epsilon_cells):
    """Vertices may lie far outside of the grid; what is remembered of them must still be found, and be taken back."""
    rng = np.random.default_rng(6)
    states = random_states(rng, 120, 90)
    vectorizer = Vectorizer(profile="full", epsilon_cells=epsilon_cells, specks=0)
    vectorizer.update(OccupancyGrid.from_states(states, 0.05))
    for _ in range(4):
        window = change(rng, states)
        grid = OccupancyGrid.from_states(states.copy(), 0.05)
        vector_map = vectorizer.update(grid, window)
    assert verify(grid, vector_map, specks=0).violations == ()


def from_text(*rows):
    """States of rows from the top: free, occupied, unknown as . # ?"""
    return np.array([[".#?".index(c) for c in row] for row in reversed(rows)], np.uint8)


FOUND = {
    # The sliver of free space on the left ends at two nodes: it was turned over around the window.
    795072: (
        ("share", 12, (1, 9, 4, 15)),
        ("?....?....#....", "??.............", "???????????????", "?.............."),
        ("?....?...#.#..#", "??........#....", "?????????#.....", "?.............."),
    ),
    # Boundaries that touch at corners: a hole in free space was jumped over by the free space's own boundary.
    903396: (
        ("full", 0, (2, 1, 3, 2)),
        ("?????????.?", "??????.?.?.", "?????????..", "????????##.", "???????????"),
        ("?????????.?", "??????.?.?.", "?.???????..", "????????##.", "???????????"),
    ),
    # An edge is kept outside of the window between two nodes: what lies inside was turned over together with it.
    2015236: (
        ("share", 12, None),
        ("#......#?", ".#######.", "........#", "........."),
        ("#......#?", ".#######.", "........?", "........."),
    ),
}
"""Small grids at epsilon 3 that benchmarks/fuzz_vectorize.py found, by its seed."""


@pytest.mark.parametrize("seed", FOUND)
def test_what_touches_the_rim_of_a_window_is_not_turned_over(seed):
    (profile, specks, window), before, after = FOUND[seed]
    vectorizer = Vectorizer(profile=profile, epsilon_cells=3.0, specks=specks)
    vectorizer.update(OccupancyGrid.from_states(from_text(*before), 0.05))
    grid = OccupancyGrid.from_states(from_text(*after), 0.05)
    vector_map = vectorizer.update(grid, window)
    assert verify(grid, vector_map, specks=specks).violations == ()


@pytest.mark.parametrize("profile", ["share", "full"])
def test_a_grid_seen_again_at_moderate_phases_keeps_nearly_all_of_its_edges(profile):
    states = terrain(3)
    vectorizer = Vectorizer(profile=profile)
    last = vectorizer.update(OccupancyGrid.from_states(states, 0.05))
    rng = np.random.default_rng(0)
    changed = []
    for _ in range(20):
        x, y = rng.uniform(-0.35, 0.35, 2) * 0.05
        grid = OccupancyGrid.from_states(states, 0.05, Pose2(x, y))
        vector_map = vectorizer.update(grid)
        changed.append(len(diff(last, vector_map).removed) / len(last))
        last = vector_map
    assert verify(grid, last, specks=vectorizer.specks).violations == ()
    assert np.median(changed[1:]) <= 0.05


def test_a_grid_far_from_those_before_asks_for_a_new_epoch_and_changes_nothing():
    states = np.full((20, 20), OCCUPIED, np.uint8)
    states[2:-2, 2:-2] = FREE
    vectorizer = Vectorizer()
    first = vectorizer.update(OccupancyGrid.from_states(states, 0.05))
    with pytest.raises(ConfigError, match="start a new epoch"):
        vectorizer.update(OccupancyGrid.from_states(states, 0.05, Pose2(1000.0, 1000.0)))
    assert vectorizer.update(OccupancyGrid.from_states(states, 0.05)) is first
    moved = vectorizer.update(OccupancyGrid.from_states(states, 0.05, Pose2(1000.0, 0.0)))  # beside it: a strip
    assert diff(first, moved).added.shape == first.edges.shape
