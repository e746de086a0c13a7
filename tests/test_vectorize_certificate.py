"""What every vector map must keep, asked by brute force in rationals that share nothing with the vectorizer."""

from __future__ import annotations

from fractions import Fraction
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetmap.model.errors import ConfigError
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN
from fleetmap.model.pose import Pose2
from fleetmap.vectorize import Vectorizer, drop_specks, rasterize, vectorize, verify


def random_states(seed, height=14, width=17):
    """Blobs of the three states, with some noise: nothing is cleaner than a map would be."""
    rng = np.random.default_rng(seed)
    coarse = rng.choice(3, size=(height // 3 + 1, width // 3 + 1), p=[0.5, 0.25, 0.25])
    states = np.kron(coarse, np.ones((3, 3), int))[:height, :width]
    noise = rng.random(states.shape) < rng.choice([0, 0.1, 0.4])
    return np.where(noise, rng.integers(0, 3, states.shape), states).astype(np.uint8)


def cracks(states, offset_yx=(0, 0)):
    """Boundary of free space as unit segments (a, b) with free space on the left, by the state on the right."""
    found = {OCCUPIED: [], UNKNOWN: []}
    padded = np.pad(states, 1, constant_values=UNKNOWN)
    height, width = states.shape
    oy, ox = offset_yx
    for i in range(height):
        for j in range(width):
            if states[i, j] != FREE:
                continue
            corners = [(i, j), (i, j + 1), (i + 1, j + 1), (i + 1, j)]
            beyond = [padded[i, j + 1], padded[i + 1, j + 2], padded[i + 2, j + 1], padded[i + 1, j]]
            for k in range(4):
                if beyond[k] != FREE:
                    (ay, ax), (by, bx) = corners[k], corners[(k + 1) % 4]
                    found[int(beyond[k])].append(((ay + oy, ax + ox), (by + oy, bx + ox)))
    return found


def directed_edges(vector_map):
    """Edges with free space on the left, by the state on the right; hidden ones are left out."""
    found = {OCCUPIED: [], UNKNOWN: []}
    for y0, x0, y1, x1, label in vector_map.edges.tolist():
        left, right = divmod(label, 3)
        if left == FREE:
            found[right].append(((y0, x0), (y1, x1)))
        elif right == FREE:
            found[left].append(((y1, x1), (y0, x0)))
    return found


SCALE = 128
"""Points are whole 128ths of a cell: phases are sixteenths, edges are looked at in eighths."""


def near(points, segments, epsilon2):
    """(p, s) bool: is each point within epsilon of each segment? In integers: grids are small."""
    p = np.array(points, np.int64).reshape(-1, 1, 2)
    a, b = np.array(segments, np.int64).reshape(1, -1, 2, 2).transpose(2, 0, 1, 3)
    d, r = b - a, p - a
    along, length2 = (d * r).sum(axis=2), (d * d).sum(axis=2)
    cross = d[..., 1] * r[..., 0] - d[..., 0] * r[..., 1]
    to_a, to_b = (r * r).sum(axis=2), ((p - b) ** 2).sum(axis=2)
    n, m = epsilon2.numerator * SCALE**2, epsilon2.denominator
    return np.where(along <= 0, m * to_a <= n, np.where(along >= length2, m * to_b <= n, m * cross**2 <= n * length2))


def scaled(segments):
    return [[[int(v * SCALE) for v in p] for p in segment] for segment in segments]


def meet_badly(segments):
    """Pairs of segments that share more than a common end."""

    def turn(a, b, c):
        return (b[1] - a[1]) * (c[0] - a[0]) - (b[0] - a[0]) * (c[1] - a[1])

    def on(p, q, r):
        between = all(min(p[k], q[k]) <= r[k] <= max(p[k], q[k]) for k in range(2))
        return between and r not in (p, q) and turn(p, q, r) == 0

    for (a, b), (c, d) in combinations(segments, 2):
        if (
            {a, b} == {c, d}
            or (turn(a, b, c) * turn(a, b, d) < 0 and turn(c, d, a) * turn(c, d, b) < 0)
            or (on(a, b, c) or on(a, b, d) or on(c, d, a) or on(c, d, b))
        ):
            yield (a, b), (c, d)


def windings(edges, points):
    """How often free space winds around points that lie on no edge, all in whole units."""
    a, b = np.array(edges, np.int64).reshape(1, -1, 2, 2).transpose(2, 0, 1, 3)
    p = np.array(points, np.int64).reshape(-1, 1, 2)
    side = (b[..., 1] - a[..., 1]) * (p[..., 0] - a[..., 0]) - (b[..., 0] - a[..., 0]) * (p[..., 1] - a[..., 1])
    up = (a[..., 0] <= p[..., 0]) & (p[..., 0] < b[..., 0]) & (side > 0)
    down = (b[..., 0] <= p[..., 0]) & (p[..., 0] < a[..., 0]) & (side < 0)
    return up.sum(axis=1) - down.sum(axis=1)


def assert_certified(states, vector_map, epsilon2, offset_yx=(0, 0)):
    boundary, edges = cracks(states, offset_yx), directed_edges(vector_map)
    for state in (OCCUPIED, UNKNOWN):
        assert bool(boundary[state]) == bool(edges[state])
        if not edges[state]:
            continue
        walk, chosen = np.array(scaled(boundary[state])), np.array(scaled(edges[state]))
        # One edge is near both ends of a crack, and so near all that is between.
        assert (near(walk[:, 0], chosen, epsilon2) & near(walk[:, 1], chosen, epsilon2)).any(axis=1).all()
        for eighth in range(9):
            points = chosen[:, 0] + eighth * (chosen[:, 1] - chosen[:, 0]) // 8
            assert near(points, walk, epsilon2).any(axis=1).all()
    segments = [((y0, x0), (y1, x1)) for y0, x0, y1, x1, _ in vector_map.edges.tolist()]
    assert not list(meet_badly(segments))
    # Free on the left of each edge, not on its right: nothing is turned over or swallowed.
    if edges[OCCUPIED] + edges[UNKNOWN]:
        large = np.array(edges[OCCUPIED] + edges[UNKNOWN], np.int64) << 20
        middle, step = large.sum(axis=1) // 2, (large[:, 1] - large[:, 0]) >> 16
        aside = np.column_stack([step[:, 1], -step[:, 0]])
        assert (windings(large, middle + aside) == 1).all()
        assert (windings(large, middle - aside) == 0).all()


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([(2**0.5, Fraction(2)), (0.5, Fraction(1, 4)), (3.0, Fraction(9))]))
def test_a_fresh_map_is_certified(seed, epsilon):
    states = random_states(seed)
    vector_map = vectorize(OccupancyGrid.from_states(states, 0.05), epsilon_cells=epsilon[0], specks=0)
    assert_certified(states, vector_map, epsilon[1])


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.tuples(st.integers(-20, 20), st.integers(-20, 20)))
def test_an_update_is_certified_at_the_true_offset_of_its_grid(seed, sixteenths):
    states = random_states(seed)
    vectorizer = Vectorizer(specks=0)
    vectorizer.update(OccupancyGrid.from_states(states, 0.05))
    changed = states.copy()
    rng = np.random.default_rng(seed)
    for _ in range(3):
        y, x = rng.integers(0, states.shape[0]), rng.integers(0, states.shape[1])
        changed[y, x] = rng.integers(0, 3)
    offset_yx = (Fraction(sixteenths[0], 16), Fraction(sixteenths[1], 16))
    origin = Pose2(float(offset_yx[1]) * 0.05, float(offset_yx[0]) * 0.05)
    for _ in range(2):
        vector_map = vectorizer.update(OccupancyGrid.from_states(changed, 0.05, origin))
        assert_certified(changed, vector_map, Fraction(2), offset_yx)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6))
