import math
import os
import warnings
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fleetmap.model.errors import ConfigError, MapWarning
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN, Lattice
from fleetmap.model.map_server import load_map
from fleetmap.model.pose import FixedPose, Pose2
from fleetmap.model.vectormap import VectorMap, make_label
from fleetmap.vectorize.verify import VerifyReport, verify
from fleetmap.vectorize.verify_cover import UNIT, Root, compare_roots, exact_gap, first_gaps
from fleetmap.vectorize.verify_faces import find_crossings, find_faces

LATTICE = Lattice(50_000)
WALL, WALL_RIGHT = make_label(FREE, OCCUPIED), make_label(OCCUPIED, FREE)
FRONTIER = make_label(FREE, UNKNOWN)


def grid(rows: list[str], *, x_cells: float = 0.0, y_cells: float = 0.0) -> OccupancyGrid:
    """Rows from the top down: '#' occupied, '.' free, '?' unknown."""
    states = np.array([[".#?".index(c) for c in row] for row in reversed(rows)], np.uint8)
    return OccupancyGrid.from_states(states, 0.05, Pose2(x_cells * 0.05, y_cells * 0.05))


def vector_map(edges: list[tuple[int, int, int, int, int]], lattice: Lattice = LATTICE) -> VectorMap:
    rows = np.array(edges, np.int32).reshape(-1, 5)
    return VectorMap(lattice, rows, np.zeros(len(rows), np.uint8))


def raw_cracks(source: OccupancyGrid) -> VectorMap:
    """Every unit of boundary between a free cell and another one as an edge of its own, by a plain loop."""
    states = np.pad(source.states_yx(), 1, constant_values=UNKNOWN).tolist()
    edges = []
    for i, row in enumerate(states):
        for j, state in enumerate(row):
            above = states[i + 1][j] if i + 1 < len(states) else UNKNOWN
            right = row[j + 1] if j + 1 < len(row) else UNKNOWN
            if state != above and FREE in (state, above):
                edges.append((i, j - 1, i, j, make_label(above, state)))
            if state != right and FREE in (state, right):
                edges.append((i - 1, j, i, j, make_label(state, right)))
    lattice = Lattice(round(source.resolution_m * 1e6), FixedPose.from_pose(source.origin))
    return vector_map(edges, lattice)


def polygon(corners_yx: list[tuple[int, int]], label: int) -> list[tuple[int, int, int, int, int]]:
    """Edges around corners, given with ``label`` as seen while going around."""
    closed = [*corners_yx, corners_yx[0]]
    return [(*a, *b, label) for a, b in pairwise(closed)]


def kinds(report: VerifyReport) -> set[str]:
    return {violation.kind for violation in report.violations}


ROOM = grid(["##########", *["#........#"] * 8, "##########"])
ROOM_CORNERS = [(1, 1), (1, 9), (9, 9), (9, 1)]

grids = st.tuples(st.integers(1, 12), st.integers(1, 12)).flatmap(
    lambda shape: arrays(np.uint8, shape, elements=st.sampled_from([FREE, FREE, OCCUPIED, UNKNOWN]))
)
walled_grids = grids.map(lambda states: np.where(states == UNKNOWN, OCCUPIED, states).astype(np.uint8))


# --- whole maps


def test_a_room_drawn_along_its_walls_is_valid() -> None:
    report = verify(ROOM, vector_map(polygon(ROOM_CORNERS, WALL)))
    assert report.valid
    assert (report.dropped.count, report.dropped.cells, report.dropped.area_m2) == (0, 0, 0)


@settings(deadline=None)
@given(grids, st.sampled_from([0, 1, 12]))
def test_the_raw_boundary_is_valid(states: np.ndarray, specks: int) -> None:
    source = OccupancyGrid.from_states(states, 0.05, Pose2(1.0, -2.0, 0.3))
    report = verify(source, raw_cracks(source), specks=specks)
    assert report.violations == ()
    assert report.dropped.count == 0


