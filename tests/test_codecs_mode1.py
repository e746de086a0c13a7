"""Mode 1 and its range coder: decisions come back, bytes have one form, and hostile ones cost little."""

from __future__ import annotations

import hashlib
import itertools
import re
from pathlib import Path

import numpy as np
import pytest
from golden import grid, rooms, with_thickness
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetmap.codecs import mode1, mode1_layout, protocol
from fleetmap.codecs.mode1_layout import CONTEXTS, FIRST_BAND, LOWER, REMOVED, ROOTS, WINDOWS
from fleetmap.codecs.mode1_start import DELTA, SNAPSHOT
from fleetmap.codecs.range_coder import Reader, Writer
from fleetmap.model.delta import apply, diff
from fleetmap.model.errors import ConfigError, WireError
from fleetmap.model.lattice import Lattice
from fleetmap.model.vectormap import VectorMap
from fleetmap.vectorize import vectorize

TABLE = bytes([2, 60, 128, 253])
EMPTY = VectorMap.empty(Lattice(50_000))
DECISIONS = st.lists(st.tuples(st.integers(0, 4), st.integers(0, 1)), max_size=300)


def write(decisions: list[tuple[int, int]]) -> bytes:
    writer = Writer(TABLE, bytes(4))
    for context, value in decisions:
        assert (writer.bit(context, value) if context < 4 else writer.even(value)) == value
    return writer.finish()


def read(data: bytes, contexts: list[int]) -> list[int]:
    reader = Reader(TABLE, bytes(4), data)
    values = [reader.bit(context, 0) if context < 4 else reader.even(0) for context in contexts]
    reader.finish()
    return values


def read_map(payload: bytes) -> VectorMap:
    """The map of a snapshot."""
    return apply(EMPTY, protocol.decode(payload, EMPTY, robot="r"))


def squares(count: int) -> VectorMap:
    """Rooms in a row, no two alike."""
    rows = []
    for i in range(count):
        x, size = 40 * i, 5 + i * i % 23
        corners = [(0, x), (0, x + size), (size, x + size), (size, x)]
        rows += [(*a, *b, 1) for a, b in itertools.pairwise([*corners, corners[0]])]
    return VectorMap(EMPTY.lattice, np.array(rows, np.int32), np.full(len(rows), 4, np.uint8))


@given(DECISIONS)
def test_decisions_come_back(decisions: list[tuple[int, int]]) -> None:
    assert read(write(decisions), [context for context, _ in decisions]) == [value for _, value in decisions]


@given(st.integers(0, 4), st.integers(0, 1), st.integers(0, 5000))
def test_what_is_expected_costs_little_and_still_comes_back(context: int, value: int, count: int) -> None:
    data = write([(context, value)] * count)
    assert read(data, [context] * count) == [value] * count
    if context < 4:
        assert len(data) <= 12 + count // 200


@given(DECISIONS, st.binary(max_size=6))
def test_bytes_have_one_form(decisions: list[tuple[int, int]], data: bytes) -> None:
    """What a reader accepts is exactly what a writer gives for the same decisions."""
    contexts = [context for context, _ in decisions]
    for candidate in (data, write(decisions) + data, write(decisions)[:-1] + data):
        try:
            values = read(candidate, contexts)
        except ValueError:
            continue
        assert write(list(zip(contexts, values, strict=True))) == candidate


def test_short_bytes_have_one_form() -> None:
    contexts = [0, 1, 2, 3, 4, 2, 2]
    written = {write(list(zip(contexts, values, strict=True))) for values in itertools.product((0, 1), repeat=7)}
    assert len(written) == 2**7
    accepted = set()
    for size in range(3):
        for data in itertools.product(range(256), repeat=size):
            try:
                read(bytes(data), contexts)
            except ValueError:
                continue
            accepted.add(bytes(data))
    assert accepted == {data for data in written if len(data) < 3}


def test_the_start_tables_are_those_of_the_format() -> None:
    tables = [*DELTA, *SNAPSHOT]
    assert {len(table) for table in tables} == {CONTEXTS}
    assert (
        hashlib.sha256(b"".join(tables)).hexdigest()
        == "bbb18ab0d4af87b206321a4195e9205c3c5a70ede0b5bb3eeddad5a71828a6df"
    )


