"""The vocabulary: fixed poses compose exactly, edge sets are canonical, digests and arcs don't depend on order."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleetmap.model.errors import ConfigError, MapFormatError
from fleetmap.model.hashing import hash_ints, hash_text
from fleetmap.model.lattice import MAX_COORDINATE, Lattice
from fleetmap.model.pose import FixedPose, Pose2
from fleetmap.model.vectormap import VectorMap

LATTICE = Lattice(50_000, FixedPose.from_pose(Pose2(1.0, 2.0, 0.0)))

edge = st.tuples(
    st.integers(-50, 50),
    st.integers(-50, 50),
    st.integers(-50, 50),
    st.integers(-50, 50),
    st.sampled_from([1, 2, 3, 6]),
).filter(lambda e: e[:2] != e[2:4])
edge_lists = st.lists(edge, max_size=30, unique=True)
angles = st.floats(-10, 10)
offsets = st.floats(-1e4, 1e4)


def vector_map(rows, thickness=None):
    edges = np.array(rows, np.int32).reshape(-1, 5)
    return VectorMap(LATTICE, edges, np.zeros(len(edges), np.uint8) if thickness is None else thickness)


@given(st.tuples(offsets, offsets, angles), st.tuples(offsets, offsets, angles))
def test_composed_poses_map_points_like_one_after_the_other(a, b):
    T_a_b, T_b_c = Pose2(*a), Pose2(*b)
    points = np.array([[1.0, 2.0], [-3.0, 0.5]])
    assert np.allclose((T_a_b @ T_b_c).apply(points), T_a_b.apply(T_b_c.apply(points)), atol=1e-7)
    assert np.allclose((T_a_b @ T_a_b.inverse()).apply(points), points, atol=1e-7)


@given(st.tuples(offsets, offsets, angles), st.tuples(offsets, offsets, angles))
def test_fixed_poses_compose_like_poses(a, b):
    fixed = (FixedPose.from_pose(Pose2(*a)) @ FixedPose.from_pose(Pose2(*b))).to_pose()
    exact = Pose2(*a) @ Pose2(*b)
    # Q30 rounds the rotation by 1e-9, which an arm of 14 km turns into 14 um.
    assert math.hypot(fixed.x_m - exact.x_m, fixed.y_m - exact.y_m) < 5e-5


@pytest.mark.parametrize("bad", [(math.nan, 0, 0), (0, math.inf, 0)])
def test_a_pose_of_no_numbers_is_refused(bad):
    with pytest.raises(ConfigError):
        Pose2(*bad)


def test_a_fixed_pose_that_scales_is_refused():
    with pytest.raises(ConfigError):
        FixedPose(0, 0, 1 << 29, 0)


@given(edge_lists, st.randoms(use_true_random=False))
def test_a_map_is_a_set_of_edges_in_any_order_and_direction(rows, random):
    def turned(e):
        y0, x0, y1, x1, label = e
        return (y1, x1, y0, x0, 3 * (label % 3) + label // 3)

    shuffled = [turned(e) if random.random() < 0.5 else e for e in rows]
    random.shuffle(shuffled)
    a, b = vector_map(rows), vector_map(shuffled)
    assert (a.edges == b.edges).all()
    assert a.digest == b.digest


@given(edge_lists.filter(bool), st.integers(0, 10**6))
def test_the_digest_sees_every_edge_and_every_thickness(rows, pick):
    whole = vector_map(rows)
    keep = np.arange(len(whole)) != pick % len(whole)
    assert VectorMap(LATTICE, whole.edges[keep], whole.thickness[keep]).digest != whole.digest
    thicker = whole.thickness.copy()
    thicker[pick % len(whole)] += 1
    assert VectorMap(LATTICE, whole.edges, thicker).digest != whole.digest


@given(edge_lists)
def test_arcs_hold_every_edge_once_and_end_where_labels_or_degrees_change(rows):
    whole = vector_map(rows)
    arcs = whole.arcs()
    assert sorted(arcs.edge_index.tolist()) == list(range(len(whole)))
    steps = []
    for i in range(len(arcs)):
        points = arcs.points(i).tolist()
        steps += [(*p, *q, int(arcs.labels[i])) for p, q in zip(points[:-1], points[1:], strict=True)]
    assert (vector_map(steps).edges == whole.edges).all()


@pytest.mark.parametrize(
    "row",
    [
        (0, 0, 0, 0, 1),
        (0, 0, 1, 1, 0),
        (0, 0, 1, 1, 9),
        (0, 0, 1, 1, -1),
        (0, 0, 1, MAX_COORDINATE + 1, 1),
    ],
)
def test_an_impossible_edge_is_refused(row):
    with pytest.raises(MapFormatError):
        vector_map([row])


def test_the_hash_is_what_the_format_page_says():
    # Golden: written out, so that another language can check itself against it.
    assert hash_ints((0, 0, 0, 5, 1), 2) == 0xD1678F6B90E6480B
    assert hash_text("r1", 0) == hash_ints((114, 49, 2), 0)


def test_edges_in_metres_and_the_graph_agree():
    one = vector_map([(0, 0, 0, 20, 1)])
    assert one.segments_xy.tolist() == [[[1.0, 2.0], [2.0, 2.0]]]
    graph = one.to_networkx()
    assert graph.edges[(0, 0), (0, 20)]["weight"] == pytest.approx(1.0)
    assert graph.nodes[(0, 20)]["pos"] == (2.0, 2.0)