@settings(deadline=None)
@given(st.one_of(grids, walled_grids), st.data())
def test_the_raw_boundary_without_one_component_is_not_valid(states: np.ndarray, data: st.DataObject) -> None:
    from scipy.ndimage import label

    rimmed = np.pad(states, 1, constant_values=UNKNOWN)
    labels, count = label(rimmed == FREE)
    if count == 0:
        return
    gone = data.draw(st.integers(1, count))
    # Those that meet at a corner without a wall may share a face, which leaves another one to spare.
    is_open = rimmed != OCCUPIED
    for a, b, others in (
        (labels[:-1, :-1], labels[1:, 1:], is_open[1:, :-1] & is_open[:-1, 1:]),
        (labels[:-1, 1:], labels[1:, :-1], is_open[:-1, :-1] & is_open[1:, 1:]),
    ):
        if (others & (a != b) & (a > 0) & (b > 0)).any():
            return
    without = np.where(labels == gone, UNKNOWN, rimmed).astype(np.uint8)[1:-1, 1:-1]
    source, lacking = (OccupancyGrid.from_states(cells, 0.05) for cells in (states, without))
    report = verify(source, raw_cracks(lacking), specks=0)
    assert ("components" if count > 1 else "uncovered") in kinds(report)


def test_an_empty_map_of_a_grid_without_free_cells_is_valid() -> None:
    assert verify(grid(["#?", "?#"]), vector_map([])).valid


def test_an_empty_map_of_a_room_is_not() -> None:
    assert kinds(verify(ROOM, vector_map([]))) == {"uncovered"}


def test_distance_of_exactly_epsilon_is_legal_and_any_more_is_not() -> None:
    # A corner moved by (1, 1) is sqrt(2) away.
    moved = [(2, 2), *ROOM_CORNERS[1:]]
    assert verify(ROOM, vector_map(polygon(moved, WALL))).valid
    report = verify(ROOM, replace(vector_map(polygon(moved, WALL)), epsilon_cells=1.4142))
    assert kinds(report) == {"uncovered"}
    assert report.violations[0].place_xy_m == pytest.approx((0.05, 0.05), abs=1e-3)


def test_a_wall_drawn_as_frontier_is_found() -> None:
    edges = polygon(ROOM_CORNERS, WALL)
    edges[0] = (*edges[0][:4], FRONTIER)
    report = verify(ROOM, vector_map(edges))
    assert kinds(report) == {"uncovered", "astray"}
    assert "frontier" in next(v.detail for v in report.violations if v.kind == "astray")


def test_an_edge_far_from_any_boundary_is_astray() -> None:
    report = verify(ROOM, vector_map(polygon([(1, 1), (1, 9), (5, 5), (9, 9), (9, 1)], WALL)))
    assert kinds(report) == {"uncovered", "astray", "components"}


def test_crossing_edges_are_found() -> None:
    bow_tie = [(1, 1), (1, 9), (9, 1), (9, 9)]
    assert "crossing" in kinds(verify(ROOM, vector_map(polygon(bow_tie, WALL))))


def test_a_face_whose_edges_disagree_is_found() -> None:
    edges = polygon(ROOM_CORNERS, WALL)
    edges[2] = (*edges[2][:4], WALL_RIGHT)
    assert kinds(verify(ROOM, vector_map(edges))) == {"sides"}


def test_a_pillar_turned_inside_out_is_found() -> None:
    """Three corners of two diagonal cells, in the order of the boundary, can run around the wrong way."""
    rows = ["........"] * 8
    rows[3], rows[4] = "...#....", "....#..."  # cells (4, 3) and (3, 4)
    outer = raw_cracks(grid(["........"] * 8)).edges.tolist()
    pillar = [(4, 3), (4, 4), (3, 5)]
    right, inside_out = polygon(pillar, WALL), polygon(pillar, WALL_RIGHT)
    assert kinds(verify(grid(rows), vector_map([*outer, *inside_out]))) == {"sides"}
    assert verify(grid(rows), vector_map([*outer, *right])).valid


@pytest.mark.parametrize(("corner", "valid"), [("?", True), ("#", False)])
def test_rooms_that_the_map_joins_at_a_corner_are_found_if_there_is_a_wall(corner: str, valid: bool) -> None:
    source = grid([".?#?", f"{corner}..?"])
    joined = [(2, 0), (2, 1), (1, 1), (1, 2), (1, 3), (0, 3), (0, 1), (1, 0)]
    edges = polygon(joined, make_label(UNKNOWN, FREE))
    edges[3] = (*edges[3][:4], make_label(OCCUPIED, FREE))
    if corner == "#":
        edges[6] = (*edges[6][:4], make_label(OCCUPIED, FREE))
    report = verify(source, vector_map(edges), specks=0)
    assert kinds(report) == (set() if valid else {"components"})