def test_the_page_names_the_contexts_that_the_kernels_use() -> None:
    page = (Path(__file__).parent.parent / "docs" / "format.md").read_text()
    named = {name: int(number) for number, name in re.findall(r"(\d+) \| ([A-Z_]{3,})", page)}
    assert {name: getattr(mode1_layout, name) for name in mode1_layout._SIZES} == named


@settings(max_examples=300)
@given(st.binary(max_size=80), st.integers(0, 6))
def test_random_bytes_are_refused_or_the_form_of_a_delta(data: bytes, rooms: int) -> None:
    base = squares(rooms) if rooms else EMPTY
    try:
        delta = protocol.decode(b"\x01" + data, base, robot="r")
    except WireError as error:
        assert error.robot == "r"
    else:
        assert len(delta) <= 3 * (mode1.EDGES + mode1.EDGES_PER_BYTE * (1 + len(data)))


@settings(max_examples=300)
@given(st.data())
def test_flipped_and_cut_payloads_are_refused_or_a_delta(data: st.DataObject) -> None:
    old, new = squares(3), squares(6)
    payload = bytearray(protocol.encode(diff(old, new), old, mode=1))
    for _ in range(data.draw(st.integers(0, 3))):
        payload[data.draw(st.integers(1, len(payload) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    damaged = bytes(payload[: data.draw(st.integers(1, len(payload)))])
    try:
        apply(old, protocol.decode(damaged, old, robot="r"))
    except (WireError, ValueError) as error:
        assert isinstance(error, WireError) or "delta" in str(error)


def test_bytes_behind_the_end_are_refused() -> None:
    payload = protocol.encode(diff(EMPTY, squares(4)), EMPTY, mode=1)
    for more in (b"\x00", b"\x01", b"\xff\xff\xff\xff\xff\xff"):
        with pytest.raises(WireError):
            protocol.decode(payload + more, EMPTY, robot="r")


@pytest.mark.parametrize("flags", [0x11, 0x41, 0x81])
def test_unknown_flags_are_refused(flags: int) -> None:
    with pytest.raises(WireError, match="unknown flags"):
        protocol.decode(bytes([flags]), EMPTY, robot="r")


def write_number(writer: Writer, context: int, value: int) -> None:
    """N[c] of the format page."""
    length = (value + 1).bit_length() - 1
    for i in range(length + 1):
        writer.bit(context + min(i, 12), int(i < length))
    for k in range(length):
        bit = (value + 1) >> (length - 1 - k) & 1
        if length > 13:
            writer.even(bit)
        else:
            so_far = (value + 1) >> (length - k)
            writer.bit(LOWER + 39 * length + 3 * (so_far - 1 if k < 3 else min(4 + k, 12)), bit)


@pytest.mark.parametrize("count", [300, 4096, 2**20, 2**34 - 2])
@pytest.mark.parametrize("context", [WINDOWS, ROOTS, REMOVED])
def test_a_payload_holds_no_more_than_its_size_allows(count: int, context: int) -> None:
    """Counts that a few bytes can name, and that would take long to read or much memory."""
    base = squares(40)
    writer = Writer(*DELTA)
    if context != WINDOWS:
        write_number(writer, WINDOWS, int(context == REMOVED))
    if context == REMOVED:
        for before in range(FIRST_BAND, REMOVED, 13):
            write_number(writer, before, 0)
    write_number(writer, context, count)
    with pytest.raises(WireError, match="may hold"):
        protocol.decode(b"\x01" + writer.finish(), base, robot="r")


def test_a_number_has_no_more_than_34_bits() -> None:
    writer = Writer(*SNAPSHOT)
    write_number(writer, WINDOWS, 2**35 - 1)
    with pytest.raises(WireError, match="34 bits"):
        protocol.decode(b"\x01" + writer.finish(), EMPTY, robot="r")


@pytest.mark.parametrize("count", [300, 40_000])
def test_equal_squares_go_in_mode_0(count: int) -> None:
    """Each costs next to nothing, and a payload of mode 1 holds no more than 16 edges a byte, and 2^17."""
    corners = np.array([[0, 0, 0, 2, 2], [0, 0, 2, 0, 6], [0, 2, 2, 2, 2], [2, 0, 2, 2, 6]])
    rows = (corners + np.arange(count)[:, None, None] * np.array([4, 0, 4, 0, 0])).reshape(-1, 5).astype(np.int32)
    vector_map = VectorMap(EMPTY.lattice, rows, np.zeros(len(rows), np.uint8))
    payload = protocol.encode_snapshot(vector_map)
    assert payload[0] & 0x0F == 0
    assert read_map(payload).digest == vector_map.digest
    with pytest.raises(ConfigError, match="is for mode 0"):
        protocol.encode_snapshot(vector_map, mode=1)


@settings(max_examples=40)
@given(st.integers(0, 10**6), st.sampled_from(["share", "full"]), st.booleans())
def test_whole_maps_come_back_and_take_less_than_in_mode_0(seed: int, profile: str, thick: bool) -> None:
    vector_map = vectorize(grid(rooms(seed)), profile=profile)
    vector_map = with_thickness(vector_map, seed) if thick else vector_map
    payload = protocol.encode_snapshot(vector_map)
    assert payload[0] & 0x0F == 1
    assert read_map(payload).digest == vector_map.digest
    assert len(payload) < 0.85 * len(protocol.encode_snapshot(vector_map, mode=0))


def test_each_flipped_bit_is_refused_or_gives_another_map() -> None:
    vector_map = vectorize(grid(rooms(3)))
    payload = protocol.encode_snapshot(vector_map)
    refused = 0
    for bit in range(8, 8 * len(payload)):
        damaged = bytearray(payload)
        damaged[bit // 8] ^= 1 << bit % 8
        try:
            other = read_map(bytes(damaged))
        except (WireError, ValueError):
            refused += 1
            continue
        assert other.digest != vector_map.digest
    assert refused > 0


def test_bands_with_too_many_edges_are_for_mode_0(monkeypatch: pytest.MonkeyPatch) -> None:
    old = squares(4)
    new = apply(old, diff(old, VectorMap(old.lattice, old.edges[1:], old.thickness[1:])))
    payload = protocol.encode(diff(old, new), old, mode=1)
    monkeypatch.setattr(mode1, "MAX_PASSED", 11)
    assert protocol.encode(diff(old, new), old)[0] & 0x0F == 0
    with pytest.raises(WireError, match="more than 11 edges"):
        protocol.decode(payload, old, robot="r")


def tiled(shift: int) -> VectorMap:
    """Squares in nine places that lie far from each other, all of them moved a little."""
    rows = [
        (y + shift, x, y + shift, x + 9, 1) if shift else (y, x, y, x + 9, 1)
        for y in (-9000, 0, 9000)
        for x in (-9000, 0, 9000)
    ]
    return VectorMap(EMPTY.lattice, np.array(rows, np.int32), np.full(len(rows), 4, np.uint8))


def test_scattered_removals_come_back() -> None:
    old, new = tiled(0), tiled(3)
    payload = protocol.encode(diff(old, new), old, mode=1)
    assert apply(old, protocol.decode(payload, old, robot="r")).digest == new.digest


def test_what_lies_elsewhere_costs_no_bytes() -> None:
    """The same change in a map with as many rooms again, far away in y, and then in x."""
    near = squares(9)
    change = np.arange(len(near)) % 5 > 0
    sizes = []
    for offset in ([0, 0, 0, 0, 0], [20_000, 0, 20_000, 0, 0], [0, 20_000, 0, 20_000, 0]):
        rows = np.concatenate([near.edges, near.edges + offset])
        keep = np.concatenate([change, np.ones(len(near), bool)])
        old = VectorMap(near.lattice, rows, np.full(len(rows), 4, np.uint8))
        new = VectorMap(near.lattice, rows[keep], np.full(int(keep.sum()), 4, np.uint8))
        if any(offset):
            sizes.append(len(protocol.encode(diff(old, new), old, mode=1)))
        else:
            kept = VectorMap(near.lattice, near.edges[change], near.thickness[change])
            sizes.append(len(protocol.encode(diff(near, kept), near, mode=1)))
    assert sizes[1] == sizes[0]
    assert sizes[2] == sizes[0]
