"""docs/format.md and docs/protocol.md: a reader that was written from the page alone agrees with the library."""

from __future__ import annotations

import hashlib

import format_reader
import numpy as np
import pytest
from golden import read_golden, rooms
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetmap.codecs import mode1_start, protocol
from fleetmap.codecs.context_grid import encode_states
from fleetmap.codecs.messages import Header
from fleetmap.engine.stream import Stream, Submap
from fleetmap.model.delta import diff
from fleetmap.model.lattice import Lattice
from fleetmap.model.pose import FixedPose, Pose2
from fleetmap.model.vectormap import VectorMap

MASK = (1 << 64) - 1
Map = dict[tuple[int, int, int, int, int], int]


def hashed(salt: int, *values: int) -> int:
    h = salt & MASK
    for value in values:
        h = ((h ^ (value & MASK)) + 0x9E3779B97F4A7C15) & MASK
        h = ((h ^ (h >> 30)) * 0xBF58476D1CE4E5B9) & MASK
        h = ((h ^ (h >> 27)) * 0x94D049BB133111EB) & MASK
        h ^= h >> 31
    return h


def text(salt: int, name: str) -> int:
    raw = name.encode()
    return hashed(salt, *raw, len(raw))


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


def test_the_page_and_the_library_digest_a_stream_the_same() -> None:
    anchor = FixedPose.from_pose(Pose2(1.0, -2.0, 0.5))
    start = FixedPose.from_pose(Pose2(0.0, 3.0, -1.0))
    vector_map = a_map([(0, 0, 0, 5, 1, 4)])
    stream = Stream("r-1", 3, 9, Header("level.2", start, (("q", 4), ("r-1", 2))), {"s": Submap(vector_map, anchor)})
    author = text(16, "r-1")
    pose = (start.x_um, start.y_um, start.cos_q30, start.sin_q30)
    total = hashed(text(author, "level.2"), 3, 1, *pose)
    total += hashed(text(author ^ 17, "q"), 4) + hashed(text(author ^ 17, "r-1"), 2)
    placed = (anchor.x_um, anchor.y_um, anchor.cos_q30, anchor.sin_q30)
    frame = hashed(text(author, "s"), 3)
    total += hashed(frame, vector_map.digest, 1_414_213_562, 0, *placed)
    assert stream.digest == total & MASK
