"""The verifier objects to each kind of damage: a judge that never says no would prove nothing."""

import numpy as np
import pytest

from fleetmap.merge import Source, fold, verify
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN, Lattice
from fleetmap.model.mergedmap import MergedMap
from fleetmap.model.pose import FixedPose, Pose2
from fleetmap.model.vectormap import VectorMap


def ring(y0, x0, y1, x1, inside, outside):
    """Edges of a rectangle, in cells."""
    return [
        (y0, x0, y0, x1, 3 * inside + outside),
        (y0, x0, y1, x0, 3 * outside + inside),
        (y0, x1, y1, x1, 3 * inside + outside),
        (y1, x0, y1, x1, 3 * outside + inside),
    ]


@pytest.fixture
def sources():
    """A room of 5 m with a pillar of 1 m in it, seen by two robots."""
    rows = np.array(ring(0, 0, 100, 100, FREE, OCCUPIED) + ring(40, 40, 60, 60, OCCUPIED, FREE))
    vector_map = VectorMap(Lattice(50_000), rows, np.full(8, 4, np.uint8))
    poses = (Pose2(0.0, 0.0, 0.0), Pose2(0.02, 0.01, 0.001))
    return [Source((f"r{k}", 1, "0"), FixedPose.from_pose(pose), vector_map) for k, pose in enumerate(poses)]


def laws(sources, merged, rows):
    damaged = MergedMap(np.array(rows, np.int32).reshape(-1, 8), merged.resolution_um, merged.tolerance)
    return {violation.law for violation in verify(sources, damaged)}


def test_a_sound_map_passes(sources):
    merged = fold(sources)
    assert laws(sources, merged, merged.edges) == set()


def test_a_missing_wall_is_found(sources):
    merged = fold(sources)
    longest = np.argmax(np.abs(merged.edges[:, 2:4] - merged.edges[:, :2]).sum(axis=1))
    assert {"safety", "face"} <= laws(sources, merged, np.delete(merged.edges, longest, axis=0))


def test_an_invented_wall_is_found(sources):
    merged = fold(sources)
    wall = [[100, 100, 100, 300, FREE, FREE, 1, 5]]
    rows = sorted([*merged.edges.tolist(), *wall])
    assert {"accuracy", "door"} <= laws(sources, merged, rows)


def test_edges_that_cross_are_found(sources):
    merged = fold(sources)
    rows = sorted([*merged.edges.tolist(), [-50, 200, 50, 210, FREE, FREE, 1, 5]])
    assert "crossing" in laws(sources, merged, rows)


@pytest.mark.parametrize("column", [4, 5])
def test_a_wrong_side_is_found(sources, column):
    merged = fold(sources)
    for k in range(len(merged)):
        rows = merged.edges.copy()
        rows[k, column] = UNKNOWN if rows[k, column] == FREE else FREE
        assert "face" in laws(sources, merged, rows)


def test_an_island_in_the_wrong_face_is_found(sources):
    merged = fold(sources)
    # Free inside and outside exchanged, all around the pillar: each vertex agrees, the face around it doesn't.
    rows = merged.edges.copy()
    pillar = (rows[:, 0] > 200) & (rows[:, 2] < 800) & (rows[:, 1] > 200) & (rows[:, 3] < 800)
    rows[pillar, 4:6] = rows[pillar][:, [5, 4]]
    assert pillar.sum() >= 4
    assert {"face", "free"} & laws(sources, merged, rows) == {"face", "free"}


def test_free_space_that_no_source_saw_is_found(sources):
    merged = fold(sources)
    outer = fold(
        [
            Source(
                ("x", 1, "0"),
                FixedPose(-500_000, -500_000),
                VectorMap(Lattice(50_000), np.array(ring(0, 0, 120, 120, FREE, OCCUPIED)), np.zeros(4, np.uint8)),
            )
        ]
    )
    assert "free" in laws(sources, merged, outer.edges)


@pytest.mark.parametrize(
    "rows",
    [
        [[0, 0, 10, 0, 0, 1, 1, 0], [0, 0, 0, 10, 0, 1, 1, 0]],
        [[0, 0, 10, 0, 0, 1, 1, 0], [0, 0, 10, 0, 0, 1, 1, 0]],
        [[10, 0, 0, 0, 0, 1, 1, 0]],
        [[0, 0, 10, 0, 0, 3, 1, 0]],
        [[0, 0, 10, 0, 1, 1, 0, 0]],
        [[0, 0, 10, 0, 0, 1, 2, 0]],
        [[0, 0, 10, 0, 0, 1, 1, -1]],
    ],
)
def test_rows_that_are_not_canonical_are_found(rows):
    assert "canonical" in {v.law for v in verify([], MergedMap(np.array(rows, np.int32)))}


def test_a_violation_says_where_in_metres(sources):
    merged = fold(sources)
    rows = sorted([*merged.edges.tolist(), [150, 100, 150, 300, FREE, FREE, 1, 5]])
    found = verify(sources, MergedMap(np.array(rows, np.int32), tolerance=merged.tolerance))
    x, y = next(v.at_xy_m for v in found if v.law == "accuracy")
    assert y == pytest.approx(0.75)
    assert 0.5 <= x <= 1.5
