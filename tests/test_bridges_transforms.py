"""The buffer of transforms, held against products of 4x4 matrices."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from transforms import S, buffer_of, stamped, x_at

from fleetmap.bridges import said
from fleetmap.bridges.transforms import KEPT_S, TransformBuffer
from fleetmap.model.pose import Pose2, wrap


def matrix(shift, q):
    m = np.eye(4)
    m[:3, :3], m[:3, 3] = Rotation.from_quat(q).as_matrix(), shift
    return m


def near_matrix(pose, m):
    """Equal in the plane; where an x axis points that stands upright is anybody's guess."""
    flat = math.hypot(m[0, 0], m[1, 0])
    turned = flat < 1e-6 or abs(wrap(pose.yaw_rad - math.atan2(m[1, 0], m[0, 0]))) < 1e-9 / flat
    return turned and np.allclose([pose.x_m, pose.y_m], m[:2, 3], atol=1e-9)


@given(
    st.lists(st.integers(0, 9), min_size=1, max_size=7), st.lists(st.booleans(), min_size=7, max_size=7), st.integers()
)
def test_a_lookup_is_the_product_of_all_matrices_on_the_way(parents, static, seed):
    rng = np.random.default_rng(abs(seed))
    T_root_frame, buffer = [np.eye(4)], TransformBuffer()
    for child, draw in enumerate(parents, start=1):
        parent, shift, q = draw % child, rng.uniform(-9, 9, 3), Rotation.random(rng=rng).as_quat()
        T_root_frame.append(T_root_frame[parent] @ matrix(shift, q))
        buffer.take([stamped(f"f{parent}", f"f{child}", 5 * S, shift, q)], static=static[child - 1])
    for target, T_root_target in enumerate(T_root_frame):
        for source, T_root_source in enumerate(T_root_frame):
            for at_ns in (None, 5 * S):
                pose, _ = buffer.lookup(f"f{target}", f"f{source}", at_ns)
                assert near_matrix(pose, np.linalg.inv(T_root_target) @ T_root_source)


@given(st.floats(-3, 3), st.floats(-3, 3), st.integers(0, S))
def test_between_two_samples_a_frame_moves_and_turns_evenly(yaw, turn, part_ns):
    before, after = (Rotation.from_euler("z", angle).as_quat() for angle in (yaw, yaw + turn))
    buffer = buffer_of(stamped("a", "b", 7 * S, (1.0, 2.0, 0.0), before), stamped("a", "b", 8 * S, (3.0, -2, 0), after))
    pose, at_ns = buffer.lookup("a", "b", 7 * S + part_ns)
    part = part_ns / S
    assert at_ns == 7 * S + part_ns
    assert np.allclose([pose.x_m, pose.y_m], [1 + 2 * part, 2 - 4 * part])
    assert abs(wrap(pose.yaw_rad - (yaw + turn * part))) < 1e-6


def test_messages_of_the_bridge_itself_are_understood():
    buffer = TransformBuffer()
    message = said.transform(Pose2(1.0, -2.0, 0.7), parent="fleet", child="map", stamp_ns=3 * S + 5)
    buffer.take(message.transforms, static=False)
    pose, at_ns = buffer.lookup("fleet", "map")
    assert at_ns == 3 * S + 5
    assert np.allclose([pose.x_m, pose.y_m, pose.yaw_rad], [1, -2, 0.7])


@pytest.mark.parametrize("at_ns", [-1, 0, 2 * S - 1, 4 * S + 1, 10**18])
def test_nothing_is_known_outside_of_the_samples(at_ns):
    buffer = buffer_of(stamped("a", "b", 2 * S), stamped("a", "b", 4 * S))
    assert buffer.lookup("a", "b", at_ns) is None
    assert buffer.lookup("b", "a", at_ns) is None
    assert x_at(buffer, 2 * S) == x_at(buffer, 4 * S) == 0


