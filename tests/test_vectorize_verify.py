import math
import os
import warnings
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fleetmap.model.errors import ConfigError, MapWarning
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN, Lattice
from fleetmap.model.map_server import load_map
from fleetmap.model.pose import FixedPose, Pose2
from fleetmap.model.vectormap import VectorMap, make_label
from fleetmap.vectorize.verify import VerifyReport, verify
from fleetmap.vectorize.verify_faces import find_faces

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


def at_epsilon(drawn: VectorMap, epsilon_cells: float) -> VectorMap:
    return VectorMap(drawn.lattice, drawn.edges, drawn.thickness, epsilon_cells, drawn.profile)


def raw_cracks(source: OccupancyGrid) -> VectorMap:
    """Every unit of boundary between a free cell and another one as an edge of its own, by a plain loop.

    So are the outlines of obstacles without a free cell at a side.
    """
    from scipy.ndimage import binary_dilation, label

    rimmed = np.pad(source.states_yx(), 1, constant_values=UNKNOWN)
    obstacles, _ = label(rimmed == OCCUPIED, np.ones((3, 3)))
    hidden = ~np.isin(obstacles, np.unique(obstacles[binary_dilation(rimmed == FREE)])) & (obstacles > 0)
    states, hidden = rimmed.tolist(), hidden.tolist()
    edges = []
    for i, row in enumerate(states):
        for j, state in enumerate(row):
            above = states[i + 1][j] if i + 1 < len(states) else UNKNOWN
            right = row[j + 1] if j + 1 < len(row) else UNKNOWN
            if state != above and (FREE in (state, above) or hidden[i][j] or hidden[i + 1][j]):
                edges.append((i, j - 1, i, j, make_label(above, state)))
            if state != right and (FREE in (state, right) or hidden[i][j] or hidden[i][j + 1]):
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


@given(grids, st.sampled_from([0, 1, 12]))
def test_the_raw_boundary_is_valid(states: np.ndarray, specks: int) -> None:
    source = OccupancyGrid.from_states(states, 0.05, Pose2(1.0, -2.0, 0.3))
    report = verify(source, raw_cracks(source), specks=specks)
    assert report.violations == ()
    assert report.dropped.count == 0


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
    assert verify(grid(["??", "??"]), vector_map([])).valid
    assert kinds(verify(grid(["#?", "?#"]), vector_map([]))) == {"lost"}


def test_an_empty_map_of_a_room_is_not() -> None:
    assert kinds(verify(ROOM, vector_map([]))) == {"uncovered", "components", "lost"}


def test_distance_of_exactly_epsilon_is_legal_and_any_more_is_not() -> None:
    # A corner moved by (1, 1) is sqrt(2) away.
    moved = [(2, 2), *ROOM_CORNERS[1:]]
    assert verify(ROOM, vector_map(polygon(moved, WALL))).valid
    report = verify(ROOM, at_epsilon(vector_map(polygon(moved, WALL)), 1.4142))
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
    assert kinds(verify(source, vector_map(polygon([(1, 1), (1, 8), (8, 8), (8, 1)], WALL)))) == {"uncovered", "lost"}


def test_backs_of_walls_are_legal_where_there_is_one_and_never_demanded() -> None:
    source = grid(["?##########?", *["?#........#?"] * 8, "?##########?"])
    front = polygon([(1, 2), (1, 10), (9, 10), (9, 2)], WALL)
    back = polygon([(0, 1), (0, 11), (10, 11), (10, 1)], make_label(OCCUPIED, UNKNOWN))
    assert verify(source, vector_map(front)).valid
    assert verify(source, vector_map(front + back)).valid
    loose = polygon([(-3, -3), (-3, 14), (13, 14), (13, -3)], make_label(OCCUPIED, UNKNOWN))
    assert kinds(verify(source, vector_map(front + loose))) == {"astray"}


