"""``OccupancyGrid``: what arrays mean, what is refused, thresholds, and the warnings about graded grids."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from conftest import two_rooms

import fleetmap
from fleetmap.codecs.fgrid import load_fgrid, save_fgrid
from fleetmap.model.errors import ConfigError, MapFormatError, MapWarning
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN, Lattice
from fleetmap.model.mergedmap import MergedMap
from fleetmap.model.pose import Pose2
from fleetmap.model.vectormap import VectorMap
from fleetmap.vectorize import Vectorizer, rasterize, verify
from fleetmap.vectorize.vectorizer import vectorize

CELLS = two_rooms().cells_yx
"""-1, 0 and 100."""
MASK = CELLS == 100
SIGNED = [f"{order}i{size}" for size in (1, 2, 4, 8) for order in "<>"]
UNSIGNED = [f"{order}u{size}" for size in (1, 2, 4, 8) for order in "<>"]
FLOATS = [f"{order}f{size}" for size in (2, 4, 8) for order in "<>"] + ["g"]


def cartographer(seed: int = 0, *, free: tuple[int, int] = (20, 51), occupied: tuple[int, int] = (55, 65)):
    """The two rooms as cartographer and rtabmap have them: free at 20 to 50, walls at 55 to 64."""
    rng = np.random.default_rng(seed)
    cells = np.where(CELLS == 0, rng.integers(*free, CELLS.shape), rng.integers(*occupied, CELLS.shape))
    return np.where(CELLS == -1, -1, cells).astype(np.int8)


# What arrays mean


@pytest.mark.parametrize("dtype", SIGNED + UNSIGNED)
def test_integers_of_every_type_give_one_map(dtype):
    cells = CELLS if dtype in SIGNED else np.where(CELLS < 0, 50, CELLS)
    expected = cells.astype(np.int8)
    array = cells.astype(dtype)
    assert (OccupancyGrid(array, 0.05).cells_yx == expected).all()
    assert vectorize(OccupancyGrid(array, 0.05)).digest == vectorize(OccupancyGrid(expected, 0.05)).digest


@pytest.mark.parametrize("dtype", FLOATS)
def test_floats_are_probabilities_and_nan_is_unknown(dtype):
    cells = np.select([CELLS == -1, CELLS == 0], [np.nan, 0.03], 0.97).astype(dtype)
    grid = OccupancyGrid(cells, 0.05)
    assert (grid.cells_yx == np.select([CELLS == -1, CELLS == 0], [-1, 3], 97)).all()
    assert vectorize(grid).digest == vectorize(OccupancyGrid(CELLS, 0.05)).digest


def test_every_per_cent_comes_back_from_its_probability():
    per_cents = np.arange(101).reshape(1, -1)
    for dtype in FLOATS:
        assert (OccupancyGrid((per_cents / 100).astype(dtype), 0.05).cells_yx == per_cents).all()
    assert (OccupancyGrid(np.full((3, 4), np.nan), 0.05).cells_yx == -1).all()


def test_bools_are_a_mask_of_obstacles():
    grid = OccupancyGrid(MASK, 0.05)
    assert (grid.states_yx() == np.where(MASK, OCCUPIED, FREE)).all()
    assert len(vectorize(grid)) > 0


@pytest.mark.parametrize(
    "turn",
    [
        np.asfortranarray,
        lambda cells: np.repeat(cells, 2, axis=1)[:, ::2],
        lambda cells: np.flip(np.flip(cells).copy()),
        lambda cells: cells.copy().view(np.matrix),
        lambda cells: np.frombuffer(cells.tobytes(), np.int8).reshape(cells.shape),  # as ROS messages are read
        lambda cells: cells.tolist(),
    ],
)
def test_how_an_array_lies_in_memory_does_not_matter(turn):
    for cells in (CELLS, MASK, np.where(CELLS < 0, np.nan, CELLS / 100)):
        turned = turn(cells) if cells.dtype == np.int8 else np.asfortranarray(cells)
        grid = OccupancyGrid(turned, 0.05)
        assert (grid.cells_yx == OccupancyGrid(cells, 0.05).cells_yx).all()
        vectorizer = Vectorizer()
        first = vectorizer.update(grid)
        assert vectorizer.update(grid).digest == first.digest == vectorize(OccupancyGrid(cells, 0.05)).digest


@pytest.mark.parametrize(
    ("cells", "hint"),
    [
        (CELLS.astype(np.float64), r"round\(\)\.astype\(np\.int8\)"),
        (np.where(CELLS == -1, -1.0, CELLS / 100), "NaN is unknown"),
        (np.array([[0.5, np.inf]]), "0.5 to inf"),
        (np.array([[0.5, 1.01]]), "0.5 to 1.01"),
        (CELLS.view(np.uint8), r"view\(np\.int8\)"),
        (np.array([[0, 101]]), "0 to 101"),
        (np.array([[-2, 0]]), "-2 to 0"),
        (np.array([[2**64 - 1, 0]], np.uint64), "18446744073709551615"),
        (np.array([[256 + 100, 0]]), "0 to 356"),
        (np.ma.masked_equal(CELLS, -1), r"filled\(-1\)"),
        (CELLS.astype(complex), "complex128"),
        (CELLS.astype(str), "<U"),
        (CELLS.astype(object), "object"),
        ([["0", "100"]], "found list"),
        ([[0, 100], [0]], "found list"),
        ([[0, None]], "found list"),
        (None, "found NoneType"),
        (two_rooms(), "found OccupancyGrid"),
        (CELLS[0], r"shape \(120,\)"),
        (CELLS[:0], r"shape \(0, 120\)"),
        (np.int8(0), r"shape \(\)"),
    ],
)
def test_other_arrays_are_refused_with_what_was_found_and_what_to_do(cells, hint):
    with pytest.raises(MapFormatError, match=hint) as caught:
        OccupancyGrid(cells, 0.05)
    assert caught.value.field == "cells_yx"


def test_any_array_of_numbers_is_kept_or_refused_and_never_changed():
    rng = np.random.default_rng(5)
    for _ in range(400):
        dtype = np.dtype(rng.choice(["i1", "i2", "i8", "u1", "u2", "u8"]))
        info = np.iinfo(dtype)
        low, high = max(info.min, -3), min(info.max, int(rng.choice([100, 110, 260, 2**40])))
        cells = rng.integers(low, high, (3, 4), dtype, endpoint=True)
        if cells.min() >= -1 and cells.max() <= 100:
            assert OccupancyGrid(cells, 0.05).cells_yx.tolist() == cells.tolist()
        else:
            with pytest.raises(MapFormatError):
                OccupancyGrid(cells, 0.05)


@pytest.mark.parametrize("resolution_m", ["0.05", True, 0, -1, np.nan, np.inf, None, 10**400, np.array([0.05]), 0.05j])
def test_a_resolution_is_a_finite_number_above_0(resolution_m):
    with pytest.raises(MapFormatError, match="resolution_m: expected"):
        OccupancyGrid(CELLS, resolution_m)


@pytest.mark.parametrize("origin", [(0, 0, 0), None, np.zeros(3), 0.0])
def test_an_origin_is_a_pose(origin):
    with pytest.raises(MapFormatError, match="origin: expected Pose2"):
        OccupancyGrid(CELLS, 0.05, origin)


@pytest.mark.parametrize("value", ["1", True, np.True_, np.nan, np.inf, None, (1,), np.zeros(1), 10**400])
def test_a_pose_takes_finite_numbers_only(value):
    for k in range(3):
        with pytest.raises(ConfigError, match="three finite numbers"):
            Pose2(*[value if i == k else 0.0 for i in range(3)])


def test_whole_and_single_numbers_become_floats_so_that_files_of_them_are_read_again(tmp_path):
    grid = OccupancyGrid(CELLS, np.int64(1), Pose2(1, np.float32(2), np.int8(0)))
    assert {type(v) for v in (grid.resolution_m, grid.origin.x_m, grid.origin.y_m, grid.origin.yaw_rad)} == {float}
    save_fgrid(grid, tmp_path / "map.fgrid")
    assert load_fgrid(tmp_path / "map.fgrid").origin == Pose2(1.0, 2.0, 0.0)


@pytest.mark.parametrize(
    "states",
    [
        MASK,
        CELLS,
        np.array([[3]]),
        np.array([[0.0]]),
        np.array([["0"]]),
        np.array([0]),
        np.ma.masked_equal(MASK * 1, 0),
    ],
)
def test_states_are_0_1_or_2(states):
    with pytest.raises(MapFormatError, match="states_yx"):
        OccupancyGrid.from_states(states, 0.05)


# A grid is what it was


def test_a_grid_does_not_change_when_the_array_does():
    for cells in (CELLS.copy(), MASK.copy(), np.where(CELLS < 0, np.nan, CELLS / 100), CELLS.astype(np.int64)):
        grid = OccupancyGrid(cells, 0.05)
        before = grid.cells_yx.copy()
        cells[:] = 0
        assert (grid.cells_yx == before).all()
        with pytest.raises(ValueError, match="read-only"):
            grid.cells_yx[0, 0] = 5


# Thresholds


def test_the_defaults_are_19_and_65():
    states = OccupancyGrid(np.arange(-1, 101).reshape(1, -1), 0.05).states_yx()[0]
    assert (states == [UNKNOWN] + [FREE] * 20 + [UNKNOWN] * 45 + [OCCUPIED] * 36).all()


@pytest.mark.parametrize(
    ("free_below", "occupied_above", "most_free", "least_occupied"),
    [
        (50, 54, 49, 55),
        (49.5, 49.5, 49, 50),
        (19.6, 65.0, 19, 66),
        (50, 50, 49, 51),
        (0.1, 99.9, 0, 100),
        (1, 99, 0, 100),
    ],
)
def test_below_one_threshold_is_free_and_above_the_other_occupied(
    free_below, occupied_above, most_free, least_occupied
):
    values = np.arange(-1, 101)
    expected = np.select(
        [values < 0, values <= most_free, values >= least_occupied], [UNKNOWN, FREE, OCCUPIED], UNKNOWN
    )
    grid = OccupancyGrid(values.reshape(1, -1), 0.05, free_below=free_below, occupied_above=occupied_above)
    assert (grid.states_yx()[0] == expected).all()
    other = OccupancyGrid(values.reshape(1, -1), 0.05)
    other = other.with_thresholds(free_below=free_below, occupied_above=occupied_above)
    assert (other.states_yx()[0] == expected).all()


@pytest.mark.parametrize(
    "thresholds",
    [
        (0, 50),
        (60, 50),
        (50, 100),
        (-1, 50),
        ("20", 50),
        (True, 50),
        (np.nan, 50),
        (20, np.inf),
        (20, None),
        (0.196, 0),
    ],
)
def test_thresholds_that_leave_no_order_are_refused(thresholds):
    with pytest.raises(ConfigError, match="0 < free_below <= occupied_above < 100"):
        OccupancyGrid(CELLS, 0.05, Pose2(), *thresholds)
    with pytest.raises(ConfigError):
        vectorize(OccupancyGrid(CELLS, 0.05), free_below=thresholds[0], occupied_above=thresholds[1] or 0)


def test_a_graded_map_gives_the_walls_of_its_thresholds_wherever_they_are_said():
    expected = vectorize(OccupancyGrid(CELLS, 0.05))
    said = {"free_below": 52, "occupied_above": 54}
    grid = OccupancyGrid(cartographer(), 0.05)
    assert vectorize(grid, **said).digest == expected.digest
    assert Vectorizer(**said).update(grid).digest == expected.digest
    own = OccupancyGrid(cartographer(), 0.05, **said)
    assert vectorize(own).digest == expected.digest
    assert verify(own, expected).valid
    assert not verify(grid, expected).valid
    assert fleetmap.compare(rasterize(expected, like=own), own).OPDF == 100


def test_updates_see_the_thresholds_of_each_grid():
    vectorizer = Vectorizer(free_below=52, occupied_above=54)
    digests = {vectorizer.update(OccupancyGrid(cartographer(seed), 0.05)).digest for seed in range(3)}
    assert digests == {vectorize(OccupancyGrid(CELLS, 0.05)).digest}

    # Other thresholds change cells outside of the window, too.
    cells = np.where(CELLS == 100, 64, CELLS)
    vectorizer = Vectorizer()
    with pytest.warns(MapWarning, match="0 as occupied"):
        without = vectorizer.update(OccupancyGrid(cells, 0.05))
    with_walls = vectorizer.update(OccupancyGrid(cells, 0.05, occupied_above=63.5), (0, 0, 1, 1))
    assert with_walls.digest == vectorize(OccupancyGrid(CELLS, 0.05)).digest != without.digest


# Warnings


@pytest.mark.parametrize(
    "cells",
    [
        cartographer(),
        cartographer(free=(40, 50), occupied=(60, 70)),  # hardly anything is free
        cartographer(free=(0, 15), occupied=(55, 65)),  # nothing is occupied
        np.where(np.arange(CELLS.size).reshape(CELLS.shape) == 4000, 70, cartographer()),  # all but one cell
        MASK.astype(np.uint8),  # a mask of 0 and 1: no wall at all
        np.where(CELLS == -1, np.nan, np.where(MASK, 0.6, 0.3)),
    ],
)
def test_a_graded_map_that_the_thresholds_empty_is_told(cells):
    with pytest.warns(MapWarning, match=r"known cells.*free_below"):
        vectorize(OccupancyGrid(cells, 0.05))
    with pytest.warns(MapWarning, match=r"known cells.*free_below"):
        fleetmap.compare(OccupancyGrid(cells, 0.05), OccupancyGrid(CELLS, 0.05))


@pytest.mark.parametrize(
    "cells",
    [
        CELLS,
        MASK,
        np.zeros_like(CELLS),
        np.full_like(CELLS, 100),
        np.full_like(CELLS, -1),
        np.where(CELLS == 100, -1, CELLS),  # a robot that has not seen a wall yet
        np.where(CELLS == 0, -1, CELLS),
        cartographer(free=(0, 22), occupied=(62, 101)),  # a map as it should be, some cells in doubt
        cartographer()[:9, :9],  # too few known cells to tell
    ],
)
def test_other_maps_are_not_warned_of(cells):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        vectorize(OccupancyGrid(cells, 0.05))


def test_real_maps_and_the_first_sights_of_them_are_not_warned_of(real_map):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MapWarning)  # one of them has a free_thresh of its own
        grid = fleetmap.load_map(real_map)
    known = np.argwhere(grid.cells_yx >= 0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        vectorize(grid)
        for y, x in known[:: len(known) // 20]:
            window = grid.cells_yx[max(0, y - 20) : y + 20, max(0, x - 20) : x + 20]
            vectorize(OccupancyGrid(window, grid.resolution_m))


def test_a_vectorizer_warns_once_and_as_soon_as_there_is_enough_to_tell():
    vectorizer = Vectorizer()
    few = cartographer()
    few[:, 12:] = -1
    few[12:] = -1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        vectorizer.update(OccupancyGrid(few, 0.05))
    with pytest.warns(MapWarning, match="free_below"):
        vectorizer.update(OccupancyGrid(cartographer(), 0.05))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        vectorizer.update(OccupancyGrid(cartographer(1), 0.05))


def test_what_holds_states_tells_how_many_values_it_does_not_keep(tmp_path):
    cells = np.where(CELLS == 0, 7, CELLS)
    grid = OccupancyGrid(cells, 0.05)
    told = rf"{(cells == 7).sum()} of {(cells >= 0).sum()} known cells have values between 0 and 100"
    with pytest.warns(MapWarning, match=told + "; an .fgrid"):
        save_fgrid(grid, tmp_path / "map.fgrid")
    assert (load_fgrid(tmp_path / "map.fgrid").states_yx() == grid.states_yx()).all()
    with pytest.warns(MapWarning, match=told + "; the profile exact"):
        drawn = rasterize(vectorize(grid, profile="exact"), like=grid)
    assert (drawn.states_yx() == grid.states_yx()).all()


# Nothing else is cast without a word


def test_vector_maps_and_merged_maps_take_whole_numbers_that_fit():
    lattice = Lattice(50_000)
    for edges in ([[2**64 - 5, 0, 3, 0, 1]], [[0.0, 0, 3, 0, 1]], [[2**40, 0, 2**40 + 1, 0, 1]]):
        array = np.array(edges, np.float64 if isinstance(edges[0][0], float) else np.uint64)
        with pytest.raises(MapFormatError):
            VectorMap(lattice, array, np.zeros(1, np.uint8))
    with pytest.raises(MapFormatError):
        VectorMap(lattice, np.array([[0, 0, 3, 0, 1]]), np.array([2**64 - 1], np.uint64))
    with pytest.raises(ConfigError, match="Lattice"):
        VectorMap(0.05, np.array([[0, 0, 3, 0, 1]]), np.zeros(1, np.uint8))
    for edges in ([[0.6, 0, 3.2, 0, 0, 1, 1, 0]], [[2**32, 0, 3, 0, 0, 1, 1, 0]], [[True] * 8]):
        with pytest.raises(MapFormatError, match="edges"):
            MergedMap(np.array(edges))


@pytest.mark.parametrize("resolution_m", [0, 0.0526, 0.001, 2000, -0.05, "0.05", True, np.nan])
def test_a_merged_map_is_drawn_in_the_cells_that_were_asked_for_or_not_at_all(resolution_m):
    with pytest.raises(MapFormatError, match=r"a whole multiple of 0\.0005 m"):
        MergedMap(np.zeros((0, 8), np.int32)).to_grid(resolution_m)
    for good in (0.005, 0.0125, 0.05, 0.0525, np.float32(0.05), 0.25, 1):
        assert MergedMap(np.zeros((0, 8), np.int32)).to_grid(good).resolution_m == pytest.approx(float(good))


MERGED = MergedMap(np.zeros((0, 8), np.int32))
ROOMS = OccupancyGrid(CELLS, 0.05)


@pytest.mark.parametrize(
    ("call", "expected"),
    [
        (lambda: fleetmap.compare(MERGED, ROOMS), r"OccupancyGrid; found MergedMap.*to_grid\(\)"),
        (lambda: fleetmap.compare(ROOMS, CELLS), "OccupancyGrid; found ndarray"),
        (lambda: fleetmap.save_map(MERGED, "map.yaml"), "OccupancyGrid; found MergedMap"),
        (lambda: fleetmap.rasterize(MERGED), r"VectorMap; found MergedMap.*to_grid\(\)"),
        (lambda: fleetmap.rasterize(vectorize(ROOMS), like=CELLS), "OccupancyGrid; found ndarray"),
        (lambda: vectorize(CELLS), r"OccupancyGrid; found ndarray.*OccupancyGrid\(cells_yx, resolution_m\)"),
        (lambda: verify(CELLS, vectorize(ROOMS)), "OccupancyGrid; found ndarray"),
        (lambda: verify(ROOMS, MERGED), "VectorMap; found MergedMap"),
        (lambda: Lattice(50_000.5), "whole micrometres"),
        (lambda: Lattice("50000"), "whole micrometres"),
        (lambda: vectorize(OccupancyGrid(CELLS, 1e305)), "0.1 mm to 10 m"),
        (lambda: vectorize(OccupancyGrid(CELLS, 0.05, Pose2(1e305, 0.0, 0.0))), "m from 0"),
        (lambda: vectorize(ROOMS, specks=1.5), "whole number"),
        (lambda: vectorize(ROOMS, specks=True), "whole number"),
        (lambda: vectorize(ROOMS, epsilon_cells="2"), "0.5 to 64.0 cells"),
        (lambda: vectorize(ROOMS, epsilon_cells=np.nan), "0.5 to 64.0 cells"),
        (lambda: vectorize(ROOMS, free_below="x"), "between 0 and 100"),
        (lambda: Vectorizer().update(ROOMS, (0, 0, 1)), "row0, column0"),
        (lambda: Vectorizer().update(ROOMS, (0, 0, 1.5, 1)), "row0, column0"),
        (lambda: Vectorizer().update(ROOMS, "0011"), "row0, column0"),
        (lambda: fleetmap.plan(ROOMS, (0, 0), (1, 1)), "MergedMap; found OccupancyGrid"),
        (lambda: fleetmap.plan(MERGED, (0, 0, 0), (1, 1)), "two finite numbers"),
        (lambda: fleetmap.plan(MERGED, "ab", (1, 1)), "two finite numbers"),
        (lambda: fleetmap.plan(MERGED, 1, (1, 1)), "two finite numbers"),
        (lambda: fleetmap.plan(MERGED, (0, 0), (1, np.nan)), "two finite numbers"),
        (lambda: fleetmap.plan(MERGED, (0, 0), (1, 1), radius_m="x"), "metres, 0 or more"),
        (lambda: fleetmap.plan(MERGED, (0, 0), (1, 1), margin_m=-1), "metres, 0 or more"),
    ],
)
def test_what_is_of_another_kind_is_refused_at_the_call(call, expected):
    with pytest.raises(ConfigError, match=expected) as caught:
        call()
    assert len(str(caught.value)) < 300
