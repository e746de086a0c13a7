"""The verifier on all three profiles: maps of the boundary as it is are valid, and no defect goes unseen."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from fleetmap.model.errors import ConfigError
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN, Lattice
from fleetmap.model.pose import FixedPose, Pose2
from fleetmap.model.vectormap import VectorMap, make_label
from fleetmap.vectorize.verify import verify

SCRIPT = Path(__file__).parent.parent / "benchmarks" / "vectorize_oracles.py"
SPEC = importlib.util.spec_from_file_location("vectorize_oracles", SCRIPT)
oracles = importlib.util.module_from_spec(SPEC)
sys.modules["vectorize_oracles"] = oracles  # dataclasses look their module up
SPEC.loader.exec_module(oracles)

PROFILES = ("share", "full", "exact")
EPSILON = {"share": 2**0.5, "full": 2**0.5, "exact": 63**0.5 / 16}
LATTICE = Lattice(50_000)


def grid(states):
    return OccupancyGrid.from_states(np.asarray(states, np.uint8), 0.05)


def drawn(states, profile):
    return oracles.corner_map(np.asarray(states, np.uint8), LATTICE, profile, EPSILON[profile])


def with_edges(vector_map, edges):
    rows = np.array(edges, np.int32).reshape(-1, 5)
    thickness = np.zeros(len(rows), np.uint8)
    return VectorMap(vector_map.lattice, rows, thickness, vector_map.epsilon_cells, vector_map.profile)


def kinds(states, vector_map, **options):
    return {violation.kind for violation in verify(grid(states), vector_map, **options).violations}


def random_states(seed, least=3, most=14):
    rng = np.random.default_rng(seed)
    height, width = rng.integers(least, most + 1, 2)
    k = rng.integers(1, 5)
    blobs = rng.choice(3, size=(height // k + 1, width // k + 1), p=rng.dirichlet([1, 1, 1]))
    states = np.kron(blobs, np.ones((k, k), int))[:height, :width]
    noise = rng.random(states.shape) < rng.choice([0, 0.1, 0.4])
    return np.where(noise, rng.integers(0, 3, states.shape), states).astype(np.uint8)


def building():
    """Two rooms with a door, walls of 5 cells, a pillar, something unseen in a room, and an obstacle out of sight."""
    states = np.full((50, 80), UNKNOWN, np.uint8)
    states[5:45, 5:65] = OCCUPIED
    states[10:40, 10:32] = FREE
    states[10:40, 37:60] = FREE
    states[20:30, 32:37] = FREE
    states[15:22, 15:23] = OCCUPIED
    states[25:33, 45:53] = UNKNOWN
    states[20:28, 70:77] = OCCUPIED
    return states


BUILDING = building()


@pytest.mark.parametrize("profile", PROFILES)
def test_a_building_drawn_along_its_boundary_is_valid(profile):
    report = verify(grid(BUILDING), drawn(BUILDING, profile))
    assert report.valid
    assert report.dropped.count == 0


# --- changes of a valid map


@pytest.mark.parametrize("profile", PROFILES)
def test_every_missing_edge_is_found(profile):
    whole = drawn(BUILDING, profile)
    rows = whole.edges.tolist()
    for k in range(len(rows)):
        found = kinds(BUILDING, with_edges(whole, rows[:k] + rows[k + 1 :]))
        assert "sides" in found
        # Of what is out of sight ``share`` promises no more than that something is there.
        assert ("uncovered" in found) == (profile != "share" or rows[k][4] in (1, 2, 3, 6))


@pytest.mark.parametrize("profile", PROFILES)
def test_every_other_label_is_found(profile):
    whole = drawn(BUILDING, profile)
    rows = whole.edges.tolist()
    for k, (*ends, label) in enumerate(rows):
        for other in range(9):
            if other % 3 != other // 3 and other != label:
                changed = with_edges(whole, [*rows[:k], [*ends, other], *rows[k + 1 :]])
                found = kinds(BUILDING, changed)
                assert found & {"sides", "uncovered"}
                assert ("astray" in found) == ({other // 3, other % 3} != {label // 3, label % 3})


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("cells", [2, 3])
def test_every_vertex_that_has_moved_too_far_is_found(profile, cells):
    whole = drawn(BUILDING, profile)
    rows = whole.edges.tolist()
    for y, x in np.unique(whole.edges[:, :4].reshape(-1, 2), axis=0).tolist():
        for dy, dx in ((0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)):

            def move(py, px, at=(y, x), by=(cells * dy, cells * dx)):
                return [py + by[0], px + by[1]] if (py, px) == at else [py, px]

            changed = [[*move(*row[:2]), *move(*row[2:4]), row[4]] for row in rows]
            assert kinds(BUILDING, with_edges(whole, changed)) & {"uncovered", "astray"}


def test_a_vertex_that_has_moved_by_one_cell_is_found_in_exact_alone():
    for profile in PROFILES:
        whole = drawn(BUILDING, profile)
        rows = [
            [16 if v == 15 and k % 2 == 0 else v for k, v in enumerate(row[:4])] + row[4:]
            for row in whole.edges.tolist()
        ]
        found = kinds(BUILDING, with_edges(whole, rows))
        assert (found >= {"uncovered", "astray", "identity"}) if profile == "exact" else not found


@pytest.mark.parametrize("profile", PROFILES)
def test_edges_that_leave_their_vertices_are_found(profile):
    """An edge is put beside itself: it still covers all, and is near all."""
    whole = drawn(BUILDING, profile)
    rows = whole.edges.tolist()
    for k, (y0, x0, y1, x1, label) in enumerate(rows):
        dy, dx = (1, 0) if y0 == y1 else (0, 1)
        moved = [y0 + dy, x0 + dx, y1 + dy, x1 + dx, label]
        assert kinds(BUILDING, with_edges(whole, [*rows[:k], moved, *rows[k + 1 :]])) & {"crossing", "sides"}


@given(st.integers(0, 10**6), st.sampled_from(PROFILES), st.data())
def test_among_noise_a_missing_edge_or_another_label_is_found_as_well(seed, profile, data):
    states = random_states(seed)
    whole = drawn(states, profile)
    assume(len(whole) > 0)
    rows = whole.edges.tolist()
    k = data.draw(st.integers(0, len(rows) - 1))
    assert "sides" in kinds(states, with_edges(whole, rows[:k] + rows[k + 1 :]))
    left, right = divmod(rows[k][4], 3)
    other = 3 * right + left
    if profile != "share":  # where another kind of boundary may be near, and all else is alike
        other = data.draw(st.sampled_from([label for label in range(9) if label % 4 and label != rows[k][4]]))
    assert "sides" in kinds(states, with_edges(whole, [*rows[:k], [*rows[k][:4], other], *rows[k + 1 :]]))


# --- maps of another grid

CHANGES = {
    "a closed door": (slice(18, 32), slice(32, 37), OCCUPIED),
    "a door seen nowhere": (slice(20, 30), slice(32, 37), UNKNOWN),
    "another door": (slice(32, 37), slice(32, 37), FREE),
    "no pillar": (slice(15, 22), slice(15, 23), FREE),
    "a hollow pillar": (slice(16, 21), slice(16, 22), UNKNOWN),
    "another pillar": (slice(30, 34), slice(20, 24), OCCUPIED),
    "all seen": (slice(25, 33), slice(45, 53), FREE),
    "a solid one": (slice(25, 33), slice(45, 53), OCCUPIED),
    "no hidden obstacle": (slice(20, 28), slice(70, 77), UNKNOWN),
    "a free one": (slice(20, 28), slice(70, 77), FREE),
    "a thin wall": (slice(7, 10), slice(14, 20), FREE),
    "a thick wall": (slice(10, 13), slice(14, 20), OCCUPIED),
}


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("change", CHANGES)
def test_the_map_of_another_building_is_not_valid(profile, change):
    rows, columns, state = CHANGES[change]
    other = BUILDING.copy()
    other[rows, columns] = state
    hidden_from_share = {"a hollow pillar"}
    for source, map_states in ((BUILDING, other), (other, BUILDING)):
        assert bool(kinds(source, drawn(map_states, profile))) == (
            profile != "share" or change not in hidden_from_share
        )


def test_a_crack_in_a_wall_that_joins_two_rooms_is_found():
    for profile in PROFILES:
        states = BUILDING.copy()
        states[20:30, 32:37] = OCCUPIED
        leaky = states.copy()
        leaky[12, 32:37] = FREE
        assert "components" in kinds(states, drawn(leaky, profile))
        assert "components" not in kinds(leaky, drawn(leaky, profile))


@given(st.integers(0, 10**6), st.data())
def test_in_exact_every_cell_counts(seed, data):
    states = random_states(seed)
    y, x = (data.draw(st.integers(0, n - 1)) for n in states.shape)
    other = states.copy()
    other[y, x] = (states[y, x] + data.draw(st.integers(1, 2))) % 3
    report = verify(grid(states), drawn(other, "exact"))
    places = [v.place_xy_m for v in report.violations if v.kind == "identity"]
    assert places == [((x + 0.5) * 0.05, (y + 0.5) * 0.05)]


@given(st.integers(0, 10**6), st.integers(0, 2), st.data())
def test_in_full_a_block_of_another_state_is_found(seed, state, data):
    """A block of 5 by 5 cells, the ring around it as it is: its middle is deeper than epsilon."""
    states = random_states(seed, 9, 16)
    y, x = (data.draw(st.integers(0, n - 5)) for n in states.shape)
    states[y : y + 5, x : x + 5] = state
    other = states.copy()
    other[y : y + 5, x : x + 5] = (state + data.draw(st.integers(1, 2))) % 3
    assert "identity" in kinds(states, drawn(other, "full"), specks=0)


@given(st.integers(0, 10**6), st.sampled_from(PROFILES))
def test_an_obstacle_is_never_lost_even_among_specks(seed, profile):
    """Take all obstacles out of a map whose grid has specks around them."""
    states = random_states(seed)
    assume((states == OCCUPIED).any() and (states == FREE).any())
    without = np.where(states == OCCUPIED, FREE, states)
    assert kinds(states, drawn(without, profile), specks=12)


# --- what may be


def test_hidden_edges_are_demanded_by_full_and_only_checked_in_share():
    full = drawn(BUILDING, "full")
    free = np.isin(full.edges[:, 4], [make_label(OCCUPIED, UNKNOWN), make_label(UNKNOWN, OCCUPIED)])
    front = full.edges[~free]
    assert "uncovered" in kinds(BUILDING, with_edges(full, front))
    share = with_edges(drawn(BUILDING, "share"), front)
    assert kinds(BUILDING, share) == {"lost"}  # the obstacle out of sight
    backs = full.edges[free]
    assert kinds(BUILDING, with_edges(share, np.concatenate([front, backs]))) == set()


def test_a_hidden_outline_inside_out_is_found_in_share():
    share = drawn(BUILDING, "share")
    swap = {5: 7, 7: 5}
    rows = [[*row[:4], swap.get(row[4], row[4])] for row in share.edges.tolist()]
    assert kinds(BUILDING, with_edges(share, rows)) == {"sides"}


def test_outlines_of_obstacles_out_of_sight_may_lie_in_one_another():
    """Of what is out of sight only outer outlines are needed: that of a hole with an obstacle in it may be missing."""
    states = np.full((40, 40), UNKNOWN, np.uint8)
    states[5:35, 5:35] = OCCUPIED
    states[9:31, 9:31] = UNKNOWN
    states[15:25, 15:25] = OCCUPIED
    outline, middle = np.full((40, 40), UNKNOWN, np.uint8), np.full((40, 40), UNKNOWN, np.uint8)
    outline[5:35, 5:35], middle[15:25, 15:25] = OCCUPIED, OCCUPIED
    whole = drawn(states, "share")
    edges = np.concatenate([drawn(outline, "share").edges, drawn(middle, "share").edges])
    assert kinds(states, whole) == set()
    assert kinds(states, with_edges(whole, edges)) == set()
    assert kinds(states, with_edges(whole, edges[:-1])) == {"sides"}
    assert kinds(states, with_edges(whole, edges[:4])) == {"lost"}
    swap = {5: 7, 7: 5}
    for turned in (slice(4), slice(4, 8)):
        other = edges.copy()
        other[turned, 4] = [swap[label] for label in edges[turned, 4].tolist()]
        assert kinds(states, with_edges(whole, other)) == ({"sides"} if turned.stop == 4 else set())
    hole = whole.edges[~(whole.edges[:, None] == edges[None]).all(axis=2).any(axis=1)]
    assert kinds(states, with_edges(whole, hole)) == {"sides", "lost"}
    assert kinds(states, with_edges(whole, np.concatenate([hole, edges[4:]]))) == {"sides"}


@pytest.mark.parametrize("profile", ["share", "full"])
@pytest.mark.parametrize("becomes", [FREE, OCCUPIED, UNKNOWN])
@pytest.mark.parametrize(
    ("speck", "around"),
    [(FREE, OCCUPIED), (FREE, UNKNOWN), (UNKNOWN, FREE), (UNKNOWN, OCCUPIED)],
)
def test_a_speck_may_become_anything_but_a_larger_one_may_not(profile, becomes, speck, around):
    states = np.full((30, 30), around, np.uint8)
    states[10:13, 10:14] = speck
    other = states.copy()
    other[10:13, 10:14] = becomes
    # But an unknown one doesn't become free where no free cell is.
    invented = (speck, around, becomes) == (UNKNOWN, OCCUPIED, FREE)
    assert kinds(states, drawn(other, profile), specks=12) == ({"components"} if invented else set())
    to_share = {FREE: FREE, OCCUPIED: OCCUPIED, UNKNOWN: UNKNOWN if around == FREE else OCCUPIED}
    same = to_share[becomes] == to_share[speck] if profile == "share" else becomes == speck
    assert (kinds(states, drawn(other, profile), specks=11) == set()) == same


def test_an_obstacle_that_a_speck_has_joined_to_a_wall_is_not_lost():
    """The unknown cells between a wall and an obstacle in it have become a part of the wall."""
    states = np.full((24, 24), OCCUPIED, np.uint8)
    states[2:12, 2:22] = FREE
    states[16:21, 8:13] = UNKNOWN
    states[17:20, 9:12] = FREE
    states[18, 10] = OCCUPIED
    filled = states.copy()
    filled[16:21, 8:13] = OCCUPIED
    for profile in ("share", "full"):
        assert kinds(states, drawn(filled, profile), specks=16) == set()
    emptied = states.copy()
    emptied[16:21, 8:13] = UNKNOWN
    assert kinds(states, drawn(emptied, "full"), specks=16) == {"lost"}


# Maps that a vectorizer made, valid ones: rows from the top, epsilon, specks, profile, edges.
AMBIGUOUS = {
    "a speck that joins two rooms, its centre on an edge": (
        [".......", "#......", ".#..###", "..?#.#.", "..##...", "......."], 1.0, 12, "full",
        [[0, 0, 0, 7, 2], [0, 0, 4, 0, 6], [0, 7, 2, 7, 2], [2, 1, 2, 7, 3], [2, 1, 4, 7, 1], [2, 7, 4, 7, 5],
         [3, 3, 4, 0, 1], [3, 3, 5, 0, 3], [4, 0, 5, 0, 7], [4, 7, 7, 7, 2], [5, 0, 7, 7, 6]],
    ),
    "thin components that leave a face to another one": (
        ["#.#?", ".?.#", "?.?.", "#?.?"], 2**0.5, 0, "full",
        [[0, -1, 0, 1, 5], [0, -1, 1, 1, 7], [0, 1, 1, 1, 5], [0, 2, 2, 4, 2], [0, 2, 3, 0, 6], [1, 2, 2, 2, 2],
         [1, 2, 2, 3, 6], [2, 2, 2, 3, 2], [2, 2, 3, 1, 2], [2, 2, 3, 2, 6], [2, 3, 2, 4, 3], [2, 3, 3, 2, 1],
         [2, 4, 4, 2, 5], [3, 0, 3, 1, 3], [3, 0, 4, 1, 7], [3, 1, 3, 2, 2], [3, 1, 4, 1, 3], [3, 2, 4, 2, 1],
         [4, 1, 4, 2, 6]],
    ),
    "one that lies in another's face by its cells": (
        ["??.?", "??.#", "?.?.", "?..#"], 2**0.5, 0, "share",
        [[0, 0, 0, 3, 2], [0, 0, 4, 2, 6], [0, 3, 1, 3, 1], [1, 2, 1, 3, 6], [1, 2, 3, 2, 2], [1, 3, 1, 4, 1],
         [1, 3, 3, 2, 6], [1, 4, 2, 4, 2], [2, 4, 3, 2, 1], [3, 2, 3, 3, 1], [3, 3, 4, 2, 2]],
    ),
    "a speck between thin components, at three cells": (
        ["..??????.??????....#", ".??????????..#....#.", ".??????.....?....?.#", ".?........?#..###?..",
         "?.....#.....##.....#", "?#####.####?????#???", "??.?..?.........?..."], 3.0, 12, "share",
        [[2, 1, 5, 1, 6], [2, 1, 7, 19, 1], [5, 1, 6, 13, 6], [6, 13, 6, 14, 3], [6, 14, 7, 19, 6]],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", AMBIGUOUS)
def test_what_may_belong_to_several_faces_is_given_the_benefit_of_the_doubt(name):
    rows, epsilon_cells, specks, profile, edges = AMBIGUOUS[name]
    states = [[".#?".index(c) for c in row] for row in reversed(rows)]
    rows_of_map = np.array(edges, np.int32)
    vector_map = VectorMap(LATTICE, rows_of_map, np.zeros(len(edges), np.uint8), epsilon_cells, profile)
    assert kinds(states, vector_map, specks=specks) == set()


def test_exact_knows_no_specks():
    states, other = np.full((12, 12), FREE, np.uint8), np.full((12, 12), FREE, np.uint8)
    states[5, 5] = UNKNOWN
    assert kinds(states, drawn(other, "full"), specks=12) == set()
    assert kinds(states, drawn(other, "exact"), specks=12) == {"uncovered", "identity"}


@given(st.integers(0, 10**6), st.integers(-7, 7), st.integers(-7, 7))
def test_exact_holds_at_any_phase_within_its_epsilon(seed, y16, x16):
    """All cells are in faces of their state, also where the grid is off its lattice by less than half a cell."""
    states = random_states(seed)
    place = Pose2(3.0, -1.0, 0.4)
    lattice = Lattice(50_000, FixedPose.from_pose(place))
    vector_map = oracles.corner_map(states, lattice, "exact", EPSILON["exact"])
    shifted = OccupancyGrid.from_states(states, 0.05, place @ Pose2(x16 / 16 * 0.05, y16 / 16 * 0.05))
    found = {v.kind for v in verify(shifted, vector_map).violations}
    if y16**2 + x16**2 <= 63:
        assert not found
    else:
        assert "identity" not in found


def test_a_grid_of_another_resolution_is_refused():
    with pytest.raises(ConfigError, match="resolution"):
        verify(OccupancyGrid(np.zeros((3, 3), np.int8), 0.1), drawn(BUILDING, "full"))
