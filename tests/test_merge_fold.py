"""The laws of merging, on random maps in random poses; the verifier is the judge, and shares no code with the fold."""

import itertools
import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy import ndimage

from fleetmap.merge import Source, fold, verify
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN, Lattice
from fleetmap.model.pose import MAX_UM, FixedPose, Pose2
from fleetmap.model.vectormap import HIDDEN_LABELS, VectorMap

CELL_UM = 50_000


def cracks(states_yx, *, hidden=False, thickness=4, resolution_um=CELL_UM):
    """The vector map whose edges are all cracks between free and other cells, unsimplified."""
    padded = np.pad(states_yx, 1, constant_values=UNKNOWN)
    rows = []
    for i, j in np.argwhere(padded[1:, :] != padded[:-1, :]):  # between cell i (below) and i + 1 (above)
        rows.append((i, j - 1, i, j, 3 * padded[i + 1, j] + padded[i, j]))
    for i, j in np.argwhere(padded[:, 1:] != padded[:, :-1]):  # between cell j (on the left of +y) and j + 1
        rows.append((i - 1, j, i, j, 3 * padded[i, j] + padded[i, j + 1]))
    edges = np.array(rows, np.int64).reshape(-1, 5)
    if not hidden:
        edges = edges[~np.isin(edges[:, 4], HIDDEN_LABELS)]
    walls = np.isin(edges[:, 4], (1, 3, 5, 7))
    return VectorMap(Lattice(resolution_um), edges, np.where(walls, thickness, 0).astype(np.uint8))


def grids(low=2, high=9):
    return st.tuples(st.integers(low, high), st.integers(low, high), st.integers(0, 2**32 - 1)).map(
        lambda t: np.random.default_rng(t[2]).choice([FREE, FREE, OCCUPIED, UNKNOWN], t[:2]).astype(np.uint8)
    )


poses = st.builds(Pose2, st.floats(-0.4, 0.4), st.floats(-0.4, 0.4), st.floats(-3.2, 3.2))
vector_maps = st.builds(cracks, grids(), hidden=st.booleans(), thickness=st.integers(0, 12))
source_lists = st.lists(
    st.builds(lambda p, m: Source(("r", 1, "0"), FixedPose.from_pose(p), m), poses, vector_maps), min_size=1, max_size=4
)
some = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])


def room(width=30, height=20, *, shift=0, door=(8, 14)):
    """Two rooms with a wall of two cells between them, and a door in it; unknown around."""
    states = np.full((height + 4, width + 4), UNKNOWN, np.uint8)
    states[1:-1, 1:-1] = OCCUPIED
    states[3:-3, 3:-3] = FREE
    middle = width // 2 + shift
    states[3:-3, middle : middle + 2] = OCCUPIED
    states[door[0] : door[1], middle : middle + 2] = FREE
    return states


def at(vector_map, x=0.0, y=0.0, yaw=0.0, robot="r"):
    return Source((robot, 1, "0"), FixedPose.from_pose(Pose2(x, y, yaw)), vector_map)


@some
@given(source_lists)
def test_the_verifier_finds_nothing_to_object_to(sources):
    assert verify(sources, fold(sources)) == []


@some
@given(source_lists, st.data())
def test_fold_is_independent_of_order_and_repetition(sources, data):
    shuffled = data.draw(st.permutations(sources))
    repeated = shuffled + data.draw(st.lists(st.sampled_from(sources), max_size=3))
    assert fold(repeated).to_bytes() == fold(sources).to_bytes()


@some
@given(poses, vector_maps, st.integers(2, 5))
def test_copies_of_one_map_in_one_frame_fold_to_the_bytes_of_one(pose, vector_map, copies):
    sources = [Source((f"r{k}", k, "0"), FixedPose.from_pose(pose), vector_map) for k in range(copies)]
    assert fold(sources).to_bytes() == fold(sources[:1]).to_bytes()


def test_the_names_of_frames_decide_nothing():
    a, b = cracks(room()), cracks(room(shift=1))
    one = fold([at(a, robot="a"), at(b, 0.02, 0.01, 0.01, robot="b")])
    assert one.to_bytes() == fold([at(a, robot="z"), at(b, 0.02, 0.01, 0.01, robot="b")]).to_bytes()


