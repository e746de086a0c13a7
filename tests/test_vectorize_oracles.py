"""The oracles of how few edges there could be, against brute force, and their raw maps against the verifier."""

import importlib.util
import sys
from fractions import Fraction
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import FREE, UNKNOWN, Lattice
from fleetmap.vectorize.verify import verify

SCRIPT = Path(__file__).parent.parent / "benchmarks" / "vectorize_oracles.py"
SPEC = importlib.util.spec_from_file_location("vectorize_oracles", SCRIPT)
oracles = importlib.util.module_from_spec(SPEC)
sys.modules["vectorize_oracles"] = oracles  # dataclasses look their module up
SPEC.loader.exec_module(oracles)

PROFILES = ("share", "full", "exact")
EXACT = 63**0.5 / 16


def random_states(seed, most=14):
    """Blobs of the three states, with some noise or much."""
    rng = np.random.default_rng(seed)
    height, width = rng.integers(1, most + 1, 2)
    k = rng.integers(1, 5)
    blobs = rng.choice(3, size=(height // k + 1, width // k + 1), p=rng.dirichlet([1, 1, 1]))
    states = np.kron(blobs, np.ones((k, k), int))[:height, :width]
    noise = rng.random(states.shape) < rng.choice([0, 0.1, 0.4])
    return np.where(noise, rng.integers(0, 3, states.shape), states).astype(np.uint8)


def near(point, a, b, epsilon2):
    """Whether a point is within epsilon (squared, in cells) of segment ab, in rationals."""
    (py, px), (ay, ax), (by, bx) = point.tolist(), a.tolist(), b.tolist()
    dy, dx = by - ay, bx - ax
    length2 = dy * dy + dx * dx
    t = min(max(Fraction((py - ay) * dy + (px - ax) * dx, length2), 0), 1) if length2 else 0
    return (py - ay - t * dy) ** 2 + (px - ax - t * dx) ** 2 <= epsilon2


def fewest_by_trying(arc, epsilon2):
    """All subsets of the arc's points as vertices, the small ones first."""
    n = len(arc.points)

    def holds(i, j):
        a, b = arc.points[i % n], arc.points[j % n]
        between = [arc.points[k % n] for k in range(i + 1, j)]
        return (a != b).any() and all(near(p, a, b, epsilon2) for p in between)

    if arc.closed:
        for count in range(3, n + 1):
            for at in combinations(range(n), count):
                if all(holds(i, j) for i, j in zip(at, [*at[1:], at[0] + n], strict=True)):
                    return count
    least = 3 if (arc.points[0] == arc.points[-1]).all() else 1
    for count in range(least, n):
        for inner in combinations(range(1, n - 1), count - 1):
            at = [0, *inner, n - 1]
            if all(holds(i, j) for i, j in zip(at[:-1], at[1:], strict=True)):
                return count
    raise AssertionError("the arc itself would do")


@given(st.integers(0, 10**6), st.sampled_from(PROFILES), st.sampled_from([63, 256, 512]))
def test_no_subset_of_points_is_smaller_than_the_fewest_edges(seed, profile, epsilon2):
    arcs = [arc for arc in oracles.trace(random_states(seed, 6), profile) if len(arc.points) <= 13]
    for arc in arcs[:6]:
        assert oracles.fewest_edges(arc, epsilon2) == fewest_by_trying(arc, Fraction(epsilon2, 256))


@given(st.integers(0, 10**6), st.sampled_from(PROFILES), st.sampled_from([63, 512, 256 * 9]))
def test_lines_are_never_more_than_the_fewest_edges(seed, profile, epsilon2):
    for arc in oracles.trace(random_states(seed), profile):
        assert 1 <= oracles.fewest_lines(arc, epsilon2) <= oracles.fewest_edges(arc, epsilon2)


@given(st.integers(0, 10**6), st.sampled_from([63, 512]))
def test_no_direction_makes_a_strip_hold_more_points(seed, epsilon2):
    """The end of a strip, found with the hull, against the width in many directions."""
    angles = np.arange(720) * np.pi / 720
    across = np.stack([np.sin(angles), np.cos(angles)])
    for arc in oracles.trace(random_states(seed, 20), "full")[:4]:
        end = oracles._strip_end(arc.points, 0, len(arc.points), epsilon2)
        spread = np.ptp(arc.points[: end + 2] @ across, axis=0).min()
        if end + 1 < len(arc.points):
            assert spread > 2 * (epsilon2 / 256) ** 0.5 - 1e-9
        inside = np.ptp(arc.points[: end + 1] @ across, axis=0).min()
        assert inside <= 2 * (epsilon2 / 256) ** 0.5 * 1.02 + 0.01 * end


@given(st.integers(0, 10**6), st.sampled_from(PROFILES))
def test_arcs_run_once_along_each_unit_of_the_boundary(seed, profile):
    states = random_states(seed)
    padded = np.pad(states, 1, constant_values=UNKNOWN).astype(int)
    expected = set()
    for axis in (0, 1):
        low, high = (padded[:-1], padded[1:]) if axis == 0 else (padded[:, :-1], padded[:, 1:])
        meets = (low == FREE) != (high == FREE) if profile == "share" else low != high
        for i, j in np.argwhere(meets).tolist():
            a, b = ((i, j - 1), (i, j)) if axis == 0 else ((i - 1, j), (i, j))
            left, right = (high[i, j], low[i, j]) if axis == 0 else (low[i, j], high[i, j])
            expected.add((a, b, 3 * left + right))
    found = []
    for arc in oracles.trace(states, profile):
        points = np.concatenate([arc.points, arc.points[:1]]) if arc.closed else arc.points
        for a, b in zip(map(tuple, points[:-1].tolist()), map(tuple, points[1:].tolist()), strict=True):
            swapped = 3 * (arc.label % 3) + arc.label // 3
            found.append((a, b, arc.label) if a < b else (b, a, swapped))
    assert len(found) == len(set(found))
    assert set(found) == expected


@given(st.integers(0, 10**6), st.sampled_from(PROFILES), st.sampled_from([0, 12]))
def test_the_boundary_with_an_edge_from_corner_to_corner_is_valid(seed, profile, specks):
    states = random_states(seed)
    vector_map = oracles.corner_map(states, Lattice(50_000), profile, EXACT if profile == "exact" else 2**0.5)
    assert verify(OccupancyGrid.from_states(states, 0.05), vector_map, specks=specks).violations == ()


@pytest.mark.parametrize(
    ("rows", "share", "full"),
    [
        (["#.", ".#"], 4, 6),  # two free cells apart, and the occupied ones join
        (["?.", ".?"], 1, 1),  # the free cells meet at the corner
        (["#?", "?#"], 0, 1),  # so do the occupied ones
        (["#.", "?#"], 2, 3),
        ([".#", "?."], 4, 5),  # three states around free cells: all end at the node
    ],
)
def test_how_arcs_pass_a_point_where_four_meet(rows, share, full):
    states = np.array([[".#?".index(c) for c in row] for row in reversed(rows)], np.uint8)
    assert len(oracles.trace(states, "share")) == share
    assert len(oracles.trace(states, "full")) == full
