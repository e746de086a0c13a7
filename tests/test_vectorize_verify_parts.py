"""The parts of the verifier, each against a slow twin: what is covered, what crosses, what lies around a face."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN
from fleetmap.vectorize.verify_cover import UNIT, Root, compare_roots, exact_gap, find_touched_owners, first_gaps
from fleetmap.vectorize.verify_faces import find_crossings, find_faces, find_states
from fleetmap.vectorize.verify_near_kernels import is_near

# --- the cover test

coordinates = st.integers(-3 * UNIT, 3 * UNIT)
segments_lists = st.lists(st.tuples(*[coordinates] * 4), min_size=0, max_size=8)
coarse = st.integers(-4, 4).map(lambda cells: cells * UNIT)
coarse_lists = st.lists(st.tuples(*[coarse] * 4), min_size=0, max_size=8)
PLACE = 0.005 * UNIT  # how precisely a gap's place is told
epsilons2 = st.sampled_from([Fraction(2), Fraction(1), Fraction(1, 2), Fraction(5, 4), Fraction(25, 16)])


def rows(segments: list[tuple[int, int, int, int]]) -> np.ndarray:
    return np.array(segments, np.int64).reshape(-1, 4)


def distance2_to(y: Fraction, x: Fraction, other: tuple[int, int, int, int]) -> Fraction:
    ay, ax, by, bx = other
    ey, ex = by - ay, bx - ax
    e2 = ey * ey + ex * ex
    t = max(Fraction(0), min(Fraction(1), ((y - ay) * ey + (x - ax) * ex) / e2)) if e2 else Fraction(0)
    return (y - ay - t * ey) ** 2 + (x - ax - t * ex) ** 2


@given(st.one_of(segments_lists, coarse_lists), st.one_of(segments_lists, coarse_lists), epsilons2)
def test_gaps_agree_with_distances_of_many_points(
    segments: list[tuple[int, int, int, int]], others: list[tuple[int, int, int, int]], epsilon2: Fraction
) -> None:
    gaps = first_gaps(rows(segments), rows(others), epsilon2)
    for (y0, x0, y1, x1), gap in zip(segments, gaps.tolist(), strict=True):
        for t in [Fraction(k, 48) for k in range(49)]:
            y, x = y0 + t * (y1 - y0), x0 + t * (x1 - x0)
            near = any(distance2_to(y, x, other) <= epsilon2 * UNIT**2 for other in others)
            if math.isnan(gap) or (gap - float(t)) * math.hypot(y1 - y0, x1 - x0) > PLACE:
                assert near
        if not math.isnan(gap):
            y, x = (a + Fraction(gap) * (b - a) for a, b in ((y0, y1), (x0, x1)))
            least = min((float(distance2_to(y, x, other)) for other in others), default=math.inf)
            assert least > float(epsilon2) * UNIT**2 * (1 - 1e-4)


@given(st.one_of(segments_lists, coarse_lists), st.one_of(segments_lists, coarse_lists), epsilons2)
def test_floats_and_rationals_find_the_same_gaps(
    segments: list[tuple[int, int, int, int]], others: list[tuple[int, int, int, int]], epsilon2: Fraction
) -> None:
    gaps = first_gaps(rows(segments), rows(others), epsilon2)
    exact = [exact_gap(list(s), [list(o) for o in others], epsilon2 * UNIT**2) for s in segments]
    assert np.isnan(gaps).tolist() == [math.isnan(gap) for gap in exact]
    lengths = [math.hypot(y1 - y0, x1 - x0) for y0, x0, y1, x1 in segments]
    np.testing.assert_allclose(gaps * lengths, np.multiply(exact, lengths), atol=PLACE)


def test_a_segment_covered_by_two_that_just_touch_is_covered() -> None:
    # Discs of radius 1 around (0, 0) and (0, 2): they share the point (0, 1) alone.
    points = rows([(0, 0, 0, 0), (0, 2 * UNIT, 0, 2 * UNIT)])
    segment = rows([(0, 0, 0, 2 * UNIT)])
    assert np.isnan(first_gaps(segment, points, Fraction(1))).all()
    assert first_gaps(segment, points, Fraction(10**9 - 1, 10**9)) == pytest.approx(0.5, abs=1e-3)
    apart = points + np.array([[0, 0, 0, 0], [0, 1, 0, 1]])
    assert first_gaps(segment, apart, Fraction(1)) == pytest.approx(0.5, abs=1e-3)


def test_a_parallel_at_exactly_epsilon_covers() -> None:
    diagonal = rows([(0, 0, 900 * UNIT, 900 * UNIT)])
    beside = diagonal + np.array([-UNIT, UNIT, -UNIT, UNIT])
    ends_too = np.concatenate([beside, rows([(0, 0, 0, 0), (900 * UNIT, 900 * UNIT, 900 * UNIT, 900 * UNIT)])])
    assert np.isnan(first_gaps(diagonal, ends_too, Fraction(2))).all()
    assert not np.isnan(first_gaps(diagonal, ends_too, Fraction(2) - Fraction(1, 2**40))).any()


big = st.integers(-(2**25), 2**25)
radii2 = st.sampled_from([1024 * 2048, 63 * 4 * 1024, 1024 * 1024, 2**32, 3_000_001])


def is_near_by_fractions(point: tuple[int, int], segment: tuple[int, int, int, int], radius2: int) -> bool:
    return distance2_to(Fraction(point[0]), Fraction(point[1]), segment) <= Fraction(radius2, 1024)


@given(st.tuples(big, big, big, big), st.fractions(0, 1), st.integers(-70, 70), st.integers(-70, 70), radii2)
def test_points_near_the_longest_segments_are_told_apart_exactly(
    segment: tuple[int, int, int, int], t: Fraction, dy: int, dx: int, radius2: int
) -> None:
    point = tuple(int(a + t * (b - a)) + d for a, b, d in zip(segment[:2], segment[2:], (dy, dx), strict=True))
    assert is_near(*point, *segment, radius2) == is_near_by_fractions(point, segment, radius2)


def test_the_longest_segment_at_exactly_the_radius() -> None:
    n = 2**24
    for radius2 in (2 * 32**2 * 1024, 2 * 32**2 * 1024 - 1):
        assert is_near(32, -32, -n, -n, n, n, radius2) == (radius2 == 2 * 32**2 * 1024)


@given(st.one_of(segments_lists, coarse_lists), st.one_of(segments_lists, coarse_lists), epsilons2)
def test_owners_are_touched_where_a_distance_says_so(
    segments: list[tuple[int, int, int, int]], others: list[tuple[int, int, int, int]], epsilon2: Fraction
) -> None:
    import shapely

    owners = np.arange(len(segments)) // 2
    touched = find_touched_owners(rows(segments), owners, len(segments), rows(others), epsilon2)
    for owner in range(len(segments)):
        mine = segments[2 * owner : 2 * owner + 2]
        ends = [((a[0], a[1]), b) for a in mine for b in others] + [((a[2], a[3]), b) for a in mine for b in others]
        ends += [((b[0], b[1]), a) for a in mine for b in others] + [((b[2], b[3]), a) for a in mine for b in others]
        near = any(distance2_to(Fraction(y), Fraction(x), other) <= epsilon2 * UNIT**2 for (y, x), other in ends)
        lines = [[shapely.LineString([s[:2], s[2:]]) for s in group] for group in (mine, others)]
        assert touched[owner] == (near or any(a.crosses(b) for a in lines[0] for b in lines[1]))


fractions = st.fractions(min_value=-5, max_value=5, max_denominator=6)
roots = st.builds(
    Root, fractions, st.sampled_from([-1, 0, 1]), st.fractions(min_value=0, max_value=9, max_denominator=4)
)


@given(roots, roots)
def test_roots_compare_as_their_values_do(x: Root, y: Root) -> None:
    x, y = (Root(r.q, r.sign, r.k if r.sign else Fraction(0)) for r in (x, y))
    assert compare_roots(x, y) == -compare_roots(y, x)
    assert compare_roots(x, x) == 0
    if abs(x.approx() - y.approx()) > 1e-9:
        assert compare_roots(x, y) == (1 if x.approx() > y.approx() else -1)


def test_equal_roots_of_different_form_are_equal() -> None:
    assert compare_roots(Root(Fraction(1), 1, Fraction(4)), Root(Fraction(3))) == 0
    assert compare_roots(Root(Fraction(-1), 1, Fraction(8)), Root(Fraction(-1, 1), 1, Fraction(8))) == 0
    # sqrt(8) - sqrt(2) = sqrt(2)
    assert compare_roots(Root(Fraction(0), 1, Fraction(8)), Root(Fraction(0), -1, Fraction(2))) == 1
    tiny = Fraction(1, 10**30)
    assert compare_roots(Root(Fraction(1), 1, Fraction(2) + tiny), Root(Fraction(1), 1, Fraction(2))) == 1


# --- crossings and faces


@given(st.lists(st.tuples(*[st.integers(0, 4)] * 4), min_size=1, max_size=7))
def test_crossings_agree_with_shapely(segments: list[tuple[int, int, int, int]]) -> None:
    import shapely

    proper = rows([min(s, (*s[2:], *s[:2])) for s in segments if s[:2] != s[2:]])
    lines = [shapely.LineString([a, b]) for a, b in proper.reshape(-1, 2, 2)]
    expected = set()
    for i, p in enumerate(lines):
        for j, q in enumerate(lines[:i]):
            common = p.intersection(q)
            ends = {tuple(c) for c in p.coords} & {tuple(c) for c in q.coords}
            at_end = common.geom_type == "Point" and (common.x, common.y) in ends
            if not (common.is_empty or at_end):
                expected.add((j, i))
    assert set(map(tuple, find_crossings(proper).tolist())) == expected


def square(y: int, x: int, size: int, inner: int, outer: int) -> list[tuple[int, int, int, int, int]]:
    """Four edges, canonical, with a state inside and one outside."""
    right, left = 3 * outer + inner, 3 * inner + outer
    return [
        (y, x, y, x + size, left),
        (y, x, y + size, x, right),
        (y, x + size, y + size, x + size, left),
        (y + size, x, y + size, x + size, right),
    ]


@given(
    st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3), st.integers(0, 2)), max_size=12, unique_by=lambda s: s[:2])
)
def test_squares_beside_and_inside_each_other_have_the_faces_that_euler_counts(
    squares: list[tuple[int, int, int]],
) -> None:
    """Each place holds a square, some with another one in it, and some touch at their corners."""
    import networkx as nx

    edges = []
    for row, column, kind in squares:
        y, x, size = (8 * row, 8 * column, 8) if (row + column) % 2 else (8 * row + 1, 8 * column + 1, 6)
        edges += square(y, x, size, FREE, UNKNOWN)
        if kind:
            edges += square(y + 2, x + 2, 2, OCCUPIED, FREE)
    array = np.array(sorted(edges), np.int64).reshape(-1, 5)
    faces = find_faces(array[:, :4])
    graph = nx.Graph([((y0, x0), (y1, x1)) for y0, x0, y1, x1, _ in edges])
    parts = nx.number_connected_components(graph)
    assert faces.count == len(edges) - graph.number_of_nodes() + parts + 1  # Euler
    states, odd = find_states(faces, array[:, 4] // 3, array[:, 4] % 3)
    assert odd == []
    assert states[faces.outside] == UNKNOWN
    assert (states[faces.left] == array[:, 4] // 3).all()
    assert (states[faces.right] == array[:, 4] % 3).all()


def test_an_edge_that_says_something_else_is_named() -> None:
    edges = np.array(square(0, 0, 5, FREE, UNKNOWN), np.int64)
    edges[2, 4] = 3 * OCCUPIED + UNKNOWN
    _, odd = find_states(find_faces(edges[:, :4]), edges[:, 4] // 3, edges[:, 4] % 3)
    assert odd == [(2, "edges disagree about one face: 3 free, 1 occupied")]
    edges[2, 4] = 3 * FREE + OCCUPIED
    _, odd = find_states(find_faces(edges[:, :4]), edges[:, 4] // 3, edges[:, 4] % 3)
    assert odd[0][1] == "edges disagree about the unbounded face, which is unknown: 1 occupied, 3 unknown"
