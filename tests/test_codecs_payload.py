"""Deltas and payloads: what is encoded comes back, what is damaged is refused with ``WireError`` and nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from golden import read_golden
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetmap.codecs import mode0, protocol
from fleetmap.codecs.deflate import deflate, inflate
from fleetmap.codecs.leb128 import decode_leb128, encode_leb128, unzigzag, zigzag
from fleetmap.model.delta import apply, diff, find_rows
from fleetmap.model.errors import ConfigError, WireError
from fleetmap.model.lattice import MAX_COORDINATE, Lattice
from fleetmap.model.vectormap import VectorMap

LATTICE = Lattice(50_000)
LABELS = (1, 2, 3, 5, 6, 7)
EMPTY = VectorMap.empty(LATTICE)
MODES = st.sampled_from([0, 1, None])


def a_map(rows: list[tuple[int, ...]]) -> VectorMap:
    table = np.array(rows, np.int32).reshape(-1, 6)
    return VectorMap(LATTICE, table[:, :5], table[:, 5].astype(np.uint8))


def row(span: int) -> st.SearchStrategy[tuple[int, ...]]:
    coordinate = st.integers(-span, span)
    return st.tuples(
        coordinate, coordinate, coordinate, coordinate, st.sampled_from(LABELS), st.integers(0, 255)
    ).filter(lambda r: r[:2] != r[2:4])


def maps(span: int = 4) -> st.SearchStrategy[VectorMap]:
    # Few places, so that maps share edges and vertices.
    return st.lists(row(span), max_size=30).map(a_map)


def equal(a: VectorMap, b: VectorMap) -> bool:
    return a.digest == b.digest and np.array_equal(a.edges, b.edges) and np.array_equal(a.thickness, b.thickness)


@settings(max_examples=60)
@given(maps(), maps())
def test_a_delta_leads_from_one_map_to_the_other(old: VectorMap, new: VectorMap) -> None:
    delta = diff(old, new)
    assert equal(apply(old, delta), new)
    assert (len(delta) == 0) == equal(old, new)
    old_rows, new_rows = ({tuple(r) for r in m.edges.tolist()} for m in (old, new))
    assert {tuple(r) for r in delta.removed.tolist()} == old_rows - new_rows
    assert {tuple(r) for r in delta.added.tolist()} == new_rows - old_rows


@settings(max_examples=60)
@given(maps(), maps(), MODES)
def test_a_delta_survives_its_bytes(old: VectorMap, new: VectorMap, mode: int | None) -> None:
    payload = protocol.encode(diff(old, new), old, mode=mode)
    assert mode is None or payload[0] & 0x0F == mode
    assert equal(apply(old, protocol.decode(payload, old, robot="r")), new)


@settings(max_examples=50)
@given(maps(MAX_COORDINATE), MODES)
def test_a_snapshot_survives_its_bytes_at_the_bounds(new: VectorMap, mode: int | None) -> None:
    payload = protocol.encode(diff(EMPTY, new), EMPTY, mode=mode)
    assert equal(apply(EMPTY, protocol.decode(payload, EMPTY, robot="r")), new)


@settings(max_examples=40)
@given(maps())
def test_encoding_is_a_function_of_the_maps(new: VectorMap) -> None:
    again = VectorMap(LATTICE, new.edges[::-1], new.thickness[::-1])
    assert protocol.encode(diff(EMPTY, new), EMPTY) == protocol.encode(diff(EMPTY, again), EMPTY)


@settings(max_examples=40)
@given(maps(), maps())
def test_mode_1_is_sent_unless_another_is_named(old: VectorMap, new: VectorMap) -> None:
    """On odd maps of a few edges mode 0 may be a byte shorter; that isn't looked for."""
    delta = diff(old, new)
    payload = protocol.encode(delta, old)
    assert payload == protocol.encode(delta, old, mode=1)
    assert payload[0] & 0x0F == 1


def test_a_small_delta_takes_few_bytes() -> None:
    """A room whose wall gained a door: one edge gone, three new ones."""
    corners = [(0, 0), (0, 100), (80, 100), (80, 0)]
    walls = [(*a, *b, 1, 4) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
    door = [(0, 0, 0, 40, 1, 4), (0, 40, 0, 58, 2, 0), (0, 58, 0, 100, 1, 4)]
    old, new = a_map(walls), a_map(walls[1:] + door)
    assert len(protocol.encode(diff(old, new), old, mode=0)) <= 24
    assert len(protocol.encode(diff(old, new), old)) <= 20


@given(maps(), st.binary(max_size=60))
def test_random_bytes_are_refused_or_a_delta(base: VectorMap, payload: bytes) -> None:
    try:
        apply(base, protocol.decode(payload, base, robot="r"))
    except (WireError, ValueError) as error:
        assert isinstance(error, WireError) or "delta" in str(error)


@settings(max_examples=100)
@given(maps(), maps(), MODES, st.data())
def test_damaged_payloads_are_refused_or_a_delta(
    old: VectorMap, new: VectorMap, mode: int | None, data: st.DataObject
) -> None:
    payload = bytearray(protocol.encode(diff(old, new), old, mode=mode))
    for _ in range(data.draw(st.integers(1, 3))):
        place = data.draw(st.integers(0, len(payload) - 1))
        payload[place] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(0, len(payload)))
    for damaged in (bytes(payload), bytes(payload[:cut])):
        try:
            delta = protocol.decode(damaged, old, robot="r")
        except WireError as error:
            assert error.robot == "r"
            assert error.size_bytes == len(damaged)
        else:
            assert find_rows(old.edges, delta.removed).min(initial=0) >= 0


