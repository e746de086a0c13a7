"""The exact layer: what goes in comes out, the page is enough to read it, and bad bytes only cost a refusal."""

from __future__ import annotations

import hashlib
import time

import numpy as np
import pytest
from golden import read_golden
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from fleetmap.codecs.context_grid import CELLS_PER_BYTE, decode_states, encode_states
from fleetmap.codecs.leb128 import encode_leb128
from fleetmap.model.errors import WireError

grids = hnp.arrays(
    np.uint8, hnp.array_shapes(min_dims=2, max_dims=2, min_side=0, max_side=24), elements=st.integers(0, 2)
)


def room(seed=0, height=40, width=53):
    """Free space with ragged walls, unknown behind."""
    rng = np.random.default_rng(seed)
    states = np.full((height, width), 2, np.uint8)
    states[4:-4, 4:-4] = 1
    states[6:-6, 6:-6] = 0
    noise = rng.random(states.shape) < 0.05
    states[noise] = rng.integers(0, 3, int(noise.sum()))
    return states


@settings(deadline=None)
@given(grids)
def test_what_goes_in_comes_out(states):
    assert (decode_states(encode_states(states)) == states).all()


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10**6))
def test_a_base_makes_it_smaller_the_more_it_resembles(seed):
    states = room(seed)
    base = states.copy()
    base[np.random.default_rng(seed).random(states.shape) < 0.002] = 2
    data = encode_states(states, base)
    assert (decode_states(data, base) == states).all()
    assert len(data) < 0.75 * len(encode_states(states))


def test_large_uniform_grids_take_next_to_nothing():
    assert len(encode_states(np.zeros((2000, 2000), np.uint8))) < 80


def test_the_bytes_are_the_same_on_every_machine():
    """Format version 1: a change here breaks whoever keeps grids."""
    base = None
    for ((payload, digest),) in read_golden("exact"):
        states = decode_states(payload, base)
        assert hashlib.sha256(states.tobytes()).hexdigest() == digest
        assert encode_states(states, base) == payload
        base = states


@settings(deadline=None)
@given(st.binary(max_size=200))
def test_any_bytes_are_refused_or_states(data):
    try:
        states = decode_states(data)
    except WireError:
        return
    assert states.max(initial=0) <= 2
    assert encode_states(states) == data


def test_each_flipped_bit_is_refused_or_gives_states_of_its_own():
    data = encode_states(room(7))
    states = decode_states(data)
    refused = 0
    for bit in range(8 * len(data)):
        damaged = bytearray(data)
        damaged[bit // 8] ^= 1 << bit % 8
        try:
            other = decode_states(bytes(damaged))
        except WireError:
            refused += 1
            continue
        assert other.shape != states.shape or (other != states).any()
        assert other.max() <= 2
    assert refused > 0


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "cut off"),
        (b"\x05", "cut off"),
        (b"\xff" * 12, "cut off"),
        (b"\x80\x00\x05abcd", "shortest form"),
        (encode_leb128(np.array([1 << 20, 1 << 20])) + b"abcd", "more than"),
        (encode_leb128(np.array([1, 2 * CELLS_PER_BYTE * 9])) + b"abcd", "more than"),
        (encode_states(room()) + b"\x01", "left over|shortest"),
        (encode_states(room())[:2] + bytes(4), "shortest"),
    ],
)
def test_refusals_say_why(data, reason):
    with pytest.raises(WireError, match=reason):
        decode_states(data)


def test_zeros_behind_the_end_are_not_read_for_ever():
    data = encode_leb128(np.array([3000, 4000])) + encode_states(room())[2:]
    started = time.process_time()
    with pytest.raises(WireError, match="shortest"):
        decode_states(data)
    assert time.process_time() - started < 2.0


def test_another_base_is_refused_or_noticed():
    states = room()
    with pytest.raises(WireError, match="the base has"):
        decode_states(encode_states(states, states), states[1:])
    with pytest.raises(ValueError, match="expected a base of 40 x 53"):
        encode_states(states, states[1:])
    with pytest.raises(ValueError, match="states up to 2"):
        encode_states(np.full((2, 2), 3, np.uint8))