SCRIPT = """
import numpy as np
from fleetmap.merge import Source, fold
from fleetmap.model.lattice import Lattice
from fleetmap.model.pose import MAX_UM, FixedPose, Pose2
from fleetmap.model.vectormap import VectorMap
rows = np.array({rows})
for far in (0.0, 5700.0, 500e3):
    maps = [VectorMap(Lattice(um), rows, np.full(len(rows), 4, np.uint8)) for um in (50_000, 70_000)]
    poses = [Pose2(far + 0.13 * k, -far, 0.7 * k) for k in range(4)]
    sources = [Source(("r", k, "0"), FixedPose.from_pose(p), maps[k % 2]) for k, p in enumerate(poses)]
    merged = fold(sources)
    print(len(merged), merged.digest)
"""


def test_without_the_compiler_the_same_bytes():
    states = np.random.default_rng(5).choice([FREE, OCCUPIED, UNKNOWN], (5, 5)).astype(np.uint8)
    script = SCRIPT.format(rows=cracks(states).edges.tolist())
    outputs = [
        subprocess.run(
            [sys.executable, "-W", "error", "-c", script],
            env={**os.environ, "NUMBA_DISABLE_JIT": flag},
            capture_output=True,
            text=True,
            check=True,
            timeout=240,
        ).stdout
        for flag in ("0", "1")
    ]
    assert outputs[0] == outputs[1]
    assert len(outputs[0].splitlines()) == 3


def passable(grid, start, goal):
    """Whether two points (x, y) in metres lie in one 4-connected free region of a grid."""
    labels, _ = ndimage.label(grid.states_yx() == FREE)
    cells = [
        labels[int((y - grid.origin.y_m) / grid.resolution_m), int((x - grid.origin.x_m) / grid.resolution_m)]
        for x, y in (start, goal)
    ]
    return cells[0] != 0 and cells[0] == cells[1]


@settings(max_examples=30, deadline=None)
@given(st.integers(7, 10), st.integers(-1, 1), st.floats(-0.03, 0.03), st.floats(-0.03, 0.03), st.floats(-0.01, 0.01))
def test_a_door_wider_than_the_tolerance_stays_open(width, shift, dx, dy, yaw):
    door = (8, 8 + width)
    sources = [at(cracks(room(door=door))), at(cracks(room(shift=shift, door=door)), dx, dy, yaw)]
    merged = fold(sources)
    assert width * CELL_UM > merged.tolerance * 5_000
    assert passable(merged.to_grid(), (0.4, 0.6), (1.4, 0.6))


def test_a_wall_of_one_robot_in_the_free_space_of_another_stays():
    empty = room()
    empty[3:-3, 3:-3] = FREE
    merged = fold([at(cracks(room())), at(cracks(empty), 0.01, 0.01, 0.002)])
    both = (merged.edges[:, 4] == FREE) & (merged.edges[:, 5] == FREE) & merged.obstacle
    assert both.any()
    closed = room(door=(8, 8))
    merged = fold([at(cracks(closed)), at(cracks(empty), 0.01, 0.01, 0.002)])
    assert not passable(merged.to_grid(), (0.4, 0.6), (1.4, 0.6))


def test_two_sights_of_one_wall_become_one():
    sources = [at(cracks(room())), at(cracks(room()), 0.03, -0.02, 0.004)]
    merged, alone = fold(sources), fold(sources[:1])

    def length(m):
        return np.hypot(*(m.segments_xy[:, 1] - m.segments_xy[:, 0]).T)[m.obstacle].sum()

    assert length(merged) == pytest.approx(length(alone), rel=0.05)
    assert len(merged) <= 2 * len(alone)


def test_the_two_faces_of_a_thin_wall_stay_apart():
    states = np.full((12, 20), FREE, np.uint8)
    states[:, 10] = OCCUPIED
    left, right = states.copy(), states.copy()
    left[:, 11:], right[:, :10] = UNKNOWN, UNKNOWN
    merged = fold([at(cracks(left)), at(cracks(right), 0.01)])
    walls = merged.segments_xy[merged.obstacle][:, :, 0]
    assert walls.min() == pytest.approx(0.5, abs=0.01)
    assert walls.max() == pytest.approx(0.56, abs=0.01)


