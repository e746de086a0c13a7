"""docs/format.md, read by a decoder that was written from that page alone: it must agree with the library."""

from __future__ import annotations

import itertools
import zlib
from collections.abc import Iterator

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetmap.codecs import protocol
from fleetmap.codecs.messages import Header
from fleetmap.codecs.mode1_start import START
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


class RangeCoder:
    """The coder of mode 1."""

    def __init__(self, data: bytes) -> None:
        self.p = [16 * b + 8 for b in START]
        self.bytes = itertools.chain(data, itertools.repeat(0))
        self.range, self.code = 2**32 - 1, 0
        for _ in range(4):
            self.code = self.code * 256 + next(self.bytes)

    def decide(self, context: int | None) -> int:
        bound = self.range >> 1 if context is None else (self.range >> 12) * self.p[context]
        one = self.code >= bound
        if one:
            self.code, self.range = self.code - bound, self.range - bound
        else:
            self.range = bound
        if context is not None:
            self.p[context] += -(self.p[context] >> 5) if one else (4096 - self.p[context]) >> 5
        while self.range < 2**24:
            self.range, self.code = self.range << 8, self.code * 256 + next(self.bytes)
        return int(one)

    def n(self, c: int) -> int:
        length = 0
        while self.decide(c + min(length, 11)):
            length += 1
        if length < 2:
            return length
        value = 2 + self.decide(c + 12 + min(length - 2, 11))
        for _ in range(length - 2):
            value = 2 * value + self.decide(None)
        return value

    def s(self, c: int, d: int | None = None) -> int:
        value = self.n(c)
        return -value if value and self.decide(d) else value

    def t(self, c: int) -> int:
        k = 1
        for _ in range(4):
            k = 2 * k + self.decide(c + k)
        return k - 16 if k < 31 else 15 + self.n(1224)


def sgn(value: int) -> int:
    return (value > 0) - (value < 0)


def size(*values: int) -> int:
    """L of the page."""
    return max(map(abs, values)).bit_length()


def walked(edge: Edge) -> tuple[int, tuple[int, int], tuple[int, int]]:
    """Class, first and last vertex of an edge as it is walked."""
    sides = divmod(edge[4], 3)
    for kind, both in CLASSES.items():
        if sides == both:
            return kind, edge[:2], edge[2:4]
        if sides == both[::-1]:
            return kind, edge[2:4], edge[:2]
    raise AssertionError(edge)


