"""The paper's greedy against a slow twin in plain Python, and the certificate of its mended reading by brute force."""

import math
from collections import Counter
from fractions import Fraction
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fleetmap.model.errors import ConfigError
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN
from fleetmap.model.pose import Pose2
from fleetmap.model.vectormap import OBSTACLE_LABELS
from fleetmap.vectorize.paper_kernels import LONGEST_EDGE_CELLS, is_near, stays_near
from fleetmap.vectorize.paper_method import vectorize_by_paper
from fleetmap.vectorize.verify import verify
from fleetmap.vectorize.verify_cover import exact_gap

EPSILONS = {1.0: Fraction(1), math.sqrt(2): Fraction(2), 1.5: Fraction(9, 4), 2.0: Fraction(4)}

states = st.tuples(st.integers(1, 9), st.integers(1, 9)).flatmap(
    lambda shape: st.sampled_from(
        [[FREE, OCCUPIED], [OCCUPIED, OCCUPIED, FREE], [FREE, FREE, OCCUPIED, UNKNOWN]]
    ).flatmap(lambda choice: arrays(np.uint8, shape, elements=st.sampled_from(choice)))
)
readings = st.sampled_from(["B", "C", "mended"])
kinds_of_cells = st.sampled_from(["occupied", "surface"])
epsilons = st.sampled_from(list(EPSILONS))


def as_grid(states_yx):
    return OccupancyGrid.from_states(states_yx, 0.05)


def drawn(rows):
    """Rows from the top down: '#' occupied, '.' free, '?' unknown."""
    return as_grid(np.array([[".#?".index(c) for c in row] for row in reversed(rows)], np.uint8))


def chosen_cells(states_yx, cells):
    """Centres (y, x) of the occupied cells, or of those that touch a free one, in row-major order."""
    free = {tuple(p) for p in np.argwhere(states_yx == FREE).tolist()}
    centres = [tuple(p) for p in np.argwhere(states_yx == OCCUPIED).tolist()]
    if cells == "surface":
        around = [(dy, dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1)]
        centres = [(y, x) for y, x in centres if any((y + dy, x + dx) in free for dy, dx in around)]
    return centres


def distance2(p, a, b):
    """Square of the distance of point p from segment a b, a fraction."""
    d = b[0] - a[0], b[1] - a[1]
    along = Fraction((p[0] - a[0]) * d[0] + (p[1] - a[1]) * d[1], max(d[0] ** 2 + d[1] ** 2, 1))
    t = min(max(along, Fraction(0)), Fraction(1))
    return (p[0] - a[0] - t * d[0]) ** 2 + (p[1] - a[1] - t * d[1]) ** 2


def is_covered(segment, centres, epsilon2):
    """Whether all of a segment is within epsilon of the centres, by the verifier's rational arithmetic."""
    return math.isnan(exact_gap(list(segment), [[*c, *c] for c in centres], epsilon2))


def slow_greedy(centres, epsilon2, reading):
    """The paper's greedy by sets, dictionaries and fractions; returns the edges, sorted."""
    edges = {v: {} for v in centres}  # neighbours, each with the removed points that the edge stands for
    for v, w in combinations(centres, 2):
        if (v[0] - w[0]) ** 2 + (v[1] - w[1]) ** 2 <= epsilon2:
            edges[v][w] = edges[w][v] = frozenset()
    isolated = [v for v in centres if not edges[v]]

    def first_legal(v2):
        for v1, v3 in combinations(sorted(edges[v2]), 2):
            legal = distance2(v2, v1, v3) <= epsilon2
            if legal and reading == "mended":
                stands_for = edges[v2][v1] | edges[v2][v3]
                legal = all(distance2(p, v1, v3) <= epsilon2 for p in stands_for)
                legal = legal and is_covered((*v1, *v3), centres, epsilon2)
            if legal:
                return v1, v3
        return None

    changed = True
    while changed:
        changed = False
        for v2 in centres:
            while (pair := first_legal(v2)) is not None:
                changed = True
                v1, v3 = pair
                stands_for = edges[v2][v1] | edges[v2][v3]
                for v in list(edges[v2]) if reading == "B" else pair:
                    del edges[v][v2], edges[v2][v]
                if not edges[v2]:
                    stands_for |= {v2}
                edges[v1][v3] = edges[v3][v1] = edges[v1].get(v3, frozenset()) | stands_for
    found = [(*v, *w) for v in centres for w in edges[v] if v < w]
    if reading == "mended":
        found += [(y, x, y, x + 1) for y, x in isolated]
    return sorted(found)


# --- the same result as the slow twin


@given(states, readings, kinds_of_cells, epsilons)
def test_the_kernels_give_the_edges_of_the_slow_twin(states_yx, reading, cells, epsilon):
    found = vectorize_by_paper(as_grid(states_yx), reading=reading, cells=cells, epsilon_cells=epsilon)
    expected = slow_greedy(chosen_cells(states_yx, cells), EPSILONS[epsilon], reading)
    assert found.edges[:, :4].tolist() == [list(e) for e in expected]