def test_a_frontier_just_behind_a_wall_is_that_wall():
    seen, unseen = np.full((2, 10, 20), FREE, np.uint8)
    seen[:, 15:], unseen[:, 17:] = OCCUPIED, UNKNOWN
    merged = fold([at(cracks(seen)), at(cracks(unseen), 0.0, 0.0)])
    frontier_x = merged.segments_xy[merged.frontier][:, :, 0]
    assert not (frontier_x.min(axis=1) > 0.7).any()


def test_a_frontier_in_the_free_space_of_another_robot_goes():
    states = np.full((2, 12, 30), FREE, np.uint8)
    states[0, :, 20:], states[1, :, :10] = UNKNOWN, UNKNOWN
    merged = fold([at(cracks(s)) for s in states])
    assert len(merged) == 4
    assert merged.edges[:, :4].tolist() == [[0, 0, 0, 300], [0, 0, 120, 0], [0, 300, 120, 300], [120, 0, 120, 300]]


@some
@given(grids(low=4, high=14))
def test_simplification_moves_no_wall_farther_than_half_a_cell(states):
    source = at(cracks(states))
    merged = fold([source])
    import shapely

    if not merged.obstacle.any():
        assert not source.vector_map.obstacle.any()
        return
    for one, other in itertools.permutations(
        [source.vector_map.segments_xy[source.vector_map.obstacle], merged.segments_xy[merged.obstacle]]
    ):
        kept = shapely.union_all(shapely.linestrings(other))
        points = shapely.points(np.concatenate([one[:, 0], one[:, 1], one.mean(axis=1)]))
        assert shapely.distance(points, kept).max() <= 0.025 + 1e-9


def test_nothing_folds_to_an_empty_map():
    assert len(fold([])) == 0
    assert len(fold([at(VectorMap.empty(Lattice(CELL_UM)))])) == 0


def test_a_source_that_cannot_be_placed_is_left_out_and_says_why():
    good = at(cracks(room()))
    rows = cracks(room()).edges
    torn = at(VectorMap(Lattice(CELL_UM), rows[1:], np.zeros(len(rows) - 1, np.uint8)), robot="torn")
    beyond = Source(
        ("beyond", 1, "0"),
        FixedPose(MAX_UM),
        VectorMap(Lattice(CELL_UM, FixedPose(1)), rows, np.zeros(len(rows), np.uint8)),
    )
    merged = fold([good, torn, beyond])
    assert merged.to_bytes() == fold([good]).to_bytes()
    assert fold([good]).left_out == ()
    reasons = {frame[0]: reason for frame, reason in merged.left_out}
    assert reasons.keys() == {"torn", "beyond"}
    assert "not closed" in reasons["torn"]
    assert "17592186" in reasons["beyond"]


def test_a_robot_that_claims_huge_cells_does_not_blur_the_maps_of_others():
    honest = [at(cracks(room())), at(cracks(room()), 0.03, -0.02, 0.004)]
    # 15 cm beside the rooms, a hundredth of its own cell.
    coarse = at(cracks(np.full((1, 1), OCCUPIED, np.uint8), hidden=True, resolution_um=10_000_000), 1.8)
    before, after = (set(map(tuple, fold(s).edges.tolist())) for s in (honest, [*honest, coarse]))
    assert before < after


def test_an_edge_longer_than_the_kernels_take_is_cut():
    # A free strip of 1000 m by 10 m: 200000 steps, more than three times the longest edge.
    rows = np.array([(0, 0, 0, 100, 2), (0, 0, 1, 0, 6), (0, 100, 1, 100, 2), (1, 0, 1, 100, 6)])
    rows[:, 4] = [3 * FREE + UNKNOWN, 3 * UNKNOWN + FREE, 3 * FREE + UNKNOWN, 3 * UNKNOWN + FREE]
    source = at(VectorMap(Lattice(10_000_000), rows, np.zeros(4, np.uint8)), 10.0, 20.0, 0.3)
    merged = fold([source])
    assert len(merged) > 4
    assert np.abs(merged.edges[:, 2:4] - merged.edges[:, :2]).max() <= 1 << 16
    assert verify([source], merged) == []
