"""Where the fleet lattice begins: a pure function that keeps near fleets at 0, and lets no one push the others out."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetmap.merge import Source, fold, verify
from fleetmap.merge.origin import MAX_EXTENT, MAX_REACH, ORIGIN_STEPS, Box, choose_origin
from fleetmap.model.errors import MapFormatError
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN, Lattice
from fleetmap.model.mergedmap import FLEET_UM, MAX_ORIGIN_UM, ORIGIN_UM, MergedMap
from fleetmap.model.pose import FixedPose, Pose2
from fleetmap.model.vectormap import VectorMap
from fleetmap.planners import plan

CELL_UM = 50_000
FAR_M = [6e3, 50e3, 500e3, -9e6]
some = settings(max_examples=60, deadline=None)


def room(width=60, height=40, *, resolution_um=CELL_UM, T_frame_lattice=None):
    """A room with a free-standing two-sided wall of one cell in it, as cracks."""
    free, other = (FREE, OCCUPIED), (OCCUPIED, FREE)
    rows = []
    for y0, x0, y1, x1, inside in ((0, 0, height, width, free), (10, 20, 11, 40, other)):
        ahead, back = (3 * a + b for a, b in (inside, inside[::-1]))
        rows += [(y0, x0, y0, x1, ahead), (y0, x0, y1, x0, back), (y0, x1, y1, x1, ahead), (y1, x0, y1, x1, back)]
    return VectorMap(
        Lattice(resolution_um, T_frame_lattice or FixedPose()), np.array(rows, np.int32), np.full(8, 4, np.uint8)
    )


def at(x_m=0.0, y_m=0.0, yaw_rad=0.0, *, robot="r", vector_map=None):
    return Source((robot, 1, "0"), FixedPose.from_pose(Pose2(x_m, y_m, yaw_rad)), vector_map or room())


def fleet(x_m, y_m):
    """Two robots that see one room, a bit off, and one beside it."""
    return [
        at(x_m, y_m, robot="a"),
        at(x_m + 0.02, y_m - 0.01, 0.004, robot="b"),
        at(x_m + 5.0, y_m + 1.0, 1.0, robot="c"),
    ]


@pytest.mark.parametrize("far_m", FAR_M)
def test_a_far_fleet_folds_to_the_map_of_a_near_one_moved(far_m):
    near, far = fold(fleet(0.0, 0.0)), fold(fleet(far_m, -far_m))
    assert near.origin_um == (0, 0)
    assert far.origin_um == tuple(round(v * 1e6 / ORIGIN_UM) * ORIGIN_UM for v in (far_m, -far_m))
    assert np.abs(far.edges[:, :4]).max() <= MAX_REACH
    assert far.left_out == ()
    assert np.array_equal(far.edges[:, 4:], near.edges[:, 4:])
    assert np.abs(far.segments_xy - [far_m, -far_m] - near.segments_xy).max() < 1e-8  # what float64 holds so far away
    assert np.subtract(far.bounds_m(), near.bounds_m()) == pytest.approx([far_m, -far_m] * 2)
    assert verify(fleet(far_m, -far_m), far) == []
    # A map is judged where it lies, and not where its numbers would be without the origin.
    elsewhere = MergedMap(far.edges, far.resolution_um, far.tolerance)
    assert {v.law for v in verify(fleet(far_m, -far_m), elsewhere)} >= {"safety", "accuracy"}


@pytest.mark.parametrize("far_m", FAR_M)
def test_a_planner_goes_the_same_way_far_from_the_origin(far_m):
    near, far = fold(fleet(0.0, 0.0)), fold(fleet(far_m, -far_m))
    here = plan(near, (1.2, 0.2), (1.3, 1.8), radius_m=0.1)
    there = plan(far, (1.2 + far_m, 0.2 - far_m), (1.3 + far_m, 1.8 - far_m), radius_m=0.1)
    assert len(here.points_xy) > 2
    assert there.points_xy - [far_m, -far_m] == pytest.approx(here.points_xy, abs=1e-6)
    assert there.clearance_m == pytest.approx(here.clearance_m, abs=1e-6)


@pytest.mark.parametrize("yaw_rad", [0.0, 0.7, -2.5])
@pytest.mark.parametrize("far_m", [50e3, 500e3])
def test_a_map_far_from_its_frame_lies_where_its_origin_says(far_m, yaw_rad):
    """By a grid's origin, by an anchor and by a start, alike and together, whichever of them turns."""
    start, anchor, origin = Pose2(far_m, 7.0, yaw_rad), Pose2(-far_m, 3.0, 0.3), Pose2(far_m, -far_m, 0.1)
    T_fleet_frame = FixedPose.from_pose(start) @ FixedPose.from_pose(anchor)
    vector_map = room(T_frame_lattice=FixedPose.from_pose(origin))
    merged = fold([Source(("r", 1, "0"), T_fleet_frame, vector_map)])
    cells = vector_map.edges[:, [1, 0, 3, 2]].reshape(-1, 2) * (CELL_UM / 1e6)
    expected = (start @ anchor @ origin).apply(cells).reshape(-1, 2, 2)
    # Half a step along each axis, and Q30 rotations over twice 700 km.
    found = merged.segments_xy.reshape(-1, 2)
    off = np.hypot(*(found[:, None] - expected.reshape(1, -1, 2)).transpose(2, 0, 1)).min(axis=0)
    assert len(merged) == 8
    assert off.max() < 0.0036 + 2 * far_m * 2**-30
    assert verify([Source(("r", 1, "0"), T_fleet_frame, vector_map)], merged) == []