def test_a_bomb_is_refused_before_it_expands() -> None:
    bomb = bytes([0x10]) + deflate(b"\x00" * (64 << 20))
    assert len(bomb) < 100_000
    with pytest.raises(WireError, match="longer than"):
        protocol.decode(bomb, EMPTY, robot="r")


def test_a_map_that_no_peer_could_read_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mode0, "MAX_INFLATED_BYTES", 20)
    with pytest.raises(ConfigError, match="submaps"):
        protocol.encode(diff(EMPTY, a_map([(i, 0, i, 5, 1, 4) for i in range(9)])), EMPTY, mode=0)


@pytest.mark.parametrize(
    ("counts", "reason"),
    [
        ([1, 0, 0, 0, 0, 0], "expected 1 more"),
        ([0, 0, 0, 2**34, 0, 0], "more numbers"),
        ([0, 0, 0, 1, 0, 0, 1, 2, 2], "no root"),
        ([0, 0, 0, 0, 0, 0, 7], "left over"),
        ([1, 0, 0, 0, 0, 0, 5], "not below"),
        ([0, 0, 1, 1, 0, 0, 0, 0, 2 * 3 * 2**32], "longer than the payload"),
        ([0, 0, 1, 1, 1, 0, 0, 0, 0, 0, 1, 9, 5], "thickness"),
        ([0, 0, 1, 1, 0, 0, 2**34, 0, 2, 0, 1], "farther"),
    ],
)
def test_counts_that_lie_are_refused(counts: list[int], reason: str) -> None:
    payload = b"\x00" + encode_leb128(np.array(counts, np.int64))
    with pytest.raises(WireError, match=reason):
        protocol.decode(payload, EMPTY, robot="r")


@pytest.mark.parametrize("payload", [b"", b"\x0f", b"\x40", b"\x10", b"\x10\xff"])
def test_what_is_no_payload_is_refused(payload: bytes) -> None:
    with pytest.raises(WireError):
        protocol.decode(payload, EMPTY, robot="r")


def test_a_delta_that_does_not_fit_its_base_is_refused() -> None:
    old, new = a_map([(0, 0, 0, 5, 1, 4)]), a_map([(0, 0, 3, 5, 1, 4)])
    with pytest.raises(ValueError, match="does not have"):
        apply(new, diff(old, new))
    with pytest.raises(ValueError, match="twice"):
        apply(new, diff(EMPTY, new))
    with pytest.raises(ValueError, match="lattices"):
        diff(old, VectorMap.empty(Lattice(20_000)))


@given(st.lists(st.integers(0, 2**35 - 1)))
def test_leb128_comes_back(values: list[int]) -> None:
    assert decode_leb128(encode_leb128(np.array(values, np.int64))).tolist() == values


@given(st.lists(st.integers(0, 2**35 - 1), min_size=1))
def test_leb128_is_the_plain_one(values: list[int]) -> None:
    plain = bytearray()
    for value in values:
        while value > 127:
            plain.append(128 | (value & 127))
            value >>= 7
        plain.append(value)
    assert encode_leb128(np.array(values, np.int64)) == bytes(plain)


@pytest.mark.parametrize("data", [b"\x80", b"\x80\x00", b"\xff" * 5 + b"\x01"])
def test_leb128_has_one_form(data: bytes) -> None:
    with pytest.raises(ValueError, match="number"):
        decode_leb128(data)


def test_leb128_refuses_what_it_cannot_write() -> None:
    for value in (-1, 2**35):
        with pytest.raises(ValueError, match="2\\^35"):
            encode_leb128(np.array([value], np.int64))


@given(st.lists(st.integers(-(2**40), 2**40)))
def test_zigzag_comes_back(values: list[int]) -> None:
    array = np.array(values, np.int64)
    assert zigzag(array).min(initial=0) >= 0
    assert np.array_equal(unzigzag(zigzag(array)), array)


def test_inflate_is_exact() -> None:
    data = deflate(b"abc" * 100)
    assert inflate(data, max_bytes=300) == b"abc" * 100
    for damaged in (data[:-1], data + b"x", b"\xff"):
        with pytest.raises(ValueError, match="deflate"):
            inflate(damaged, max_bytes=300)
    with pytest.raises(ValueError, match="longer than 299"):
        inflate(data, max_bytes=299)


@pytest.mark.parametrize("mode", [0, 1])
def test_golden_payloads_are_read(mode: int) -> None:
    """The bytes of format version 1: a change here breaks every fleet that is under way."""
    runs = read_golden(f"mode{mode}")
    for run in runs:
        base = EMPTY
        for payload, digest in run:
            delta = protocol.decode(payload, base, robot="golden")
            assert protocol.encode(delta, base, mode=mode) == payload
            base = apply(base, delta)
            assert f"{base.digest:016x}" == digest
    assert [len(run) for run in runs] == [3, 2, 5, 7, 7, 2, 1]


@pytest.mark.parametrize("mode", [0, 1])
def test_each_flipped_bit_of_a_golden_payload_is_refused_or_gives_a_map(mode: int) -> None:
    """Of the shorter payloads: benchmarks/fuzz_codec.py takes all of them."""
    for run in read_golden(f"mode{mode}"):
        base = EMPTY
        for payload, _ in run:
            for bit in range(8 * len(payload) if len(payload) < 120 else 0):
                damaged = bytearray(payload)
                damaged[bit // 8] ^= 1 << bit % 8
                try:
                    found = apply(base, protocol.decode(bytes(damaged), base, robot="golden"))
                except (WireError, ValueError):
                    continue
                rows = VectorMap(found.lattice, found.edges, found.thickness)  # checks them
                assert rows.digest == found.digest
            base = apply(base, protocol.decode(payload, base, robot="golden"))