@pytest.mark.parametrize("reading", ["B", "C", "mended"])
def test_the_kernels_give_the_edges_of_the_slow_twin_on_a_larger_map(reading):
    states_yx = noisy_rooms(40)
    centres = chosen_cells(states_yx, "occupied")
    found = vectorize_by_paper(as_grid(states_yx), reading=reading, cells="occupied")
    assert found.edges[:, :4].tolist() == [list(e) for e in slow_greedy(centres, Fraction(2), reading)]


def noisy_rooms(size):
    """Rooms with ragged walls, a slanted one, a round pillar and single cells."""
    rng = np.random.default_rng(size)
    y, x = np.mgrid[:size, :size]
    wall = (np.abs(y - size // 2) <= 1) & (x % 17 > 3)
    wall |= np.abs(x - size // 3 - y // 4) <= 1
    wall |= np.abs(np.hypot(y - 0.7 * size, x - 0.7 * size) - size / 6) < 0.8
    flipped = rng.random((size, size))
    return np.where(wall & (flipped > 0.1) | (flipped < 0.01), OCCUPIED, FREE).astype(np.uint8)


# --- what mended promises, by brute force


@given(states, kinds_of_cells, epsilons)
def test_mended_keeps_both_constraints_of_the_paper(states_yx, cells, epsilon):
    epsilon2 = EPSILONS[epsilon]
    centres = chosen_cells(states_yx, cells)
    edges = vectorize_by_paper(as_grid(states_yx), reading="mended", cells=cells, epsilon_cells=epsilon).edges
    for centre in centres:
        assert any(distance2(centre, (y0, x0), (y1, x1)) <= epsilon2 for y0, x0, y1, x1, _ in edges.tolist())
    for edge in edges.tolist():
        assert is_covered(edge[:4], centres, epsilon2)


@given(states, epsilons)
def test_the_verifier_agrees_that_mended_keeps_both_constraints(states_yx, epsilon):
    source = as_grid(states_yx)
    report = verify(source, vectorize_by_paper(source, reading="mended", epsilon_cells=epsilon), points="centres")
    assert not {v.kind for v in report.violations} & {"uncovered", "astray"}


def test_mended_is_valid_in_all_where_each_cell_of_a_ring_has_two_neighbours():
    y, x = np.mgrid[:21, :21]
    states_yx = np.select([abs(y - 10) + abs(x - 10) < 9, abs(y - 10) + abs(x - 10) == 9], [FREE, OCCUPIED], UNKNOWN)
    source = as_grid(states_yx.astype(np.uint8))
    found = vectorize_by_paper(source, reading="mended")
    assert verify(source, found, points="centres", specks=0).valid
    assert len(found) <= 8


def test_c_and_mended_cut_a_wall_where_three_edges_meet():
    """The corner of a room is a triangle: it becomes one edge, and what else hung on its tip is cut off."""
    source = drawn(["############", *["#..........#"] * 9, "############"])
    found = vectorize_by_paper(source, reading="mended")
    assert {v.kind for v in verify(source, found, points="centres").violations} == {"sides"}
    _, degrees = np.unique(found.edges[:, :4].reshape(-1, 2), axis=0, return_counts=True)
    assert (degrees == 1).any()


def test_b_and_c_lose_cells_of_a_circle_and_mended_does_not():
    y, x = np.mgrid[:90, :90]
    source = as_grid((np.abs(np.hypot(y - 45, x - 45) - 40) < 0.8).astype(np.uint8))
    lost = {}
    for reading in ("B", "C", "mended"):
        report = verify(source, vectorize_by_paper(source, reading=reading), points="centres")
        lost[reading] = Counter(v.kind for v in report.violations)["uncovered"]
    assert lost["B"] > 50
    assert lost["C"] > 0
    assert lost["mended"] == 0


def test_real_maps_are_kept_by_mended_alone(real_map):
    import warnings

    from fleetmap.model.map_server import MapWarning, load_map

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MapWarning)
        source = load_map(real_map)
    for reading in ("B", "C", "mended"):
        report = verify(source, vectorize_by_paper(source, reading=reading), points="centres")
        assert ("uncovered" not in {v.kind for v in report.violations}) == (reading == "mended")


# --- what the map says besides


@pytest.mark.parametrize("reading", ["B", "C", "mended"])
def test_vertices_lie_at_cell_centres_whatever_the_origin(reading):
    origin = Pose2(-3.0, 2.0, 0.7)
    source = OccupancyGrid.from_states(np.eye(6, dtype=np.uint8), 0.1, origin)
    (segment,) = vectorize_by_paper(source, reading=reading).segments_xy
    np.testing.assert_allclose(segment, origin.apply([[0.05, 0.05], [0.55, 0.55]]), atol=1e-5)


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("up", [-1, 0, 1, 3])
def test_the_free_side_is_the_one_with_more_free_cells(up, turned):
    """A wall from left to right that rises by ``up`` cells, free above it: on the left of an edge to the right."""
    cells = np.full((24, 24), UNKNOWN, np.uint8)
    for x in range(4, 20):
        y = 10 + round(up * (x - 4) / 15)
        cells[y, x] = OCCUPIED
        cells[y + 1 :, x] = FREE
    free_left, free_right = OBSTACLE_LABELS
    expected = free_left if up >= 0 else free_right  # a falling edge is seen from its lower, right end
    if turned:
        cells = np.ascontiguousarray(cells.T)  # free on the right of a steep edge
        expected = free_right
    edges = vectorize_by_paper(as_grid(cells), reading="mended").edges
    assert len(edges) <= 3
    if turned and up == -1:
        expected = free_right
    assert set(edges[:, 4].tolist()) == {expected}


def test_of_equal_sides_the_left_one_is_free():
    rows = ["......", ".####.", "......"]
    assert vectorize_by_paper(drawn(rows)).edges[:, 4].tolist() == [OBSTACLE_LABELS[0]]


def test_a_cell_without_neighbours_is_an_edge_in_mended_and_nothing_else():
    rows = [".....", "..#..", "....."]
    assert len(vectorize_by_paper(drawn(rows), reading="B")) == 0
    assert len(vectorize_by_paper(drawn(rows), reading="C")) == 0
    assert vectorize_by_paper(drawn(rows), reading="mended").edges[:, :4].tolist() == [[1, 2, 1, 3]]


@pytest.mark.parametrize("reading", ["B", "C", "mended"])
def test_a_grid_without_walls_gives_an_empty_map(reading):
    assert len(vectorize_by_paper(as_grid(np.full((5, 7), UNKNOWN, np.uint8)), reading=reading)) == 0


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"reading": "A"}, "reading"),
        ({"cells": "all"}, "cells"),
        ({"epsilon_cells": 0.9}, "epsilon_cells"),
        ({"epsilon_cells": math.nan}, "epsilon_cells"),
        ({"epsilon_cells": 4.1}, "epsilon_cells"),
    ],
)
def test_an_impossible_option_is_an_error_that_names_it(options, says):
    with pytest.raises(ConfigError, match=says):
        vectorize_by_paper(as_grid(np.ones((3, 3), np.uint8)), **options)


