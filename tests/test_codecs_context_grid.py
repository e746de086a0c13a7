"""The exact layer: what goes in comes out, the page is enough to read it, and bad bytes only cost a refusal."""

from __future__ import annotations

import re
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from fleetmap.codecs.context_grid import CELLS_PER_BYTE, CHANCES, decode_states, encode_states
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


class Page:
    """A reader written from docs/format.md alone, one cell after the other."""

    def __init__(self, data: bytes) -> None:
        sizes, at = [], 0
        while len(sizes) < 2:
            value = shift = 0
            while True:
                byte, at = data[at], at + 1
                value |= (byte & 127) << shift
                shift += 7
                if byte < 128:
                    break
            sizes.append(value)
        self.height, self.width = sizes
        self.data, self.at = data, at + 4
        self.range = (1 << 32) - 1
        self.code = int.from_bytes((data[at : at + 4] + bytes(4))[:4], "big")
        self.counters: dict[tuple, list[int]] = {}
        self.weights: dict[tuple, list[int]] = {}
        points = (*CHANCES, 65536)
        self.s = {}
        for x in range(-3071, 3072):
            i, f = divmod(x + 3072, 128)
            self.s[x] = min(max((points[i] * (128 - f) + points[i + 1] * f) >> 7, 1), 65535)
        self.t = [next((x for x in self.s if self.s[x] >= 16 * q + 8), 3071) for q in range(4096)]

    def decide(self, chance: int) -> int:
        bound = (self.range >> 16) * chance
        value = int(self.code < bound)
        if value:
            self.range = bound
        else:
            self.code, self.range = self.code - bound, self.range - bound
        while self.range < 1 << 24:
            self.range <<= 8
            self.code = (self.code << 8) + (self.data[self.at] if self.at < len(self.data) else 0)
            self.at += 1
        return value

    def counter(self, *key: object) -> list[int]:
        return self.counters.setdefault(key, [1 << 21, 0])

    def learn(self, counter: list[int], value: int) -> None:
        chance, n = counter
        counter[0] = chance + ((((1 << 22) - 1 if value else 0) - chance) * (131072 // (2 * n + 3)) >> 16)
        counter[1] = min(n + 1, 1000)

    def read(self, base: np.ndarray | None) -> np.ndarray:
        cells = np.full((self.height, self.width), 2, int)

        def cell(grid, y, x):
            return int(grid[y, x]) if 0 <= y < self.height and 0 <= x < self.width else 2

        columns = [0] * self.width
        for y in range(self.height):
            run = 0
            for x in range(self.width):
                w, ww, www = (cell(cells, y, x - k) for k in (1, 2, 3))
                nww, nw, n, ne, nee = (cell(cells, y - 1, x + k) for k in (-2, -1, 0, 1, 2))
                nnw, nn, nne = (cell(cells, y - 2, x + k) for k in (-1, 0, 1))
                six, other = (w, nw, n, ne, ww, nn), (www, nww, nee, nnw, nne, cell(cells, y - 3, x))
                a, d = min(run.bit_length(), 12), min(columns[x].bit_length(), 12)
                here = None if base is None else tuple(cell(base, y + i, x + j) for i in (-1, 0, 1) for j in (-1, 0, 1))
                alike = {*six, *other} if here is None else {*six, *other, *(here[k] for k in (4, 5, 6, 7, 8))}
                found = []
                for which in range(2):
                    if len(alike) == 1:
                        counters = [self.counter("alike", which, w, a, d)]
                        value = self.decide(min(max(counters[0][0] >> 6, 2), 65534))
                    else:
                        wide = (n, ne, nee, cell(cells, y - 1, x + 3), w, nw, nww, cell(cells, y - 1, x - 3), ww)
                        keys = [six, six + other, (a, d, w, n, ne), wide]
                        if here is not None:
                            keys += [(*here, w, n), (*six, here[4], here[5], here[7])]
                        counters = [self.counter(k, which, key) for k, key in enumerate(keys)]
                        odds = [self.t[counter[0] >> 10] for counter in counters]
                        weights = self.weights.setdefault((which, w, n, ne), [22938] * len(keys))
                        mix = sum(i * j for i, j in zip(weights, odds, strict=True)) >> 16
                        chance = self.s[min(max(mix, -3071), 3071)]
                        value = self.decide(min(max(chance, 32), 65504))
                        for k, x_k in enumerate(odds):
                            weights[k] += (14 * x_k * (65535 * value - chance) + (1 << 17)) >> 18
                    for counter in counters:
                        self.learn(counter, value)
                    found.append(value)
                    if not value:
                        break
                state = w if not found[0] else (w + 1 + found[1]) % 3
                cells[y, x] = state
                run = run + 1 if state == w else 0
                columns[x] = columns[x] + 1 if state == n else 0
        return cells


@pytest.mark.parametrize("with_base", [False, True])
def test_the_page_is_enough_to_read_it(with_base):
    states = room(3)
    base = room(3) if with_base else None
    if base is not None:
        base[10:20, 10:20] = 1
    data = encode_states(states, base)
    assert (Page(data).read(base) == states).all()


def test_the_bytes_are_the_same_on_every_machine():
    golden = Path(__file__).parent / "data" / "exact.hex"
    assert encode_states(room(7)).hex() == re.sub(r"\s", "", golden.read_text())


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
