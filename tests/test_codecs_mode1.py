"""Mode 1 and its range coder: decisions come back, bytes have one form, and hostile ones cost little."""

from __future__ import annotations

import hashlib
import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetmap.codecs import mode1, protocol
from fleetmap.codecs.mode1_layout import CONTEXTS, REMOVED, ROOTS, WINDOWS
from fleetmap.codecs.mode1_start import START
from fleetmap.codecs.range_coder import Reader, Writer
from fleetmap.model.delta import apply, diff
from fleetmap.model.errors import ConfigError, WireError
from fleetmap.model.lattice import Lattice
from fleetmap.model.vectormap import VectorMap

TABLE = bytes([2, 60, 128, 253])
EMPTY = VectorMap.empty(Lattice(50_000))
DECISIONS = st.lists(st.tuples(st.integers(0, 4), st.integers(0, 1)), max_size=300)


def write(decisions: list[tuple[int, int]]) -> bytes:
    writer = Writer(TABLE)
    for context, value in decisions:
        assert (writer.bit(context, value) if context < 4 else writer.even(value)) == value
    return writer.finish()


def read(data: bytes, contexts: list[int]) -> list[int]:
    reader = Reader(TABLE, data)
    values = [reader.bit(context, 0) if context < 4 else reader.even(0) for context in contexts]
    reader.finish()
    return values


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


def test_the_start_table_is_the_one_of_the_format() -> None:
    assert len(START) == CONTEXTS
    assert min(START) >= 2
    assert max(START) <= 253
    assert hashlib.sha256(START).hexdigest() == "49f781ba5d645f25d948f38ba870de8d3b36c379cb6e96ddbc6129efe8a998bb"


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
    """n[c] of the format page, for numbers whose lower bits are all 0 but the last two."""
    length = value.bit_length()
    for i in range(length + 1):
        writer.bit(context + min(i, 11), int(i < length))
    if length > 1:
        writer.bit(context + 12 + min(length - 2, 11), value >> (length - 2) & 1)
        for i in range(length - 3, -1, -1):
            writer.even(value >> i & 1)


@pytest.mark.parametrize("count", [300, 4096, 2**20, 2**34 - 1])
@pytest.mark.parametrize("context", [WINDOWS, ROOTS, REMOVED])
def test_a_payload_holds_no_more_than_its_size_allows(count: int, context: int) -> None:
    """Counts that a few bytes can name, and that would take long to read or much memory."""
    base = squares(40)
    writer = Writer(START)
    if context != WINDOWS:
        write_number(writer, WINDOWS, int(context == REMOVED))
    if context == REMOVED:
        for before in range(WINDOWS + 24, REMOVED, 24):
            write_number(writer, before, 0)
    write_number(writer, context, count)
    with pytest.raises(WireError, match=r"may hold|34 bits"):
        protocol.decode(b"\x01" + writer.finish(), base, robot="r")


def test_large_deltas_go_in_mode_0() -> None:
    assert protocol.encode(diff(EMPTY, squares(2)), EMPTY)[0] & 0x0F == 1
    with pytest.raises(ConfigError, match="mode 0"):
        protocol.encode(diff(EMPTY, squares(600)), EMPTY, mode=1)
    assert protocol.encode(diff(EMPTY, squares(600)), EMPTY)[0] & 0x0F == 0


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
