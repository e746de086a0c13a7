"""Placing is exact but for stated roundings, at the bounds too; the kernels agree with rational arithmetic there."""

from fractions import Fraction
from math import floor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetmap.merge.arrange import arrange, lower_end_first, unique_edges, unique_points
from fleetmap.merge.origin import MAX_REACH
from fleetmap.merge.place import MAX_LENGTH, Placed, is_closed, pair_cell, split_long, to_fleet
from fleetmap.merge.tiles import tiles_of_edges
from fleetmap.merge.verify_planar import check_crossings
from fleetmap.model.lattice import MAX_COORDINATE, Lattice
from fleetmap.model.mergedmap import FLEET_UM
from fleetmap.model.pose import Q30, FixedPose, Pose2

HALF = Fraction(1, 2)
some = settings(max_examples=60, deadline=None)
yaws = st.floats(-3.2, 3.2) | st.sampled_from([0.0, np.pi / 2, np.pi, -np.pi / 2])


@some
@given(
    st.integers(-(2**40), 2**40),
    st.integers(-(2**40), 2**40),
    yaws,
    st.integers(100, 10_000_000) | st.sampled_from([100, 10_000_000]),
    st.lists(st.tuples(*[st.sampled_from([-MAX_COORDINATE, MAX_COORDINATE, 0, 77_777])] * 2), min_size=1, max_size=4),
)
def test_points_are_placed_to_half_a_step_at_every_bound(x_um, y_um, yaw, resolution_um, points):
    rotation = FixedPose.from_pose(Pose2(0.0, 0.0, yaw))
    pose = FixedPose(x_um, y_um, rotation.cos_q30, rotation.sin_q30)
    placed = to_fleet(pose, Lattice(resolution_um), np.array(points, np.int64))
    for (y, x), (got_y, got_x) in zip(points, placed.tolist(), strict=True):
        c, s = Fraction(pose.cos_q30, Q30), Fraction(pose.sin_q30, Q30)
        exact_x = (x_um + (c * x - s * y) * resolution_um) / FLEET_UM
        exact_y = (y_um + (s * x + c * y) * resolution_um) / FLEET_UM
        assert abs(exact_x - got_x) <= HALF + Fraction(1, 500)
        assert abs(exact_y - got_y) <= HALF + Fraction(1, 500)


ends = st.tuples(*[st.integers(-(1 << 18), 1 << 18)] * 4).filter(lambda e: e[:2] != e[2:])


@some
@given(ends)
def test_a_long_edge_is_cut_alike_in_both_directions(edge):
    there = split_long(np.array([[*edge, 7]], np.int64))
    back = split_long(np.array([[*edge[2:], *edge[:2], 7]], np.int64))
    assert there[:, :4].tolist() == back[::-1][:, [2, 3, 0, 1]].tolist()
    assert np.abs(there[:, 2:4] - there[:, :2]).max() <= MAX_LENGTH
    assert (there[:, 4] == 7).all()
    assert is_closed(np.concatenate([there[:, :4], [[*edge[2:], *edge[:2]]]]))


def test_cells_of_a_pair_are_the_coarser_ones_but_at_most_twice_the_finer():
    assert pair_cell(10, 10) == 10
    assert pair_cell(10, 15) == pair_cell(15, 10) == 15
    assert pair_cell(10, 2000) == 20


def in_pixel(a, b, p):
    """Whether the segment a to b meets [p - 1/2, p + 1/2) x [..), by clipping it in fractions."""
    low, high = (Fraction(0), True), (Fraction(1), True)
    for k in range(2):
        d = b[k] - a[k]
        if d == 0:
            if a[k] != p[k]:
                return False
            continue
        enter, leave = Fraction(2 * (p[k] - a[k]) - 1, 2 * d), Fraction(2 * (p[k] - a[k]) + 1, 2 * d)
        bounds = ((enter, True), (leave, False)) if d > 0 else ((leave, False), (enter, True))
        low = max(low, bounds[0], key=lambda t: (t[0], not t[1]))
        high = min(high, bounds[1], key=lambda t: (t[0], t[1]))
    return low[0] < high[0] or (low[0] == high[0] and low[1] and high[1])