# --- the kernels' integers


def test_edges_of_mended_end_where_their_integers_do():
    cells = np.zeros((3, 1500), np.uint8)
    cells[1] = OCCUPIED
    assert len(vectorize_by_paper(as_grid(cells), reading="C")) == 1
    edges = vectorize_by_paper(as_grid(cells), reading="mended").edges
    assert (edges[:, 3] - edges[:, 1]).tolist() == [LONGEST_EDGE_CELLS, 1499 - LONGEST_EDGE_CELLS]


@given(
    st.tuples(*[st.integers(-(2**20), 2**20)] * 4),
    st.tuples(st.integers(-5, 5), st.integers(-5, 5), st.integers(0, 2**20)),
    st.sampled_from([16, 32, 256]),
)
def test_nearness_is_exact_up_to_the_largest_coordinates(segment, offset, epsilon2):
    ay, ax, by, bx = segment
    dy, dx, along = offset
    p = ay + (by - ay) * along // 2**20 + dy, ax + (bx - ax) * along // 2**20 + dx
    expected = distance2(p, (ay, ax), (by, bx)) <= Fraction(epsilon2, 16)
    assert is_near(*p, ay, ax, by, bx, epsilon2) == expected


@given(
    arrays(np.uint8, (12, 12), elements=st.sampled_from([0, 0, 1])),
    st.tuples(*[st.integers(0, 11)] * 4).filter(lambda s: s[:2] != s[2:]),
    st.sampled_from([16, 32, 36, 64, 256]),
)
def test_whether_an_edge_strays_is_decided_exactly(solid, segment, epsilon2):
    centres = np.argwhere(solid).tolist()
    assert stays_near(solid, *segment, epsilon2) == is_covered(segment, centres, Fraction(epsilon2, 16))


@pytest.mark.parametrize("rise", [0, 1, 333, LONGEST_EDGE_CELLS - 1, LONGEST_EDGE_CELLS])
@pytest.mark.parametrize("apart", [5, 6, 7, 8, 9])
@pytest.mark.parametrize("seed", [0, 1])
def test_the_integers_fit_for_the_longest_edge_and_the_largest_epsilon(rise, apart, seed):
    rng = np.random.default_rng(seed)
    solid = np.zeros((LONGEST_EDGE_CELLS + 9, LONGEST_EDGE_CELLS + 9), np.uint8)
    for x in range(0, LONGEST_EDGE_CELLS + 9, apart):
        y = round(rise * x / LONGEST_EDGE_CELLS) + int(rng.integers(-2, 3))
        solid[min(max(y, 0), LONGEST_EDGE_CELLS + 8), x] = 1
    segment = (4, 4, 4 + rise, 4 + LONGEST_EDGE_CELLS)
    assert stays_near(solid, *segment, 256) == is_covered(segment, np.argwhere(solid).tolist(), Fraction(16))