def test_at_epsilon_one_half_free_space_comes_back_cell_by_cell(seed):
    states = random_states(seed, 20, 30)
    grid = OccupancyGrid.from_states(states, 0.05)
    back = rasterize(vectorize(grid, epsilon_cells=0.5, specks=0), like=grid).states_yx()
    assert np.array_equal(back == FREE, states == FREE)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6))
def test_every_obstacle_survives_within_epsilon(seed):
    states = random_states(seed)
    grid = OccupancyGrid.from_states(states, 0.05)
    back = np.argwhere(rasterize(vectorize(grid, specks=0)).states_yx() == OCCUPIED)
    vector_map = vectorize(grid, specks=0)
    low = rasterize(vector_map).origin
    back += np.array([round(low.y_m / 0.05), round(low.x_m / 0.05)])
    touches = np.zeros(states.shape, bool)
    padded = np.pad(states, 1, constant_values=UNKNOWN)
    for dy, dx in ((0, 1), (2, 1), (1, 0), (1, 2)):
        touches |= padded[dy : dy + states.shape[0], dx : dx + states.shape[1]] == FREE
    for cell in np.argwhere((states == OCCUPIED) & touches):
        # Its crack is within sqrt(2) of an edge, and a cell beside the edge is painted.
        assert np.hypot(*(back - cell).T).min() <= 3


def test_small_free_and_unknown_specks_are_dropped_and_occupied_cells_never():
    cells = np.full((40, 60), 0, np.int8)
    cells[10:12, 10:13] = -1  # 6 cells
    cells[20, 20] = 100
    cells[30:34, 30:34] = -1  # 16 cells: not a speck
    vectorizer = Vectorizer()
    vector_map = vectorizer.update(OccupancyGrid(cells, 0.05))
    assert (vectorizer.dropped_specks, vectorizer.dropped_cells) == (1, 6)
    assert vector_map.obstacle.sum() in (3, 4)
    back = rasterize(vector_map, like=OccupancyGrid(cells, 0.05)).states_yx()
    assert back[11, 11] == FREE
    assert back[20, 20] == OCCUPIED
    assert back[32, 32] == UNKNOWN