def test_without_a_time_the_latest_is_meant_at_which_all_of_the_way_is_known():
    moving = [stamped("a", "b", k * S, (float(k), 0, 0)) for k in range(1, 6)]
    behind = [stamped("b", "c", k * S, (0, float(k), 0)) for k in (1, 3)]
    buffer = buffer_of(*moving, *behind, static=[stamped("c", "d", 99 * S, (0, 0.5, 0))])
    assert buffer.lookup("a", "b")[1] == 5 * S
    pose, at_ns = buffer.lookup("a", "d")
    assert (pose.x_m, pose.y_m, at_ns) == (3.0, 3.5, 3 * S)
    # c came to know where it lies only after b was heard for the last time
    assert buffer_of(stamped("a", "b", S), stamped("b", "c", 2 * S)).lookup("a", "c") is None


@pytest.mark.parametrize("at_ns", [None, -5, 0, 10**18])
def test_static_transforms_hold_at_all_times_and_the_last_one_counts(at_ns):
    buffer = buffer_of(static=[stamped("a", "b", 7 * S, (1.0, 0, 0)), stamped("a", "b", 3 * S, (2.0, 0, 0))])
    assert x_at(buffer, at_ns) == 2.0


def test_leading_slashes_are_none():
    assert x_at(buffer_of(stamped("/a", "//b", S, (4.0, 0, 0))), S) == 4.0


def test_a_child_that_changes_its_parent_is_only_there():
    buffer = buffer_of(stamped("a", "b", S, (1.0, 0, 0)), stamped("c", "b", 2 * S, (2.0, 0, 0)))
    assert x_at(buffer, 2 * S, "c") == 2.0
    assert buffer.lookup("c", "b", S) is None
    assert buffer.lookup("a", "b") is None
    assert "b" in buffer.why_not("a", "b")


def test_a_static_child_that_begins_to_move_moves():
    buffer = buffer_of(static=[stamped("a", "b", S, (1.0, 0, 0))])
    buffer.take([stamped("a", "b", 2 * S, (2.0, 0, 0))], static=False)
    assert x_at(buffer, 2 * S) == 2.0
    assert buffer.lookup("a", "b", S) is None


def test_samples_are_kept_so_long_and_no_longer():
    buffer = buffer_of(*(stamped("a", "b", k * S) for k in range(31)))
    assert buffer.lookup("a", "b", int((30 - KEPT_S) * S)) is not None
    assert buffer.lookup("a", "b", int((30 - KEPT_S) * S) - 1) is None


def test_time_that_begins_anew_clears_what_was_before():
    old = [stamped("a", "b", (100 + k) * S, (9.0, 0, 0)) for k in range(5)]
    buffer = buffer_of(*old, stamped("a", "b", S, (1.0, 0, 0)), stamped("a", "b", 2 * S, (1.0, 0, 0)))
    pose, at_ns = buffer.lookup("a", "b")
    assert (pose.x_m, at_ns) == (1.0, 2 * S)
    assert buffer.lookup("a", "b", 103 * S) is None


@given(st.permutations(range(8)))
def test_samples_out_of_order_are_sorted_in(order):
    buffer = buffer_of(*(stamped("a", "b", (20 + k) * S, (float(k * k), 0, 0)) for k in order))
    assert [x_at(buffer, (20 + k) * S) for k in range(8)] == [float(k * k) for k in range(8)]
    assert [x_at(buffer, (20 + k) * S + S // 2) for k in range(7)] == [k * k + k + 0.5 for k in range(7)]
    assert buffer.lookup("a", "b")[1] == 27 * S


@pytest.mark.parametrize(
    ("target", "source", "told"),
    [
        ("a", "nobody", "no frame 'nobody' on /tf and /tf_static; there is a, b, x, y"),
        ("nobody", "b", "no frame 'nobody'"),
        ("a", "y", "'y' and 'a' are in two trees, under 'x' and 'a'"),
    ],
)
def test_what_is_missing_is_named(target, source, told):
    buffer = buffer_of(stamped("a", "b", S), static=[stamped("x", "y")])
    assert buffer.lookup(target, source) is None
    assert told in buffer.why_not(target, source)
    assert "none at all" in TransformBuffer().why_not(target, source)


def test_times_that_have_nothing_in_common_are_named():
    assert "one common time" in buffer_of(stamped("a", "b", S), stamped("b", "c", 2 * S)).why_not("a", "c")
