"""docs/format.md and docs/protocol.md: a reader that was written from the page alone agrees with the library."""

from __future__ import annotations

import hashlib
import json

import format_reader
import golden
import msgpack
import numpy as np
import pytest
from golden import SEED, read_golden, rooms
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetmap.codecs import envelope, mode1_start, protocol
from fleetmap.codecs.context_grid import encode_states
from fleetmap.codecs.facts import Facts
from fleetmap.codecs.messages import Record, SnapshotChunk
from fleetmap.engine import Chain, Limits, Stream
from fleetmap.engine.author import Author
from fleetmap.engine.chain import before
from fleetmap.engine.holdings import Holdings
from fleetmap.engine.replica import Replica
from fleetmap.model.delta import diff
from fleetmap.model.lattice import Lattice
from fleetmap.model.pose import FixedPose
from fleetmap.model.vectormap import VectorMap

Map = dict[tuple[int, int, int, int, int], int]


def plain(vector_map: VectorMap) -> Map:
    rows = zip(vector_map.edges.tolist(), vector_map.thickness.tolist(), strict=True)
    return {(y0, x0, y1, x1, label): depth for (y0, x0, y1, x1, label), depth in rows}


LATTICE = Lattice(50_000, FixedPose(-7, 2**39, 0, -(2**30)))
_PLACE = st.integers(-4, 4)
_ROWS = st.lists(
    st.tuples(
        _PLACE, _PLACE, _PLACE, _PLACE, st.sampled_from([1, 2, 3, 5, 6, 7]), st.sampled_from([0, 0, 4, 255])
    ).filter(lambda r: r[:2] != r[2:4]),
    max_size=25,
)
_MAPS = st.builds(lambda rows, scale: a_map(rows, scale), _ROWS, st.sampled_from([1, 97, 2**18]))
"""Within a band, over a dozen bands and columns, and to the bounds."""


def a_map(rows: list[tuple[int, ...]], scale: int = 1) -> VectorMap:
    table = np.array(rows, np.int32).reshape(-1, 6)
    return VectorMap(LATTICE, table[:, :5] * [scale, scale, scale, scale, 1], table[:, 5].astype(np.uint8))


@settings(max_examples=200)
@given(_MAPS, _MAPS, st.sampled_from([0, 1]))
def test_the_page_and_the_library_read_the_same(old: VectorMap, new: VectorMap, mode: int) -> None:
    payload = protocol.encode(diff(old, new), old, mode=mode)
    assert format_reader.read_payload(payload, plain(old), mode1_start) == plain(new)


@pytest.mark.parametrize("mode", [0, 1])
def test_the_page_is_enough_for_the_golden_payloads(mode: int) -> None:
    for run in read_golden(f"mode{mode}"):
        edges: Map = {}
        for payload, digest in run:
            edges = format_reader.read_payload(payload, edges, mode1_start)
            assert f"{format_reader.digest(edges, 50_000, 0, 0, 1 << 30, 0):016x}" == digest


def test_the_page_is_enough_for_the_golden_grids() -> None:
    base = None
    for ((payload, digest),) in read_golden("exact"):
        base = format_reader.read_exact(payload, base)
        assert hashlib.sha256(b"".join(map(bytes, base))).hexdigest() == digest


@pytest.mark.parametrize("seed", [1, 2])
def test_the_page_and_the_library_read_the_same_grids(seed: int) -> None:
    states, base = rooms(seed, height=40, width=50), rooms(seed + 10, height=40, width=50)
    assert format_reader.read_exact(encode_states(states), None) == states.tolist()
    assert format_reader.read_exact(encode_states(states, base), base.tolist()) == states.tolist()


@given(_MAPS)
def test_the_page_and_the_library_digest_the_same(vector_map: VectorMap) -> None:
    found = format_reader.digest(plain(vector_map), 50_000, -7, 2**39, 0, -(2**30))
    assert found == vector_map.digest


_FACTS = st.dictionaries(st.binary(min_size=1, max_size=4), st.binary(max_size=4), max_size=4)
_NAMES = st.sampled_from(["0", "s", "r-1", "level.2"])


@given(_NAMES, st.integers(0, 2**64 - 1), _FACTS, st.dictionaries(_NAMES, _MAPS, max_size=2))
def test_the_page_and_the_library_digest_a_stream_the_same(
    robot: str, life: int, facts: dict[bytes, bytes], maps: dict[str, VectorMap]
) -> None:
    stream = Stream(robot, life, 9, Facts(facts), maps)
    headers = {
        name: [50_000, [-7, 2**39, 0, -(2**30)], vector_map.epsilon_cells, 0] for name, vector_map in maps.items()
    }
    submaps = {name: (headers[name], plain(vector_map)) for name, vector_map in maps.items()}
    assert format_reader.stream_digest(robot, life, facts, submaps) == stream.digest