@some
@given(st.integers(-400, 400), st.integers(-400, 400), st.integers(1, 40))
def test_cells_of_far_and_near_grids_lie_on_one_lattice(x_km, y_km, step):
    resolution_m = step * FLEET_UM / 1e6
    rows = np.array([(0, 0, 0, 300, FREE, OCCUPIED, 1, 10), (0, 0, 200, 0, OCCUPIED, FREE, 1, 10),
                     (0, 300, 200, 300, FREE, UNKNOWN, 0, 0), (200, 0, 200, 300, UNKNOWN, FREE, 0, 0)])  # fmt: skip
    origin_um = (x_km * ORIGIN_UM, y_km * ORIGIN_UM)
    grid = MergedMap(rows.astype(np.int32), origin_um=origin_um).to_grid(resolution_m)
    corner = np.array([grid.origin.x_m, grid.origin.y_m]) / resolution_m
    assert np.abs(corner - np.round(corner)).max() < 1e-5
    # The middle of the room is free, a point just below it isn't, by the metres of the component's frame.
    for point, state in (((0.75, 0.5), FREE), ((0.75, -0.5 * resolution_m), OCCUPIED)):
        cell = np.floor((np.array(point) + np.array(origin_um) / 1e6) / resolution_m - corner + 1e-6).astype(int)
        assert grid.states_yx()[cell[1], cell[0]] == state


def test_fleets_near_the_origin_have_it_at_0_whatever_their_names():
    for x_m in (0.0, 600.0, -3000.0, 5200.0):
        for robots in ("ab", "ba"):
            sources = [at(0.0, robot=robots[0]), at(x_m, -x_m, robot=robots[1])]
            merged = fold(sources)
            assert (merged.origin_um, merged.left_out) == ((0, 0), ())


def test_a_component_on_both_sides_of_a_multiple_of_1024_m_is_whole():
    border_m = 488.5 * 1024
    for order in ((0, 1), (1, 0)):
        sources = [at(border_m + (-1) ** k * 10.0, robot="ab"[order[k]]) for k in range(2)]
        merged = fold(sources)
        assert merged.left_out == ()
        assert merged.bounds_m() == pytest.approx((border_m - 10, 0.0, border_m + 13, 2.0))


near_boxes = st.tuples(
    st.integers(-(2**28), 2**28), st.integers(-(2**28), 2**28), st.integers(0, 2**32 - 1), st.integers(1, 9)
)


