"""docs/format.md, read by a decoder that was written from that page alone: it must agree with the library."""

from __future__ import annotations

import zlib
from collections.abc import Iterator

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetmap.codecs import protocol
from fleetmap.codecs.messages import Header
from fleetmap.engine.stream import Stream, Submap
from fleetmap.model.delta import diff
from fleetmap.model.lattice import Lattice
from fleetmap.model.pose import FixedPose, Pose2
from fleetmap.model.vectormap import VectorMap

MASK = (1 << 64) - 1
Edge = tuple[int, int, int, int, int]
Map = dict[Edge, int]
CLASSES = {0: (0, 1), 1: (0, 2), 2: (1, 2)}


def leb128(data: bytes) -> Iterator[int]:
    value = shift = 0
    for byte in data:
        value |= (byte & 127) << shift
        shift += 7
        if byte < 128:
            yield value
            value = shift = 0


def signed(number: int) -> int:
    return number // 2 if number % 2 == 0 else -(number + 1) // 2


def decode(payload: bytes, base: Map) -> Map:
    body = zlib.decompress(payload[1:], -15) if payload[0] & 0x10 else payload[1:]
    numbers = leb128(body)
    removed_n, known_n, absolute_n, chains_n, runs_n, rethickened_n = (next(numbers) for _ in range(6))
    order = sorted(base)

    def places(count: int) -> Iterator[int]:
        place = -1
        for _ in range(count):
            place += next(numbers) + 1
            yield place

    removed = [order[place] for place in places(removed_n)]
    known = sorted({point for e in removed for point in (e[:2], e[2:4])})
    roots, place = [], 0
    for _ in range(known_n):
        place += next(numbers)
        roots.append(known[place])
    y, x = removed[0][:2] if removed else (0, 0)
    for _ in range(absolute_n):
        y, x = y + signed(next(numbers)), x + signed(next(numbers))
        roots.append((y, x))
    heads = [next(numbers) for _ in range(chains_n)]
    added: list[tuple[Edge, int]] = []
    waiting = iter(roots)
    for head in heads:
        continues, kind, count = head % 2, head // 2 % 3, head // 6 + 1
        if not continues:
            y, x = next(waiting)
        left, right = CLASSES[kind]
        for _ in range(count):
            end = (y + signed(next(numbers)), x + signed(next(numbers)))
            edge = (y, x, *end, 3 * left + right) if (y, x) < end else (*end, y, x, 3 * right + left)
            added.append((edge, kind))
            y, x = end
    thickness: list[int] = []
    for _ in range(runs_n):
        value, length = next(numbers), next(numbers)
        thickness += [value] * length
    depths = iter(thickness)
    result = {edge: depth for edge, depth in base.items() if edge not in set(removed)}
    for edge, kind in added:
        result[edge] = 0 if kind == 1 and not payload[0] & 0x20 else next(depths)
    place = -1
    for _ in range(rethickened_n):
        place += next(numbers) + 1
        result[order[place]] = next(numbers)
    assert next(numbers, None) is None
    assert next(depths, None) is None
    return result


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


def map_digest(edges: Map, *header: int) -> int:
    total = hashed(1, *header)
    for edge, depth in edges.items():
        total += hashed(2, *edge) + (hashed(3, *edge, depth) if depth else 0)
    return total & MASK


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


def a_map(rows: list[tuple[int, ...]]) -> VectorMap:
    table = np.array(rows, np.int32).reshape(-1, 6)
    return VectorMap(LATTICE, table[:, :5], table[:, 5].astype(np.uint8))


@settings(max_examples=50)
@given(_ROWS.map(a_map), _ROWS.map(a_map))
def test_the_page_and_the_library_read_the_same(old: VectorMap, new: VectorMap) -> None:
    assert decode(protocol.encode(diff(old, new), old), plain(old)) == plain(new)


@given(_ROWS.map(a_map))
def test_the_page_and_the_library_digest_the_same(vector_map: VectorMap) -> None:
    assert map_digest(plain(vector_map), 50_000, -7, 2**39, 0, -(2**30)) == vector_map.digest


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