def test_a_door_that_the_map_closes_is_found() -> None:
    two_rooms = ["#########", "#...#...#", "#.......#", "#...#...#", "#########"]
    source = grid([*two_rooms[:1], *[row for row in two_rooms[1:4] for _ in (0, 1)], *two_rooms[4:]])
    door_y, pinched = (3, 5), 4
    left = [(1, 1), (1, 4), (door_y[0], 4), (pinched, 4), (door_y[1], 4), (7, 4), (7, 1)]
    right = [(1, 5), (1, 8), (7, 8), (7, 5), (door_y[1], 5), (pinched, 5), (door_y[0], 5)]
    report = verify(source, vector_map(polygon(left, WALL) + polygon(right, WALL)))
    assert kinds(report) == {"components"}
    assert len(report.violations) == 1
    whole = left[:3] + right[6:] + right[:5] + left[4:]
    assert verify(source, vector_map(polygon(whole, WALL))).valid


def test_two_rooms_that_the_map_joins_are_found() -> None:
    source = grid(["#########", *["#...#...#"] * 6, "#########"])
    joined = [(1, 1), (1, 4), (3, 4), (3, 5), (1, 5), (1, 8), (7, 8), (7, 5), (4, 5), (4, 4), (7, 4), (7, 1)]
    assert kinds(verify(source, vector_map(polygon(joined, WALL)))) == {"components"}


def test_a_room_that_is_divided_is_found_even_if_the_count_of_faces_is_right() -> None:
    """A room falls apart while one of its halves is joined to the room next door: two faces for two rooms."""
    source = grid(["#############", *["#.......#...#"] * 7, "#############"])
    left = [(1, 1), (8, 1), (8, 4), (1, 4)]
    right = [(1, 5), (8, 5), (8, 8), (5, 8), (5, 9), (8, 9), (8, 12), (1, 12), (1, 9), (4, 9), (4, 8), (1, 8)]
    report = verify(source, vector_map(polygon(left, WALL_RIGHT) + polygon(right, WALL_RIGHT)))
    assert "components" in kinds(report)
    assert "a part of a component of free cells lies in another free face than the rest" in {
        v.detail for v in report.violations
    }


@pytest.mark.parametrize("filling", "?#")
def test_a_hole_in_a_wall_is_found_and_corners_connect_only_between_unknown_cells(filling: str) -> None:
    """Two rooms that meet at a corner, joined there: right if the corner is open, wrong if it is a wall."""
    source = grid([*[filling * 4 + "...."] * 4, *["...." + filling * 4] * 4])
    beside = make_label(FREE, UNKNOWN if filling == "?" else OCCUPIED)
    inner = [(0, 4, beside), (3, 4, beside), (4, 5, beside), (4, 8, FRONTIER), (8, 8, FRONTIER), (8, 4, beside)]
    corners = [*inner, (5, 4, beside), (4, 3, beside), (4, 0, FRONTIER), (0, 0, FRONTIER)]
    edges = [(*a[:2], *b[:2], a[2]) for a, b in pairwise([*corners, corners[0]])]
    report = verify(source, vector_map(edges))
    assert kinds(report) == (set() if filling == "?" else {"components"})


@pytest.mark.parametrize(("door", "specks", "valid"), [("?", 1, True), ("?", 0, False), ("#", 1, False)])
def test_specks_connect_only_where_they_are(door: str, specks: int, valid: bool) -> None:
    """Rooms with a hole in their wall: only a speck in it may have become free."""
    rooms = ["#" * 13, *["#.....#.....#"] * 2, f"#.....{door}.....#", *["#.....#.....#"] * 2, "#" * 13]
    joined = [row if i != 3 else "#...........#" for i, row in enumerate(rooms)]
    report = verify(grid(rooms), raw_cracks(grid(joined)), specks=specks)
    assert ("components" not in kinds(report)) == valid


def test_a_speck_elsewhere_does_not_excuse_a_hole() -> None:
    rooms = [row.format("#") for row in ["#" * 13, *["#.....{}.....#"] * 19, "#" * 13]]
    rooms[2] = "#.....?.....#"
    with_hole = [row if i != 16 else "#...........#" for i, row in enumerate(rooms)]
    report = verify(grid(rooms), raw_cracks(grid(with_hole)))
    assert "components" in kinds(report)