def read_removed(coder: RangeCoder, base: Map) -> list[int]:
    """Places of the removed edges."""
    order = sorted(base)
    bands = sorted({edge[0] // 64 for edge in order})
    windows = []
    band = column = 0
    for _ in range(coder.n(0)):
        band += coder.n(24)
        high = band + coder.n(48)
        column += coder.s(72)
        windows.append((bands[band : high + 1], column, column + coder.n(96), 1 + coder.n(120)))
    places: list[int] = []
    touched: dict[tuple[int, int], int] = {}
    for numbers, low, high, count in windows:
        last = 0
        for place, edge in enumerate(order):
            if count == 0:
                break
            if edge[0] // 64 not in numbers or not low <= edge[1] // 64 <= high:
                continue
            a, b = touched.get(edge[:2], 0), touched.get(edge[2:4], 0)
            last = coder.decide(1248 + 2 * (16 * walked(edge)[0] + 4 * a + b) + last)
            for vertex in (edge[:2], edge[2:4]):
                touched[vertex] = touched.get(vertex, 0) | (2 if last else 1)
            count -= last
            if last:
                places.append(place)
        assert count == 0
    return sorted(places)


def mode0_numbers(payload: bytes, base: Map) -> list[int]:
    """The numbers that mode 0 would write, from a payload of mode 1."""
    coder = RangeCoder(payload[1:])
    places = read_removed(coder, base)
    removed = [walked(sorted(base)[place]) for place in places]
    surplus: dict[tuple[int, int], int] = {}
    for _, first, last in removed:
        surplus[first] = surplus.get(first, 0) + 1
        surplus[last] = surplus.get(last, 0) - 1
    known = sorted(surplus)
    ranks = [rank for rank, point in enumerate(known) for _ in range(coder.n(144 + 24 * (1 + sgn(surplus[point]))))]
    absolute = [coder.s(240) for _ in range(2 * coder.n(216))]
    roots = [known[rank] for rank in ranks]
    y, x = sorted(base)[places[0]][:2] if places else (0, 0)
    for dy, dx in zip(absolute[::2], absolute[1::2], strict=True):
        y, x = y + dy, x + dx
        roots.append((y, x))
    targets = [point for point in known for _ in range(-surplus[point])][:64]
    heads: list[int] = []
    steps: list[int] = []
    runs: list[int] = []
    h = 4
    for i, (y, x) in enumerate(roots):
        q, dy, dx = 6, 0, 0
        for kind, first, last in reversed(removed):
            if first == (y, x) and i < len(ranks):
                q, dy, dx = 3 + kind, last[0] - y, last[1] - x
        starts, ends = True, 0
        while not ends:
            c = 1344 + 2 * (3 * q + min(size(dy, dx) // 2, 2))
            kind = 1 + coder.decide(c + 1) if coder.decide(c) else 0
            ways = sorted((abs(a - y) + abs(b - x), a, b) for a, b in targets)
            near = min((max(abs(a - y), abs(b - x)) for _, a, b in ways), default=0)
            if ways and coder.decide(1386 + 3 * min(size(near), 8) + kind):
                _, *end = ways[coder.n(1128)]
                targets.remove((end[0], end[1]))
                dy, dx, ends = end[0] - y, end[1] - x, 1
            else:
                u, v = sgn(dy), sgn(dx)
                r = 5 * kind + (0 if q == 6 else 1 if q == kind else 2 if q == kind + 3 else 3 if q < 3 else 4)
                dy = coder.s(264 + 24 * r, 1413 + 9 * r + 3 * (1 + u) + 1 + v)
                sign = 1548 + 27 * r + 9 * (1 + u) + 3 * (1 + v) + 1 + sgn(dy)
                dx = coder.s(624 + 24 * (7 * kind + min(size(dy), 6)), sign)
                ends = coder.decide(1954 if targets else 1953)
            if kind != 1 or payload[0] & 0x20:
                c = 1955 + 16 * (12 * min(kind, 1) + 4 * min(size(dy, dx) // 2, 2) + min(h, 7) // 2)
                h = coder.t(c)
                runs += [h, 1]
            heads.append(2 * kind + (0 if starts else 1))
            steps += [dy, dx]
            y, x, q, starts = y + dy, x + dx, kind, False
    rethickened: list[int] = []
    place = places[0] if places else 0
    for i in range(coder.n(1152)):
        gap = coder.n(1200) if i else place + coder.s(1176)
        place = gap if i == 0 else place + gap + 1
        rethickened += [gap, coder.t(2339)]
    gaps = [b - a - 1 for a, b in itertools.pairwise([-1, *places])]
    rank_gaps = [b - a for a, b in itertools.pairwise([0, *ranks])]
    counts = [len(places), len(ranks), len(absolute) // 2, len(heads), len(runs) // 2, len(rethickened) // 2]
    pairs = [[zigzag(v) for v in values] for values in (absolute, steps)]
    return counts + gaps + rank_gaps + pairs[0] + heads + pairs[1] + runs + rethickened


def zigzag(value: int) -> int:
    return 2 * value if value >= 0 else -2 * value - 1


def decode(payload: bytes, base: Map) -> Map:
    if payload[0] & 0x0F == 1:
        numbers = iter(mode0_numbers(payload, base))
    else:
        numbers = leb128(zlib.decompress(payload[1:], -15) if payload[0] & 0x10 else payload[1:])
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
_MAPS = st.builds(lambda rows, scale: a_map(rows, scale), _ROWS, st.sampled_from([1, 97, 2**18]))
"""Within a band, over a dozen bands and columns, and to the bounds."""


def a_map(rows: list[tuple[int, ...]], scale: int = 1) -> VectorMap:
    table = np.array(rows, np.int32).reshape(-1, 6)
    return VectorMap(LATTICE, table[:, :5] * [scale, scale, scale, scale, 1], table[:, 5].astype(np.uint8))


@settings(max_examples=100)
@given(_MAPS, _MAPS, st.sampled_from([0, 1]))
def test_the_page_and_the_library_read_the_same(old: VectorMap, new: VectorMap, mode: int) -> None:
    assert decode(protocol.encode(diff(old, new), old, mode=mode), plain(old)) == plain(new)


@given(_MAPS)
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
