"""Rasterisation against a slow twin that asks every cell centre, in rationals."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetmap.model.errors import MapFormatError
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN, Lattice
from fleetmap.model.mergedmap import MergedMap
from fleetmap.model.raster import merged_states, vector_map_states
from fleetmap.model.vectormap import VectorMap, make_label


def distance2(y, x, y0, x0, y1, x1):
    """Squared distance of a point from a segment."""
    dy, dx = y1 - y0, x1 - x0
    t = Fraction((y - y0) * dy + (x - x0) * dx) / (dy * dy + dx * dx)
    t = min(max(t, 0), 1)
    return (y - y0 - t * dy) ** 2 + (x - x0 - t * dx) ** 2


def slow_state(rows, step, y, x):
    """State of the cell whose centre is (y, x), by the laws as they are written."""
    winding = 0
    for y0, x0, y1, x1, left, right, *_ in rows:
        if y0 <= y < y1 and x0 + Fraction((y - y0) * (x1 - x0), y1 - y0) <= x:
            winding += (right == FREE) - (left == FREE)
    free = winding > 0
    for y0, x0, y1, x1, left, right, obstacle, thickness in rows:
        if not obstacle:
            continue
        cross = (x1 - x0) * (y - y0) - (y1 - y0) * (x - x0)
        two_sided = left == right == FREE
        on_blocking_side = two_sided or (cross >= 0 and left != FREE) or (cross <= 0 and right != FREE)
        reach = Fraction(step, 2) if free or two_sided else max(thickness, step)
        if on_blocking_side and distance2(y, x, y0, x0, y1, x1) <= reach**2:
            return OCCUPIED
    return FREE if free else UNKNOWN


def slow_states(rows, step, low_yx, shape):
    return np.array(
        [
            [
                slow_state(rows, step, (low_yx[0] + i + Fraction(1, 2)) * step, (low_yx[1] + j + Fraction(1, 2)) * step)
                for j in range(shape[1])
            ]
            for i in range(shape[0])
        ]
    )


coordinate = st.integers(-30, 30)
state = st.sampled_from([FREE, OCCUPIED, UNKNOWN])


@st.composite
def arrangement(draw):
    """Closed polygons with free space inside, and loose edges of any label."""
    rows = []
    for _ in range(draw(st.integers(0, 2))):
        points = draw(st.lists(st.tuples(coordinate, coordinate), min_size=3, max_size=6))
        for a, b in zip(points, points[1:] + points[:1], strict=True):
            obstacle, thickness = draw(st.integers(0, 1)), draw(st.integers(0, 12))
            beyond = OCCUPIED if obstacle else UNKNOWN
            if a != b:
                left, right = (FREE, beyond) if a < b else (beyond, FREE)
                rows.append((*min(a, b), *max(a, b), left, right, obstacle, thickness))
    for _ in range(draw(st.integers(0, 3))):
        a, b = draw(st.tuples(coordinate, coordinate)), draw(st.tuples(coordinate, coordinate))
        same = draw(state)
        if a != b:
            rows.append((*min(a, b), *max(a, b), same, same, draw(st.integers(0, 1)), draw(st.integers(0, 12))))
    return sorted(set(rows))


@settings(max_examples=60, deadline=None)
@given(arrangement(), st.integers(1, 9))
def test_merged_states_are_those_of_the_slow_twin(rows, step):
    """But for the holes in walls that are sealed: see ``test_model_seal``."""
    states, low_yx = merged_states(np.array(rows, np.int32).reshape(-1, 8), step)
    slow = slow_states(rows, step, low_yx, states.shape)
    assert np.array_equal(states[states != OCCUPIED], slow[states != OCCUPIED])
    assert (states[slow == OCCUPIED] == OCCUPIED).all()


@settings(max_examples=30, deadline=None)
@given(arrangement(), st.integers(2, 9))
def test_nothing_is_painted_outside_of_the_extent(rows, step):
    states, low_yx = merged_states(np.array(rows, np.int32).reshape(-1, 8), step)
    wide = slow_states(rows, step, (low_yx[0] - 1, low_yx[1] - 1), (states.shape[0] + 2, states.shape[1] + 2))
    wide[1:-1, 1:-1] = UNKNOWN
    # A centre in free space is never outside of the box of all edges; a wall's reach is inside by its padding.
    assert (wide == UNKNOWN).all()


def square(low, high, label_inside, thickness=4):
    """A closed square of obstacle edges on the lattice; free inside or free outside."""
    inside_left = make_label(FREE, OCCUPIED) if label_inside == FREE else make_label(OCCUPIED, FREE)
    corners = [(low, low), (low, high), (high, high), (high, low)]
    edges = [(*a, *b, inside_left) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
    return VectorMap(Lattice(50_000), np.array(edges, np.int32), np.full(4, thickness, np.uint8))


def test_a_square_room_has_walls_of_its_thickness():
    states, low_yx = vector_map_states(square(0, 6, FREE, thickness=8))
    assert low_yx == (-2, -2)
    assert states.shape == (10, 10)
    assert (states[2:8, 2:8] == FREE).all()
    assert (states[0:2, 2:8] == OCCUPIED).all()
    assert (states[0, 0], states[1, 1]) == (UNKNOWN, OCCUPIED)  # round outer corners: distances 2.12 and 0.71


def test_a_window_is_a_cut_of_the_whole():
    vector_map = square(-4, 9, FREE, thickness=5)
    states, (y, x) = vector_map_states(vector_map)
    part, low_yx = vector_map_states(vector_map, low_yx=(y + 3, x + 1), shape=(5, 20))
    assert low_yx == (y + 3, x + 1)
    assert np.array_equal(part[:, : states.shape[1] - 1], states[3:8, 1:])
    assert (part[:, states.shape[1] - 1 :] == UNKNOWN).all()


def test_hidden_edges_enclose_occupied_space():
    hidden = square(0, 3, FREE)
    edges = hidden.edges.copy()
    edges[:, 4] = np.where(edges[:, 4] == make_label(FREE, OCCUPIED), make_label(OCCUPIED, UNKNOWN), 3 * UNKNOWN + 1)
    states, _ = vector_map_states(VectorMap(hidden.lattice, edges, np.zeros(4, np.uint8)))
    assert states.shape == (3, 3)
    assert (states == OCCUPIED).all()


def test_a_two_sided_wall_blocks_half_a_cell_on_each_side_of_free_space():
    room = [(0, 0, 0, 100, FREE, UNKNOWN, 0, 0), (0, 0, 100, 0, UNKNOWN, FREE, 0, 0),
            (0, 100, 100, 100, FREE, UNKNOWN, 0, 0), (100, 0, 100, 100, UNKNOWN, FREE, 0, 0)]  # fmt: skip
    wall = (50, 20, 50, 80, FREE, FREE, 1, 70)
    states, low_yx = merged_states(np.array(sorted([*room, wall]), np.int32), 10)
    assert low_yx == (0, 0)
    assert (states[4:6, 2:8] == OCCUPIED).all()
    assert (states == OCCUPIED).sum() == 12


def test_too_large_an_extent_is_refused_before_memory_is_taken():
    edges = np.array([(-(1 << 20), 0, 1 << 20, 1 << 20, FREE, OCCUPIED, 1, 0)], np.int32)
    with pytest.raises(MapFormatError, match="extent"):
        merged_states(edges, 1)


def test_exact_at_the_bounds_of_the_coordinates():
    far = 1 << 20
    rows = [(-far, -far, far, far, FREE, OCCUPIED, 1, 200)]
    step = 1 << 15
    states, low_yx = merged_states(np.array(rows, np.int32), step)
    assert np.array_equal(states, slow_states(rows, step, low_yx, states.shape))


def test_an_empty_map_is_one_unknown_cell():
    assert MergedMap(np.zeros((0, 8), np.int32)).to_grid().cells_yx.tolist() == [[-1]]
