"""The paper's experiments: terrains and grids as wanted, the same bytes twice, properties against a slow twin."""

import hashlib
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from fleetmap.model.errors import ConfigError
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN
from fleetmap.paper import PaperConfig, choose_terrains, make_tables, run_experiment, run_paper
from fleetmap.paper.drift import MATCH_M, PLACE_M, WAY_M, pose_errors
from fleetmap.paper.properties import WANTED, measure_properties
from fleetmap.paper.survey import survey_terrain
from fleetmap.paper.tour import CLEARANCE_M, SCAN_EVERY_M, plan_tour

SMALL = choose_terrains((10,))
by_kind = pytest.mark.parametrize("terrain", SMALL, ids=lambda terrain: terrain.kind)


@pytest.fixture(scope="module")
def experiments():
    return {terrain.kind: run_experiment(terrain) for terrain in SMALL}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("paper") / "out"
    pytest.importorskip("matplotlib", reason="matplotlib is an extra")
    run_paper(PaperConfig(out=out, sizes_m=(10,)))
    return out


def test_there_are_nine_terrains_in_the_papers_sizes():
    terrains = choose_terrains()
    assert [(t.kind, t.size_m) for t in terrains] == [
        (kind, size) for size in (10, 40, 80) for kind in ("maze", "office", "unstructured")
    ]
    assert len({t.name for t in terrains}) == 9


FROZEN = {
    "maze 10 m": (4446, 84),
    "office 10 m": (6438, 97),
    "unstructured 10 m": (13795, 82),
    "maze 40 m": (49586, 2147),
    "office 40 m": (79581, 2461),
    "unstructured 40 m": (125390, 1797),
}
"""Solid cells and scans: whoever changes these makes other experiments, and has to say so beside every number."""


@pytest.mark.parametrize("terrain", choose_terrains((10, 40)), ids=lambda terrain: terrain.name)
def test_terrains_and_drives_stay_what_they_were(terrain):
    world = terrain.make()
    solid, scans = FROZEN[terrain.name]
    # Bending rounds floats, which differ in a last bit between machines.
    assert world.solid.sum() == pytest.approx(solid, rel=1e-3 if terrain.kind == "unstructured" else 0)
    assert len(plan_tour(world).places_xy) == pytest.approx(scans, rel=0.02 if terrain.kind == "unstructured" else 0)


@by_kind
def test_a_terrain_is_closed_and_all_of_it_is_one_space(terrain):
    solid = terrain.make().solid
    assert solid.shape == (200, 200)
    assert solid[[0, -1]].all()
    assert solid[:, [0, -1]].all()
    labels, _ = ndimage.label(~solid)
    assert np.bincount(labels.ravel())[1:].max() > 0.98 * (~solid).sum()


@pytest.mark.parametrize("terrain", choose_terrains((10, 40)), ids=lambda terrain: terrain.name)
def test_the_grid_is_as_ragged_as_a_slams(terrain):
    found = measure_properties(survey_terrain(terrain).grid)
    for name, (low, high) in WANTED.items():
        assert low <= getattr(found, name) <= high, name
    assert found.hold()


@by_kind
def test_the_robot_scans_at_even_distances_clear_of_walls_and_sees_nearly_all(experiments, terrain):
    world, survey = terrain.make(), experiments[terrain.kind].survey
    places = survey.tour.places_xy
    assert not world.solid[places[:, 1].astype(int), places[:, 0].astype(int)].any()
    walls = np.argwhere(world.solid)[:, ::-1] + 0.5
    away_m = [np.hypot(*(walls - place).T).min() * world.resolution_m for place in places]
    assert min(away_m) > CLEARANCE_M - 0.1  # between two steps of the way
    steps = np.hypot(*np.diff(places, axis=0).T) * world.resolution_m
    assert steps.max() <= SCAN_EVERY_M + 1e-9
    assert survey.seen > 0.95


@by_kind
def test_the_truth_is_the_world_where_it_was_in_sight(experiments, terrain):
    world, survey = terrain.make(), experiments[terrain.kind].survey
    truth = survey.truth.states_yx()
    assert not world.solid[truth == FREE].any()
    assert world.solid[truth == OCCUPIED].all()
    # No free cell touches a solid one that the truth doesn't have as a wall.
    beside_free = ndimage.binary_dilation(truth == FREE)
    assert (truth[beside_free & world.solid] == OCCUPIED).all()
    assert survey.truth.cells_yx.shape == survey.grid.cells_yx.shape == world.solid.shape


def test_believed_poses_are_off_by_a_few_centimetres_and_smoothly_so():
    tour = plan_tour(SMALL[1].make())
    errors = pose_errors(tour, 0.05, np.random.default_rng(0))
    assert errors.shape == (len(tour.places_xy), 3)
    assert np.abs(errors[:, :2]).max() < PLACE_M + WAY_M + 6 * MATCH_M
    assert np.abs(np.diff(errors[:, :2], axis=0)).max() < 0.05
    assert math.degrees(np.abs(errors[:, 2]).max()) < 1.1