def test_the_page_is_enough_for_the_golden_records() -> None:
    records, chunks, _ = read_golden("messages", "v2")
    life = None
    facts: dict[bytes, bytes] = {}
    submaps: dict[str, object] = {}
    before = 0
    for raw, told in records:
        kind, (seq, link, check, *change) = format_reader.read_message(raw)
        facts, submaps = format_reader.read_change(change, facts, submaps, mode1_start)
        last, life = life, link
        for n in range(seq, before, -1):
            life = format_reader.link_before(life, n)
        if last is None:
            first = life  # of the whole chain: seq 0
        else:
            assert life == last
        digest = format_reader.stream_digest("r7", first, facts, submaps)
        assert (kind, f"{seq} {link:016x} {digest:016x}") == (1, told)
        assert check == digest % 2**16
        life, before = link, seq
    data = b""
    for index, (raw, told) in enumerate(chunks):
        kind, (seq, digest, link, *place, part) = format_reader.read_message(raw)
        assert (kind, place) == (2, [index, len(chunks)])
        assert f"{seq} {link:016x} {digest:016x}" == told
        data += part
    whole = format_reader.read_change(msgpack.unpackb(data), {}, {}, mode1_start)
    assert whole == (facts, submaps)


def test_the_page_is_enough_for_the_other_golden_messages() -> None:
    *_, others = read_golden("messages", "v2")
    kinds = []
    for raw, told in others:
        kind, fields = format_reader.read_message(raw)
        assert fields == json.loads(told)
        kinds.append(kind)
    assert kinds == [3, 4, 4, 5, 3, 3, 6, 6, 7, 9, 8]


def test_the_library_reads_and_writes_the_golden_messages() -> None:
    for run in read_golden("messages", "v2"):
        for raw, _ in run:
            assert envelope.encode(envelope.decode(raw, robot="r7")) == raw


def test_the_library_takes_the_golden_records_and_the_golden_snapshot() -> None:
    records, chunks, _ = read_golden("messages", "v2")
    life = Chain(SEED, revisions=300).life
    one, other = Replica(Stream("r7", life)), Replica(Stream("r7", life))
    for raw, told in records:
        message = envelope.decode(raw, robot="r7")
        assert isinstance(message, Record)
        one.offer(message, raw, Limits(), by_author=True)
        assert f"{one.stream.seq} {one.stream.link:016x} {one.stream.digest:016x}" == told
    for raw, _ in chunks:
        message = envelope.decode(raw, robot="r7")
        assert isinstance(message, SnapshotChunk)
        other.offer_chunk(message, Limits(), speaker=("mirror", 1))
    assert other.stream.revision == one.stream.revision
    assert other.stream.facts == one.stream.facts


def test_the_golden_messages_are_what_an_author_says_today() -> None:
    records, _, others = read_golden("messages", "v2")
    assert [(raw, f"{s.seq} {s.link:016x} {s.digest:016x}") for raw, s in golden.revisions()] == records
    assert [envelope.encode(message) for message, _ in golden.OTHERS] == [raw for raw, _ in others]


@given(st.lists(st.tuples(_NAMES, *[st.integers(0, 2**64 - 1)] * 3), max_size=3, unique_by=lambda row: row[:2]))
def test_the_page_and_the_library_hash_the_same_over_all_that_is_held(rows: list[tuple[str, int, int, int]]) -> None:
    author = Author("me", Chain(SEED, revisions=4))
    holdings = Holdings(author)
    for robot, life, seq, _ in rows:
        replica = holdings.to_change((robot, life))
        holdings.hold(replica)
        replica.stream = Stream(robot, life, seq + 1, Facts({b"x": b""}), {}, 1)
    held = [(s.robot, s.life, s.seq, s.digest) for s in holdings.streams()]
    assert len(held) == len(rows) + 1
    assert format_reader.held_hash(held) == holdings.held_hash()


def test_the_page_and_the_library_count_links_the_same() -> None:
    chain = Chain(SEED, revisions=300)
    for seq in (1, 2, 44, 45, 256, 300):
        assert format_reader.link_before(chain.link(seq), seq) == chain.link(seq - 1)
        assert before(chain.link(seq), seq, seq) == chain.life == chain.link(0)
    with pytest.raises(ValueError, match="300 revisions"):
        chain.link(301)