@settings(max_examples=300, deadline=None)
@given(*[st.integers(-6, 6)] * 6)
def test_pixels_are_half_open_and_exact(ay, ax, by, bx, py, px):
    from fleetmap.merge.arrange_kernels import meets_pixel

    if (ay, ax) != (by, bx):
        assert meets_pixel(ay, ax, by, bx, py, px) == in_pixel((ay, ax), (by, bx), (py, px))


corner = st.sampled_from([-1, 1])
far_points = st.tuples(st.integers(0, MAX_LENGTH), st.integers(0, MAX_LENGTH)) | st.tuples(
    st.sampled_from([0, 1, MAX_LENGTH - 1, MAX_LENGTH]), st.sampled_from([0, 1, MAX_LENGTH - 1, MAX_LENGTH])
)


@settings(max_examples=200, deadline=None)
@given(st.lists(far_points, min_size=4, max_size=4), corner, corner)
def test_crossings_are_exact_at_the_largest_lengths_and_coordinates(points, sign_y, sign_x):
    from fleetmap.merge.arrange_kernels import crossings

    far = np.array([sign_y, sign_x]) * (MAX_REACH - MAX_LENGTH)
    a, b, c, d = (tuple(int(v) for v in np.array(p) * (sign_y, sign_x) + far) for p in points)
    if a == b or c == d:
        return
    lines = lower_end_first(np.array([[*a, *b], [*c, *d]], np.int64))[0]
    got = {tuple(p) for p in crossings(lines, *tiles_of_edges(lines)).tolist()}

    den = (b[1] - a[1]) * (d[0] - c[0]) - (b[0] - a[0]) * (d[1] - c[1])
    expected = set()
    if den != 0:
        t = Fraction((c[1] - a[1]) * (d[0] - c[0]) - (c[0] - a[0]) * (d[1] - c[1]), den)
        u = Fraction((c[1] - a[1]) * (b[0] - a[0]) - (c[0] - a[0]) * (b[1] - a[1]), den)
        if 0 < t < 1 and 0 < u < 1:
            expected = {tuple(floor(a[k] + t * (b[k] - a[k]) + HALF) for k in range(2))}
    assert got == expected


scales = st.sampled_from([1, 17, 32, 101])
"""All in one tile of the fold, in several, corners on the borders of tiles, far more tiles than edges."""


def placed(rows):
    rows = np.array(rows, np.int64).reshape(-1, 4)
    rows = rows[(rows[:, :2] != rows[:, 2:]).any(axis=1)]
    one = np.ones(len(rows), np.int64)
    return Placed(rows, one, one, one, 10, 50_000)


@settings(max_examples=100, deadline=None)
@given(
    st.lists(st.tuples(*[st.integers(0, 25)] * 4), min_size=1, max_size=25).filter(
        lambda rows: any(r[:2] != r[2:] for r in rows)
    ),
    scales,
)
def test_pieces_of_the_arrangement_meet_only_at_vertices(rows, scale):
    source = placed(np.array(rows) * scale - 8 * scale)
    pieces = arrange([source]).ends
    assert list(check_crossings([tuple(r) for r in pieces.tolist()])) == []
    # Every vertex that was there still is, and nothing lies farther off than a pixel reaches.
    before, after = unique_points(source.ends.reshape(-1, 2)), unique_points(pieces.reshape(-1, 2))
    assert set(map(tuple, before.tolist())) <= set(map(tuple, after.tolist()))