def test_a_free_face_among_unknown_cells_is_found() -> None:
    source = grid(["?" * 20] * 10 + ["#" * 20] + ["." * 20] * 10)
    island = polygon([(15, 5), (15, 7), (17, 7), (17, 5)], FRONTIER)
    edges = raw_cracks(source).edges.tolist()
    assert verify(source, vector_map(edges)).valid
    report = verify(source, vector_map([*edges, *island]))
    assert "a free face without free cells of its own" in {v.detail for v in report.violations}


def test_a_free_face_in_a_map_of_a_grid_without_free_cells_is_found() -> None:
    report = verify(grid(["##", "##"]), vector_map(polygon([(0, 0), (0, 1), (1, 1), (1, 0)], WALL)), specks=0)
    assert "components" in kinds(report)


def test_a_pillar_may_not_vanish() -> None:
    source = grid(["#########", *["#.......#"] * 3, "#...#...#", *["#.......#"] * 3, "#########"])
    assert kinds(verify(source, vector_map(polygon([(1, 1), (1, 8), (8, 8), (8, 1)], WALL)))) == {"uncovered"}


def test_backs_of_walls_are_legal_where_there_is_one_and_never_demanded() -> None:
    source = grid(["?##########?", *["?#........#?"] * 8, "?##########?"])
    front = polygon([(1, 2), (1, 10), (9, 10), (9, 2)], WALL)
    back = polygon([(0, 1), (0, 11), (10, 11), (10, 1)], make_label(OCCUPIED, UNKNOWN))
    assert verify(source, vector_map(front)).valid
    assert verify(source, vector_map(front + back)).valid
    loose = polygon([(-3, -3), (-3, 14), (13, 14), (13, -3)], make_label(OCCUPIED, UNKNOWN))
    assert kinds(verify(source, vector_map(front + loose))) == {"astray"}


# --- specks


def test_dropped_specks_are_counted_and_larger_ones_are_missed() -> None:
    rows = ["." * 20] * 20
    rows[5] = "....???............."  # unknown, 3 cells
    rows[12] = "..........??????...."
    rows[13] = "..........???????..."  # unknown, 13 cells
    source, empty = grid(rows), grid(["." * 20] * 20)
    report = verify(source, raw_cracks(empty), specks=13)
    assert report.valid
    assert (report.dropped.count, report.dropped.cells) == (2, 16)
    assert report.dropped.area_m2 == pytest.approx(16 * 0.05**2)
    assert kinds(verify(source, raw_cracks(empty), specks=12)) == {"uncovered"}
    assert verify(source, raw_cracks(source), specks=12).dropped.count == 0


def test_an_occupied_speck_is_never_dropped() -> None:
    rows = ["." * 20] * 20
    rows[5] = "....#..............."
    assert kinds(verify(grid(rows), raw_cracks(grid(["." * 20] * 20)))) == {"uncovered"}


def test_a_free_speck_in_a_wall_may_be_dropped() -> None:
    rows = ["#" * 20] * 3 + ["####..##############"] + ["#" * 20] * 3 + ["." * 20] * 10
    without = ["#" * 20] * 7 + ["." * 20] * 10
    report = verify(grid(rows), raw_cracks(grid(without)))
    assert report.valid
    assert (report.dropped.count, report.dropped.cells) == (1, 2)
    assert "components" in kinds(verify(grid(rows), raw_cracks(grid(without)), specks=1))


@pytest.mark.parametrize("becomes", ".#?")
def test_an_unknown_speck_before_a_wall_may_become_anything(becomes: str) -> None:
    room = [*["." * 20] * 10, "." * 8 + "{}" * 3 + "." * 9, "#" * 20]
    source, drawn = (grid([row.format(c, c, c) for row in room]) for c in ("?", becomes))
    report = verify(source, raw_cracks(drawn))
    assert report.valid
    assert report.dropped.count == (0 if becomes == "?" else 1)


def test_an_unknown_speck_in_a_door_that_becomes_free_joins_the_rooms_and_else_does_not() -> None:
    rooms = ["#" * 13, *["#.....#.....#"] * 2, "#.....{}.....#", *["#.....#.....#"] * 2, "#" * 13]
    source = grid([row.format("?") for row in rooms])
    for becomes in ".#?":
        assert verify(source, raw_cracks(grid([row.format(becomes) for row in rooms]))).valid


# --- phases and readings


@pytest.mark.parametrize(
    ("x_cells", "valid"), [(1 / 40, True), (0.5, True), (15 / 16, True), (1.0, True), (1.1, False)]
)
def test_the_grid_stands_at_its_true_offset_in_sixteenths(x_cells: float, valid: bool) -> None:
    shifted = grid(["##########", *["#........#"] * 8, "##########"], x_cells=x_cells)
    drawn = replace(vector_map(polygon(ROOM_CORNERS, WALL)), epsilon_cells=1.0)
    assert verify(shifted, drawn).valid == valid