def test_an_obstacle_that_touches_no_free_cell_is_outlined():
    cells = np.full((40, 60), -1, np.int8)
    cells[5:20, 5:20] = 0
    cells[30:33, 40:50] = 100
    grid = OccupancyGrid(cells, 0.05)
    assert (rasterize(vectorize(grid), like=grid).states_yx() == grid.states_yx()).all()


def test_a_free_speck_that_lies_apart_is_kept():
    cells = np.full((40, 60), -1, np.int8)
    cells[5:20, 5:20] = 0
    cells[30, 50] = 0
    cells[22, 10] = 0
    grid = OccupancyGrid(cells, 0.05)
    back = rasterize(vectorize(grid), like=grid).states_yx()
    assert (back[30, 50], back[22, 10]) == (FREE, UNKNOWN)


def test_thickness_is_that_of_the_wall():
    cells = np.full((60, 80), -1, np.int8)
    cells[10:50, 10:70] = 0
    cells[10:45, 5:10] = 100  # 5 cells
    cells[50:52, 15:70] = 100  # 2 cells; frontier between them: thickness belongs to an arc
    vector_map = vectorize(OccupancyGrid(cells, 0.05))
    by_edge = {tuple(edge): t for edge, t in zip(vector_map.edges.tolist(), vector_map.thickness.tolist(), strict=True)}
    assert by_edge[10, 10, 45, 10, 5 - 2] == 20
    assert by_edge[50, 15, 50, 70, 5 - 2] == 8


@pytest.mark.parametrize("option", [{"epsilon_cells": 0.4}, {"epsilon_cells": float("nan")}, {"specks": -1}])
def test_impossible_options_are_refused(option):
    with pytest.raises(ConfigError):
        Vectorizer(**option)


def test_an_empty_map_and_a_full_one():
    for value, edges in ((-1, 0), (100, 4), (0, 4)):
        grid = OccupancyGrid(np.full((5, 7), value, np.int8), 0.05)
        vector_map = vectorize(grid)
        assert len(vector_map) == edges
        assert (rasterize(vector_map, like=grid).cells_yx == value).all()


def test_an_unknown_speck_becomes_free_only_beside_free_cells_that_stay():
    """A free speck around an unknown one is dropped: the inner one must not stay behind as a free island."""
    cells = np.full((30, 30), 100, np.int8)
    cells[2:28, 2:12] = 0
    cells[20, 14:17] = cells[21, [14, 16]] = cells[22, 14:17] = 0
    cells[21, 15] = -1
    grid = OccupancyGrid(cells, 0.05)
    vectorizer = Vectorizer()
    vector_map = vectorizer.update(grid)
    assert len(vector_map) == 4  # those of the room
    assert (vectorizer.dropped_specks, vectorizer.dropped_cells) == (2, 9)
    assert verify(grid, vector_map).valid


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0, 12]), st.sampled_from([0.5, 1.0, 2**0.5, 3.0]))
def test_the_verifier_finds_a_fresh_map_valid(seed, specks, epsilon):
    grid = OccupancyGrid.from_states(random_states(seed), 0.05)
    assert verify(grid, vectorize(grid, specks=specks, epsilon_cells=epsilon), specks=specks).violations == ()


@settings(max_examples=30, deadline=None)
@given(st.booleans(), st.integers(2, 21), st.sampled_from([0, 12]))
def test_the_verifier_finds_a_door_that_only_one_of_grid_and_map_has(diagonal, y, specks):
    closed = np.full((24, 24), FREE, np.uint8)
    closed[np.arange(24), np.arange(24) if diagonal else 12] = OCCUPIED
    opened = closed.copy()
    opened[y, y if diagonal else 12] = FREE
    with_door, without = (OccupancyGrid.from_states(states, 0.05) for states in (opened, closed))
    for source, drawn in ((with_door, without), (without, with_door)):
        violations = verify(source, vectorize(drawn, specks=specks), specks=specks).violations
        assert "components" in {violation.kind for violation in violations}


def test_specks_dropped_from_a_grid_are_those_that_a_vector_map_leaves_out():
    states = np.full((30, 40), FREE, np.uint8)
    states[:4] = states[-4:] = states[:, :4] = states[:, -4:] = OCCUPIED
    states[10:12, 10:13] = UNKNOWN  # a speck of six cells
    states[20, 20] = OCCUPIED
    grid = OccupancyGrid.from_states(states, 0.05, Pose2(1.0, 2.0, 0.3))
    without = drop_specks(grid)
    expected = states.copy()
    expected[10:12, 10:13] = FREE
    assert (without.states_yx() == expected).all()
    assert without.origin == grid.origin
    assert vectorize(without, specks=0).digest == vectorize(grid).digest
    assert (drop_specks(grid, 5).states_yx() == states).all()
    with pytest.raises(ConfigError, match="specks"):
        drop_specks(grid, -1)