# Maps that a vectorizer made: thin components whose cells' centres tell little of where they are.
THIN = [
    (
        [".?#.", ".?.#", "..?.", "...."],
        1.0,
        [
            (0, 0, 0, 4, 2), (0, 0, 4, 0, 6), (0, 4, 2, 4, 2), (1, 2, 2, 2, 2), (1, 2, 2, 3, 6), (2, 2, 2, 3, 2),
            (2, 2, 3, 2, 6), (2, 2, 4, 0, 2), (2, 3, 2, 4, 3), (2, 3, 3, 2, 1), (3, 4, 4, 3, 3), (3, 4, 4, 4, 2),
            (4, 3, 4, 4, 6),
        ],
    ),
    (
        [".?...?.", "#.#..#.", ".?.#?.?", "..?....", ".#....."],
        2**0.5,
        [
            (0, 1, 1, 2, 1), (0, 1, 3, 0, 6), (0, 2, 0, 7, 2), (0, 2, 1, 2, 3), (0, 7, 3, 6, 2), (1, 2, 2, 2, 2),
            (1, 2, 2, 3, 6), (2, 2, 2, 3, 2), (2, 2, 3, 1, 2), (2, 2, 3, 2, 6), (2, 3, 2, 4, 3), (2, 3, 3, 2, 1),
            (2, 4, 3, 5, 6), (3, 0, 3, 1, 3), (3, 1, 3, 2, 2), (3, 1, 4, 1, 3), (3, 2, 4, 2, 1), (3, 4, 3, 5, 2),
            (3, 4, 4, 2, 3), (3, 5, 3, 6, 3), (3, 5, 4, 5, 1), (3, 6, 3, 7, 2), (3, 6, 4, 6, 3), (3, 7, 4, 6, 2),
            (4, 0, 4, 1, 1), (4, 0, 5, 1, 6), (4, 1, 4, 2, 6), (4, 1, 5, 1, 2), (4, 2, 4, 5, 6),
        ],
    ),
]  # fmt: skip


@pytest.mark.parametrize(("rows", "epsilon_cells", "edges"), THIN)
def test_thin_components_are_given_to_faces_near_them_if_that_works_for_all(
    rows: list[str], epsilon_cells: float, edges: list[tuple[int, int, int, int, int]]
) -> None:
    drawn = at_epsilon(vector_map(edges), epsilon_cells)
    free = [violation for violation in verify(grid(rows), drawn, specks=0).violations if violation.kind != "lost"]
    assert free == []


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
    assert kinds(verify(grid(rows), raw_cracks(grid(["." * 20] * 20)))) == {"uncovered", "lost"}


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
    drawn = at_epsilon(vector_map(polygon(ROOM_CORNERS, WALL)), 1.0)
    assert verify(shifted, drawn).valid == valid


@given(grids, st.integers(-40, 40), st.integers(-40, 40), st.sampled_from([0.0, 1.0, -2.5]))
def test_a_shift_is_measured_by_its_length(states: np.ndarray, y16: int, x16: int, yaw_rad: float) -> None:
    """The raw boundary of a grid is off by its own shift at corners, so it is valid up to that and no farther."""
    place = Pose2(3.0, -1.0, yaw_rad)
    drawn = raw_cracks(OccupancyGrid.from_states(states, 0.05, place))
    if len(drawn) == 0 or (y16 == 0 and x16 == 0):
        return
    shifted = OccupancyGrid.from_states(states, 0.05, place @ Pose2(x16 / 16 * 0.05, y16 / 16 * 0.05))
    distance2 = Fraction(x16**2 + y16**2, 256)
    enough = at_epsilon(drawn, math.sqrt(distance2))
    assert not kinds(verify(shifted, enough, specks=0)) & {"uncovered", "astray"}


def test_centres_are_the_papers_reading() -> None:
    corners = [(0, 0), (0, 10), (10, 10), (10, 0)]
    near_centres = vector_map(polygon(corners, WALL))
    # Half a cell outside of the centres of the wall's cells, and sqrt(0.5) at the corners.
    report = verify(ROOM, at_epsilon(near_centres, 0.75), points="centres")
    assert report.valid
    assert kinds(verify(ROOM, at_epsilon(near_centres, 0.7), points="centres")) == {"astray"}
    # From inside, the walls' corner cells are farther away, and they do touch a free cell.
    inside = vector_map(polygon(ROOM_CORNERS, WALL))
    assert kinds(verify(ROOM, at_epsilon(inside, 0.7), points="centres")) >= {"uncovered", "astray"}


def test_another_resolution_or_yaw_or_reading_is_refused() -> None:
    drawn = vector_map(polygon(ROOM_CORNERS, WALL))
    with pytest.raises(ConfigError, match="resolution"):
        verify(OccupancyGrid(ROOM.cells_yx, 0.1), drawn)
    with pytest.raises(ConfigError, match="turned"):
        verify(OccupancyGrid(ROOM.cells_yx, 0.05, Pose2(0, 0, 0.01)), drawn)
    with pytest.raises(ConfigError, match="points="):
        verify(ROOM, drawn, points="corners")  # type: ignore[arg-type]


@given(grids)
def test_the_raw_boundary_has_one_free_face_for_each_component(states: np.ndarray) -> None:
    from scipy.ndimage import label

    drawn = raw_cracks(OccupancyGrid.from_states(states, 0.05)).edges.astype(np.int64)
    _, free_components = label(np.pad(states, 1, constant_values=UNKNOWN) == FREE)
    _, other_components = label(np.pad(states, 1, constant_values=UNKNOWN) != FREE, np.ones((3, 3)))
    drawn = drawn[(drawn[:, 4] // 3 == FREE) | (drawn[:, 4] % 3 == FREE)]
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
