"""The verifier of drawn grids, against flood fills of closed rooms."""

from __future__ import annotations

import numpy as np
import pytest
from rooms import KINDS, is_shut, make_room, take_cells

from fleetmap.merge import fold
from fleetmap.merge.protocol import Source
from fleetmap.merge.verify import verify as verify_merged
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN
from fleetmap.model.pose import FixedPose
from fleetmap.vectorize import rasterize, vectorize, verify


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("profile", ["share", "full"])
def test_refused_is_a_drawn_grid_whose_wall_a_flood_gets_through_and_no_other(kind, profile):
    told = {True: 0, False: 0}
    for seed in range(8):
        rng = np.random.default_rng(seed)
        room = make_room(rng, kind, robots=1)
        vector_map = vectorize(room.grids[0], profile=profile)
        whole = rasterize(vector_map, like=room.grids[0])
        for block in (False, True) * 3:
            drawn = take_cells(whole, rng, block=block)
            opened = not is_shut(drawn, room.outline)
            report = verify(room.grids[0], vector_map, drawn=drawn)
            assert any(v.kind == "opened" for v in report.violations) == opened
            told[opened] += 1
    assert min(told.values()) > 5


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_for_merged_maps(kind):
    told = {True: 0, False: 0}
    for seed in range(6):
        rng = np.random.default_rng(100 + seed)
        room = make_room(rng, kind, robots=2)
        sources = room.sources()
        merged = fold(sources)
        whole = merged.to_grid()
        assert is_shut(whole, room.outline)
        assert verify_merged(sources, merged) == []
        for block in (False, True):
            drawn = take_cells(whole, rng, block=block)
            opened = not is_shut(drawn, room.outline)
            assert any(v.law == "drawn" for v in verify_merged(sources, merged, drawn=drawn)) == opened
            told[opened] += 1
    assert min(told.values()) > 1


@pytest.mark.parametrize("resolution_m", [0.0125, 0.033, 0.0375, 0.0525])
def test_sound_maps_are_sound_at_every_resolution(resolution_m):
    """Of the source, and of what is drawn."""
    room = make_room(np.random.default_rng(0), "slanting", robots=1)
    sources = room.sources()
    merged = fold(sources)
    assert verify_merged(sources, merged, drawn=merged.to_grid(resolution_m)) == []
    coarse = OccupancyGrid(room.grids[0].cells_yx, resolution_m)
    sources = [Source(("a", 1, "0"), FixedPose(), vectorize(coarse))]
    assert verify_merged(sources, fold(sources)) == []


def test_an_opening_is_told_where_it_is():
    states = np.full((40, 40), FREE, np.uint8)
    states[20] = OCCUPIED
    grid = OccupancyGrid.from_states(states, 0.05)
    vector_map = vectorize(grid)
    states = states.copy()
    states[20, 30] = UNKNOWN
    report = verify(grid, vector_map, drawn=OccupancyGrid.from_states(states, 0.05))
    assert {v.kind for v in report.violations} == {"opened"}
    for violation in report.violations:
        assert np.hypot(violation.place_xy_m[0] - 30.5 * 0.05, violation.place_xy_m[1] - 20.5 * 0.05) <= 0.05


def test_a_dent_in_a_wall_that_is_still_closed_is_no_opening():
    states = np.full((40, 40), FREE, np.uint8)
    states[20:22] = OCCUPIED
    grid = OccupancyGrid.from_states(states, 0.05)
    dented = states.copy()
    dented[20, 5:20] = UNKNOWN
    dented[21, 21:30] = FREE
    vector_map = vectorize(grid)
    assert verify(grid, vector_map, drawn=OccupancyGrid.from_states(dented, 0.05)).valid
    dented[21, 19] = FREE  # now one can go in on one side, along, and out on the other
    assert not verify(grid, vector_map, drawn=OccupancyGrid.from_states(dented, 0.05)).valid


def test_an_opening_behind_a_thousand_dents_is_found():
    states = np.full((12, 1300), FREE, np.uint8)
    states[5:7] = OCCUPIED
    grid = OccupancyGrid.from_states(states, 0.05)
    vector_map = vectorize(grid)
    dented = states.copy()
    dented[5, :1200] = FREE
    dented[6, 1200:] = FREE
    dented[5, 1250] = FREE
    report = verify(grid, vector_map, drawn=OccupancyGrid.from_states(dented, 0.05))
    assert {v.kind for v in report.violations} == {"opened"}
    assert all(abs(v.place_xy_m[0] - 1250.5 * 0.05) < 8 * 0.05 for v in report.violations)


def test_a_wall_may_lose_its_last_cell():
    """Around its end one gets anyway; only the vectors hold where exactly it ends."""
    states = np.full((40, 40), FREE, np.uint8)
    states[20, :20] = OCCUPIED
    grid = OccupancyGrid.from_states(states, 0.05)
    vector_map = vectorize(grid)
    shorter = states.copy()
    shorter[20, 19] = FREE
    assert verify(grid, vector_map, drawn=OccupancyGrid.from_states(shorter, 0.05)).valid