@settings(max_examples=60, deadline=None)
@given(st.lists(st.lists(st.tuples(*[st.integers(0, 15)] * 2), min_size=3, max_size=6), min_size=1, max_size=3), scales)
def test_windings_are_kept_and_free_sides_are_those_of_a_brute_force_ray(polygons, scale):
    from fleetmap.merge.faces import side_states

    sources = []
    for polygon in polygons:
        corners = [(y * scale - 5 * scale, x * scale - 9 * scale) for y, x in polygon]
        source = placed([[*a, *b] for a, b in zip(corners, corners[1:] + corners[:1], strict=True)])
        if len(source.ends):
            sources.append(source)
    if not sources:
        return
    arrangement = arrange(sources)
    left, right = side_states(arrangement)
    for k in range(len(sources)):  # the pieces of each source still form cycles
        rows = [[*(e if w > 0 else (*e[2:], *e[:2]))] for e, w in piece_windings(arrangement, k) for _ in range(abs(w))]
        assert is_closed(np.array(rows, np.int64).reshape(-1, 4))
    for i, piece in enumerate(arrangement.ends.tolist()):
        for side, state in ((1, left[i]), (-1, right[i])):
            at = beside(piece, side)
            free = any(
                sum(w * crosses(e, at) for e, w in piece_windings(arrangement, k)) > 0 for k in range(len(sources))
            )
            assert (state == 0) == free


def piece_windings(arrangement, source):
    """Pieces of one source with their winding, as Python numbers."""
    for i, ends_ in enumerate(arrangement.ends.tolist()):
        for q in range(arrangement.first[i], arrangement.first[i + 1]):
            if arrangement.source[q] == source:
                yield tuple(ends_), int(arrangement.winding[q])


def beside(piece, side):
    """A point very close to the middle of a piece, on its left (1) or right (-1)."""
    y0, x0, y1, x1 = piece
    tiny = Fraction(side, 10**6)
    return Fraction(y0 + y1, 2) + tiny * (x1 - x0), Fraction(x0 + x1, 2) - tiny * (y1 - y0)


def crosses(piece, at):
    """By how much the winding number grows along a ray from -x to ``at`` where it crosses a piece of winding 1."""
    y0, x0, y1, x1 = piece
    y, x = at
    if not y0 <= y < y1:
        return 0
    return -1 if x0 + Fraction(x1 - x0, y1 - y0) * (y - y0) < x else 0


def test_unique_edges_ascend_and_say_where_each_went():
    rows = np.array([[3, 1, 4, -5], [-2, 7, 0, 0], [3, 1, 4, -5]], np.int64)
    once, index = unique_edges(rows)
    assert once.tolist() == [[-2, 7, 0, 0], [3, 1, 4, -5]]
    assert index.tolist() == [1, 0, 1]


@pytest.mark.parametrize("reach", [1, 30, 6000])
def test_distances_to_a_segment_are_exact_at_the_bounds(reach):
    from fleetmap.merge.select_kernels import within

    rng = np.random.default_rng(reach)
    hits = 0
    for _ in range(300):
        ay, ax = (int(v) for v in rng.integers(-MAX_REACH, MAX_REACH - MAX_LENGTH, 2))
        by, bx = ay + int(rng.integers(0, MAX_LENGTH + 1)), ax + int(rng.integers(0, MAX_LENGTH + 1))
        t, off = rng.uniform(-0.1, 1.1), rng.integers(-2 * reach, 2 * reach + 1, 2)
        py, px = int(ay + t * (by - ay)) + int(off[0]), int(ax + t * (bx - ax)) + int(off[1])
        length2 = (by - ay) ** 2 + (bx - ax) ** 2
        along = (by - ay) * (py - ay) + (bx - ax) * (px - ax)
        at = min(max(Fraction(along, max(1, length2)), Fraction(0)), Fraction(1))
        distance2 = (py - ay - at * (by - ay)) ** 2 + (px - ax - at * (bx - ax)) ** 2
        assert within(py, px, ay, ax, by, bx, reach) == (distance2 <= reach * reach)
        hits += distance2 <= reach * reach
    assert 20 < hits < 280