@settings(deadline=None)
@given(grids, st.integers(-40, 40), st.integers(-40, 40), st.sampled_from([0.0, 1.0, -2.5]))
def test_a_shift_is_measured_by_its_length(states: np.ndarray, y16: int, x16: int, yaw_rad: float) -> None:
    """The raw boundary of a grid is off by its own shift at corners, so it is valid up to that and no farther."""
    place = Pose2(3.0, -1.0, yaw_rad)
    drawn = raw_cracks(OccupancyGrid.from_states(states, 0.05, place))
    if len(drawn) == 0 or (y16 == 0 and x16 == 0):
        return
    shifted = OccupancyGrid.from_states(states, 0.05, place @ Pose2(x16 / 16 * 0.05, y16 / 16 * 0.05))
    distance2 = Fraction(x16**2 + y16**2, 256)
    enough = replace(drawn, epsilon_cells=math.sqrt(distance2))
    assert not kinds(verify(shifted, enough, specks=0)) & {"uncovered", "astray"}


def test_centres_are_the_papers_reading() -> None:
    corners = [(0, 0), (0, 10), (10, 10), (10, 0)]
    near_centres = vector_map(polygon(corners, WALL))
    # Half a cell outside of the centres of the wall's cells, and sqrt(0.5) at the corners.
    report = verify(ROOM, replace(near_centres, epsilon_cells=0.75), points="centres")
    assert report.valid
    assert kinds(verify(ROOM, replace(near_centres, epsilon_cells=0.7), points="centres")) == {"astray"}
    # From inside, the walls' corner cells are farther away, and they do touch a free cell.
    inside = vector_map(polygon(ROOM_CORNERS, WALL))
    assert kinds(verify(ROOM, replace(inside, epsilon_cells=0.7), points="centres")) >= {"uncovered", "astray"}


def test_another_resolution_or_yaw_or_reading_is_refused() -> None:
    drawn = vector_map(polygon(ROOM_CORNERS, WALL))
    with pytest.raises(ConfigError, match="resolution"):
        verify(OccupancyGrid(ROOM.cells_yx, 0.1), drawn)
    with pytest.raises(ConfigError, match="turned"):
        verify(OccupancyGrid(ROOM.cells_yx, 0.05, Pose2(0, 0, 0.01)), drawn)
    with pytest.raises(ConfigError, match="points="):
        verify(ROOM, drawn, points="corners")  # type: ignore[arg-type]


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


@settings(deadline=None)
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


@settings(deadline=None)
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


@settings(deadline=None)
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


@settings(deadline=None)
@given(grids)
def test_the_raw_boundary_has_one_free_face_for_each_component(states: np.ndarray) -> None:
    from scipy.ndimage import label

    drawn = raw_cracks(OccupancyGrid.from_states(states, 0.05)).edges.astype(np.int64)
    _, free_components = label(np.pad(states, 1, constant_values=UNKNOWN) == FREE)
    _, other_components = label(np.pad(states, 1, constant_values=UNKNOWN) != FREE, np.ones((3, 3)))
    if len(drawn):
        faces = find_faces(drawn[:, :4])
        left, right = drawn[:, 4] // 3, drawn[:, 4] % 3
        free = np.concatenate([faces.left[left == FREE], faces.right[right == FREE]])
        other = np.concatenate([faces.left[left != FREE], faces.right[right != FREE]])
        assert len(np.unique(free)) == free_components
        assert faces.outside in other
        assert not np.isin(free, other).any()
        assert len(np.unique(other)) >= other_components  # corners join them in the grid, not in the plane


REAL = Path(os.environ["FLEETMAP_DATA"]) / "maps" if "FLEETMAP_DATA" in os.environ else None


@pytest.mark.data
@pytest.mark.skipif(REAL is None, reason="FLEETMAP_DATA is unset")
@pytest.mark.parametrize("name", ["tuw_office_010", "nav2_depot", "duke_loop5_010"])
def test_the_raw_boundary_of_real_maps_is_valid(name: str) -> None:
    assert REAL is not None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MapWarning)
        source = load_map(REAL / name / "map.yaml")
    assert verify(source, raw_cracks(source), specks=0).valid
