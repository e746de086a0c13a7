"""The buffer of transforms under what may come from anybody: circles, floods, and numbers that are none."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from transforms import S, buffer_of, stamped, x_at

from fleetmap.bridges.transforms import KEPT_S, LONGEST_CHAIN, MAX_FRAMES, MAX_NAME, MAX_SAMPLES, TransformBuffer


@given(st.lists(st.integers(0, 5), min_size=6, max_size=6))
def test_frames_in_a_circle_never_hang_a_lookup(parents):
    buffer = buffer_of(static=[stamped(f"f{parent}", f"f{child}") for child, parent in enumerate(parents)])
    assert buffer.refused == sum(child == parent for child, parent in enumerate(parents))
    for child, parent in enumerate(parents):
        assert buffer.lookup(f"f{parent}", f"f{child}") is not None
        assert isinstance(buffer.why_not("f0", f"f{child}"), str)
        assert buffer.lookup("elsewhere", f"f{child}") is None


@pytest.mark.parametrize(("links", "known"), [(LONGEST_CHAIN - 1, True), (LONGEST_CHAIN, False)])
def test_chains_are_followed_so_far_and_no_farther(links, known):
    buffer = buffer_of(static=[stamped(f"f{k}", f"f{k + 1}", 0, (1.0, 0, 0)) for k in range(links)])
    assert x_at(buffer, None, "f0", f"f{links}") == (float(links) if known else None)


NO_TRANSFORMS = {
    "NaN": {"shift": (0, math.nan, 0)},
    "infinite": {"shift": (0, 0, math.inf)},
    "no rotation": {"q": (0, 0, 0, 0)},
    "rotation that scales": {"q": (0, 0, 0, 1.2)},
    "rotation of NaN": {"q": (0, 0, math.nan, 1)},
    "rotation that overflows": {"q": (1e200, 0, 0, 1)},  # refused, but numpy warns of the overflow
    "no child": {"child": ""},
    "slash for a child": {"child": "/"},
    "no parent": {"parent": ""},
    "long child": {"child": "b" * (MAX_NAME + 1)},
    "long parent": {"parent": "a" * (MAX_NAME + 1)},
    "its own parent": {"parent": "b", "child": "/b"},
}


@pytest.mark.parametrize("wrong", NO_TRANSFORMS.values(), ids=NO_TRANSFORMS)
@pytest.mark.parametrize("static", [False, True])
def test_what_is_no_transform_is_refused_and_counted_and_the_next_one_taken(wrong, static):
    buffer = TransformBuffer()
    good = stamped("a", "good", S, (1.0, 0, 0))
    buffer.take([stamped(**{"parent": "a", "child": "b", "at_ns": S} | wrong), good], static=static)
    assert buffer.refused == 1
    assert buffer.lookup("a", "b") is None
    assert x_at(buffer, S, "a", "good") == 1.0


def test_long_names_and_rotations_that_were_rounded_are_taken():
    name = "b" * MAX_NAME
    buffer = buffer_of(stamped("a", name, S, (1.0, 0, 0), (0, 0, 0.95 * math.sin(0.3), 0.95 * math.cos(0.3))))
    assert buffer.lookup("a", name)[0].yaw_rad == pytest.approx(0.6)
    assert buffer.refused == 0


def test_numbers_that_overflow_on_the_way_are_no_error():
    # The bridge's tasks expect a pose or None of a lookup, and anybody may say this on /tf.
    buffer = buffer_of(stamped("a", "b", S, (1e308, 0, 0)), stamped("b", "c", S, (1e308, 0, 0)))
    with np.errstate(all="ignore"):
        assert buffer.lookup("a", "c") is None


def test_numbers_that_overflow_between_two_samples_are_no_error():
    buffer = buffer_of(stamped("a", "b", 1 * S, (-1e308, 0, 0)), stamped("a", "b", 3 * S, (1e308, 0, 0)))
    with np.errstate(all="ignore"):
        found = buffer.lookup("a", "b", 2 * S)
    assert found is None or math.isfinite(found[0].x_m)


def test_a_flood_of_frames_leaves_those_that_were_known():
    buffer = buffer_of(stamped("a", "b", S, (1.0, 0, 0)))
    buffer.take([stamped("a", f"flood{k}", S) for k in range(MAX_FRAMES + 99)], static=False)
    assert buffer.refused == 100
    buffer.take([stamped("a", "b", 2 * S, (2.0, 0, 0))], static=False)
    assert x_at(buffer, None) == 2.0
    assert buffer.lookup("a", f"flood{MAX_FRAMES - 2}") is not None
    assert buffer.lookup("a", f"flood{MAX_FRAMES - 1}") is None


def test_a_flood_of_samples_leaves_the_newest():
    buffer = buffer_of(*(stamped("a", "b", S + k, (float(k), 0, 0)) for k in range(MAX_SAMPLES + 50)))
    assert buffer.lookup("a", "b", S + 49) is None
    assert x_at(buffer, S + 50) == 50.0
    assert x_at(buffer, None) == MAX_SAMPLES + 49.0


@given(st.lists(st.integers(0, 60 * S), min_size=1, max_size=40))
def test_samples_ascend_and_span_what_is_kept_whatever_the_order(stamps_ns):
    buffer = buffer_of(*(stamped("a", "b", at_ns) for at_ns in stamps_ns))
    held = [at_ns for at_ns, _ in buffer._children["b"].samples]
    assert held == sorted(set(held))
    assert held[-1] - held[0] <= KEPT_S * S
    assert stamps_ns[-1] in held
