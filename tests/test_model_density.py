"""What one name may add: edges in all, and in a square of 256 cells."""

import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleetmap.model.density import MAX_EDGES, MAX_EDGES_IN_SQUARE, Density, check_density, density
from fleetmap.model.errors import MapWarning
from fleetmap.model.lattice import Lattice
from fleetmap.model.map_server import load_map
from fleetmap.model.vectormap import VectorMap
from fleetmap.vectorize import vectorize


def of_rows(rows):
    return VectorMap(Lattice(50_000), np.array(rows, np.int32).reshape(-1, 5), np.zeros(len(rows), np.uint8))


near_borders = st.sampled_from([-513, -512, -257, -256, -1, 0, 255, 256, 511, 512])


@given(st.lists(st.tuples(near_borders, near_borders, st.integers(1, 900), st.integers(-900, 900)), max_size=60))
def test_an_edge_counts_in_the_square_of_its_lower_end_alone(edges):
    vector_map = of_rows([(y, x, y + dy, x + dx, 1) for y, x, dy, dx in edges])
    counts = {}
    for y, x, *_ in vector_map.edges.tolist():
        counts[y // 256, x // 256] = counts.get((y // 256, x // 256), 0) + 1
    found = density(vector_map)
    assert (found.total, found.in_square) == (len(vector_map), max(counts.values(), default=0))
    if counts:
        assert (found.y // 256, found.x // 256) == min(k for k, n in counts.items() if n == found.in_square)


def test_the_bounds_are_met_exactly_and_the_reason_names_the_place():
    rows = [(-3, 600 + i, -2, 600 + i, 1) for i in range(10)] + [(700, 0, 701, 0, 1)]
    vector_map = of_rows(rows)
    assert density(vector_map) == Density(11, 10, -256, 512)
    assert check_density(vector_map, max_edges=11, max_edges_in_square=10) is None
    assert check_density(vector_map, max_edges=10, max_edges_in_square=10) == "edges: 11; at most 10 in one map"
    reason = check_density(vector_map, max_edges=11, max_edges_in_square=9)
    assert reason == "edges: 10 in the 256 x 256 cells from x = 512, y = -256 on; at most 9"
    assert check_density(VectorMap.empty(Lattice(50_000)), max_edges=0, max_edges_in_square=0) is None


@pytest.mark.data
@pytest.mark.parametrize("profile", ["share", "full"])
def test_real_maps_are_four_times_below_the_bounds(real_map, profile):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MapWarning)
        found = density(vectorize(load_map(real_map), profile=profile))
    assert 4 * found.total < MAX_EDGES
    assert 4 * found.in_square < MAX_EDGES_IN_SQUARE