def test_rows_hold_every_score_and_size_and_compare_as_they_say(experiments):
    for experiment in experiments.values():
        row = experiment.row
        for profile, found in row["scores"]["vector_from_grid"].items():
            for metric, gap in row["vector_minus_grid"][profile].items():
                assert gap == pytest.approx(found[metric] - row["scores"]["grid"][metric])
            sizes = row["sizes"]["vector_from_grid"][profile]
            assert sizes["plain"] == 16 * row["edges"]["vector_from_grid"][profile]
            assert sizes["fleetmap"] < sizes["plain_zip"] < sizes["plain"]
            truth = row["scores"]["vector_from_truth"][profile]
            assert min(truth[m] for m in ("MS", "OPDF", "UPDF", "OPDF_reverse", "UPDF_reverse")) > 97
        assert row["sizes"]["grid"]["pgm"] == len("P5\n200 200\n255\n") + 200 * 200
        assert row["scores"]["grid"]["MS"] > 85


def test_two_runs_give_the_same_bytes(folder, tmp_path):
    again = tmp_path / "again"
    run_paper(PaperConfig(out=again, sizes_m=(10,)))

    def digests(root):
        return {
            path.relative_to(root).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
            for path in sorted(root.rglob("*"))
            if path.is_file()
        }

    assert digests(again) == digests(folder)
    assert {"paper.json", "report.html", "sizes.png", "scores.png", "terrains/maze_10_m/grid.pgm"} <= set(
        digests(again)
    )


def test_an_interrupted_run_leaves_earlier_results_whole(folder, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "paper.json").write_text("earlier")

    def stop(what):
        if what == SMALL[-1].name:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_paper(PaperConfig(out=out, sizes_m=(10,)), on_progress=stop)
    assert [path.name for path in out.iterdir()] == ["paper.json"]


def test_tables_are_as_wide_as_their_heads_and_name_each_terrain(folder):
    document = json.loads((folder / "paper.json").read_text())
    tables = make_tables(document)
    assert all(len(row) == len(table.columns) for table in tables for row in table.rows)
    assert {row[0] for row in tables[0].rows} == {terrain.name for terrain in SMALL}


def slow_properties(states):
    """Cracks, corners per crack, thicknesses and specks of a small grid, cell by cell."""
    height, width = states.shape

    def at(i, j):
        return int(states[i, j]) if 0 <= i < height and 0 <= j < width else UNKNOWN

    cracks, ends, thick = 0, {}, []
    for i in range(-1, height + 1):
        for j in range(-1, width + 1):
            for di, dj in ((0, 1), (1, 0)):
                if at(i, j) == at(i + di, j + dj):
                    continue
                cracks += 1
                # Between (i, j) and (i, j + 1) it runs along y, between (i, j) and (i + 1, j) along x.
                corner = (i + 1, j + 1)
                other = (i, j + 1) if dj else (i + 1, j)
                for point in (corner, other):
                    ends.setdefault(point, []).append(dj)
    for i in range(height):
        for j in range(width):
            for di, dj in ((0, 1), (1, 0), (0, -1), (-1, 0)):
                k = 0
                while at(i, j) == FREE and at(i + (k + 1) * di, j + (k + 1) * dj) == OCCUPIED:
                    k += 1
                thick += [k] * (k > 0)
    turns = sum(len(found) == 2 and found[0] != found[1] for found in ends.values())
    return cracks, turns / cracks, sorted(thick)


@pytest.mark.parametrize("seed", range(5))
def test_properties_are_those_of_their_definitions(seed):
    states = np.random.default_rng(seed).choice(3, size=(13, 17), p=[0.5, 0.3, 0.2]).astype(np.uint8)
    found = measure_properties(OccupancyGrid.from_states(states, 0.05))
    cracks, corners, thick = slow_properties(states)
    assert (found.cracks, found.corners_per_crack) == (cracks, pytest.approx(corners))
    for share, value in ((0.1, found.skin_p10_cells), (0.5, found.skin_median_cells), (0.9, found.skin_p90_cells)):
        assert value == thick[math.ceil(share * len(thick)) - 1]


def test_a_drawing_is_told_from_a_slams_grid():
    states = np.full((100, 100), UNKNOWN, np.uint8)
    states[10:90, 10:90] = OCCUPIED
    states[12:88, 12:88] = FREE
    found = measure_properties(OccupancyGrid.from_states(states, 0.05))
    assert found.corners_per_crack < 0.05
    assert not found.hold()
    assert replace(found, corners_per_crack=0.3, free_specks_percent=0.1).hold()


@pytest.mark.parametrize("sizes_m", [(), (20,), (10, 11)])
def test_other_sizes_are_refused(tmp_path, sizes_m):
    with pytest.raises(ConfigError) as refused:
        PaperConfig(out=tmp_path / "out", sizes_m=sizes_m)
    assert refused.value.option == "sizes"