def boxes_within(y, x, seed, count):
    """Boxes of robots that lie within ``MAX_EXTENT`` of one another, corners of that extent among them."""
    rng = np.random.default_rng(seed)
    boxes = []
    for k in range(count):
        a, b = rng.choice([0, 1, MAX_EXTENT // 2, MAX_EXTENT, int(rng.integers(0, MAX_EXTENT + 1))], (2, 2))
        (y0, x0), (y1, x1) = np.minimum(a, b).tolist(), np.maximum(a, b).tolist()
        boxes.append(((f"r{k}", 1, "0"), Box(y + y0, x + x0, y + y1, x + x1)))
    return boxes


@some
@given(near_boxes, st.data())
def test_what_lies_within_the_limit_fits_wherever_it_lies_and_in_any_order(place, data):
    boxes = boxes_within(*place)
    origin = choose_origin(boxes)
    assert all(box.reach(origin) <= MAX_REACH for _, box in boxes)
    assert all(v % ORIGIN_STEPS == 0 for v in origin)
    shuffled = data.draw(st.permutations(boxes)) + data.draw(st.lists(st.sampled_from(boxes), max_size=3))
    assert choose_origin(shuffled) == origin


@some
@given(near_boxes, st.data())
def test_fewer_robots_far_away_push_no_one_out_by_any_name_and_any_number_of_maps(place, data):
    honest = boxes_within(*place)
    names = data.draw(st.lists(st.sampled_from([".", "0", "zz", "r", "-"]), unique=True, max_size=len(honest) - 1))
    far = data.draw(st.integers(4 * MAX_EXTENT, 2**30)) * data.draw(st.sampled_from([-1, 1]))
    y, x, _, _ = place
    hostile = [((name, 1, str(k)), Box(y + far, x + k, y + far + 5, x + k + 5)) for name in names for k in range(20)]
    origin = choose_origin(hostile + honest)
    assert all(box.reach(origin) <= MAX_REACH for _, box in honest)


def test_who_is_left_out_is_named_with_the_reason():
    sources = [at(500e3, robot="a"), at(500e3 + 1000.0, robot="b"), at(450e3, robot=".")]
    merged = fold(sources)
    assert merged.to_bytes() == fold(sources[:2]).to_bytes()
    ((frame, reason),) = merged.left_out
    assert frame == (".", 1, "0")
    assert "49" in reason
    assert "at most 5755 m" in reason


def test_a_map_beyond_the_limit_by_itself_is_left_out_and_has_no_voice():
    def strip(cells):
        return VectorMap(
            Lattice(CELL_UM),
            np.array([(0, 0, 0, cells, 1), (0, 0, 9, 0, 3), (0, cells, 9, cells, 1), (9, 0, 9, cells, 3)]),
            np.full(4, 4, np.uint8),
        )

    most = MAX_EXTENT * FLEET_UM // CELL_UM
    assert len(fold([at(vector_map=strip(most), x_m=1e5)])) >= 4
    merged = fold([at(vector_map=strip(most + 1), robot="a", x_m=1e5), at(robot="b")])
    assert merged.origin_um == (0, 0)
    assert len(merged) == 8
    assert merged.left_out == ((("a", 1, "0"), "edges: extends 5243 m; at most 5243 m"),)


def test_the_bytes_and_the_digest_tell_origins_apart():
    edges = fold([at()]).edges
    maps = [MergedMap(edges, origin_um=(x * ORIGIN_UM, y * ORIGIN_UM)) for x, y in ((0, 0), (1, 0), (0, 1), (-1, 0))]
    assert len({m.digest for m in maps}) == 4
    assert maps[0].to_bytes() == MergedMap(edges).to_bytes()


@pytest.mark.parametrize("origin_um", [(1, 0), (0, ORIGIN_UM // 2), (MAX_ORIGIN_UM + ORIGIN_UM, 0)])
def test_an_impossible_origin_is_refused(origin_um):
    with pytest.raises(MapFormatError, match="origin_um"):
        MergedMap(np.zeros((0, 8), np.int32), origin_um=origin_um)
