"""Mode 2: whole maps of closed walks. What goes in comes out, the page is enough, and bad bytes cost a refusal."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetmap.codecs import mode2, protocol
from fleetmap.codecs.mode2_layout import CONTEXTS
from fleetmap.codecs.mode2_start import SEEN, START
from fleetmap.model.delta import apply, diff
from fleetmap.model.errors import ConfigError, WireError
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import Lattice
from fleetmap.model.vectormap import VectorMap
from fleetmap.vectorize import vectorize

EMPTY = VectorMap.empty(Lattice(50_000))


def ragged(seed: int, height: int = 90, width: int = 110) -> VectorMap:
    """Rooms with ragged walls and crumbs, as a map."""
    rng = np.random.default_rng(seed)
    states = np.full((height, width), 2, np.uint8)
    for _ in range(3):
        y, x = rng.integers(3, height - 30), rng.integers(3, width - 40)
        states[y : y + 26, x : x + 36] = 1
        states[y + 2 : y + 24, x + 2 : x + 34] = 0
    noise = rng.random(states.shape) < 0.03
    states[noise] = rng.integers(0, 3, int(noise.sum()))
    return vectorize(OccupancyGrid.from_states(states, 0.05), specks=int(rng.choice([0, 12])))


def read(payload: bytes) -> VectorMap:
    return apply(EMPTY, protocol.decode(payload, EMPTY, robot="r"))


@settings(max_examples=40)
@given(st.integers(0, 10**6))
def test_what_goes_in_comes_out_and_takes_less(seed: int) -> None:
    vector_map = ragged(seed)
    payload = protocol.encode_snapshot(vector_map, mode=2)
    assert read(payload).digest == vector_map.digest
    assert len(payload) < 0.85 * len(protocol.encode_snapshot(vector_map, mode=0))
    assert protocol.encode_snapshot(vector_map) == payload


def test_an_empty_map_and_one_triangle() -> None:
    triangle = VectorMap(
        Lattice(50_000),
        np.array([[-3, 5, 0, 9, 1], [-3, 5, 4, 5, 3], [0, 9, 4, 5, 1]], np.int32),
        np.array([40, 4, 255], np.uint8),
    )
    for vector_map in (EMPTY, triangle):
        assert read(protocol.encode_snapshot(vector_map, mode=2)).digest == vector_map.digest


def test_what_this_mode_is_not_for_goes_in_another() -> None:
    line = VectorMap(Lattice(50_000), np.array([[0, 0, 5, 5, 1]], np.int32), np.zeros(1, np.uint8))
    vector_map = ragged(1)
    thick = VectorMap(vector_map.lattice, vector_map.edges, np.full(len(vector_map), 9, np.uint8))
    for other, base in ((line, EMPTY), (thick, EMPTY), (vector_map, ragged(2))):
        with pytest.raises(ConfigError, match="closed walks"):
            protocol.encode(diff(base, other), base, mode=2)
        payload = protocol.encode(diff(base, other), base)
        assert payload[0] & 0x0F != 2
        assert apply(base, protocol.decode(payload, base, robot="r")).digest == other.digest
    with pytest.raises(WireError, match="not empty"):
        protocol.decode(protocol.encode_snapshot(vector_map, mode=2), vector_map, robot="r")


class Page:
    """A reader written from docs/format.md alone."""

    def __init__(self, payload: bytes) -> None:
        assert payload[0] == 2
        self.data, self.at = payload[1:], 4
        self.range, self.code = (1 << 32) - 1, int.from_bytes((self.data[:4] + bytes(4))[:4], "big")
        self.contexts = [[256 * b + 128, 256 * b + 128, m] for b, m in zip(START, SEEN, strict=True)]
        sizes = (2, 240, 216, 1800, 1170, 2730, 840, 208, 546, 4, 288, 13)
        starts = [39 + sum(sizes[:k]) for k in range(len(sizes))]
        self.triangle, self.close, self.klass, self.turn, self.length, self.lower = starts[:6]
        self.aside, self.off, self.off_lower, self.same, self.thickness, self.large = starts[6:]

    def fill(self) -> None:
        while self.range < 1 << 24:
            self.range <<= 8
            self.code = (self.code << 8) + (self.data[self.at] if self.at < len(self.data) else 0)
            self.at += 1

    def even(self) -> int:
        half = self.range >> 1
        value = int(self.code >= half)
        self.code, self.range = (self.code - half, self.range - half) if value else (self.code, half)
        self.fill()
        return value

    def told(self, c: int) -> int:
        p, q, n = self.contexts[c]
        bound = (self.range >> 16) * min(max((p + q) >> 1, 32), 65504)
        value = int(self.code < bound)
        self.code, self.range = (self.code, bound) if value else (self.code - bound, self.range - bound)
        self.fill()
        d, a = 327680 // (5 * n + 8), 65535 if value else 0
        self.contexts[c] = [p + ((a - p) * max(d, 4096) >> 16), q + ((a - q) * max(d, 512) >> 16), min(n + 1, 255)]
        return value

    def number(self, c: int, lower: int | None = None, e: int = -1) -> int:
        size = 0
        while self.told(c + min(size, 12)):
            size += 1
        bits = 1
        for k in range(size):
            if lower is None or size > 13:
                bits = 2 * bits + self.even()
                continue
            left = size - k
            t = 1 + ((e + 1) >> (left - 1) & 1) if (e + 1) >> left == bits else 0
            bits = 2 * bits + self.told(lower + 39 * size + 3 * (bits - 1 if k < 3 else min(4 + k, 12)) + t)
        return bits - 1

    def read(self) -> list[tuple[int, int, int, int, int, int]]:
        """(y0, x0, y1, x1, class, thickness) of each edge as walked."""
        edges = []
        walks = self.number(0)
        if walks == 0:
            return edges
        root_y, low_x = self.number(13) - 2**20, self.number(13) - 2**20
        width = self.number(13).bit_length()
        was, thick = 0, 4
        for _ in range(walks):
            root_y += self.number(26)
            x = low_x + int("0" + "".join(str(self.even()) for _ in range(width)), 2)
            was = triangle = self.told(self.triangle + was)
            walk, way, area = [], (0, 0), 0
            box = [0, 0, 0, 0]
            p, u, a1, a2, b1, quadrant, v, r = 3, 0, 0, 0, 0, 0, 3, 0
            last = 0
            i = 0
            while not last:
                if triangle:
                    last = int(i == 2)
                elif i == 1 or i > 2:
                    f = min(map(abs, way))
                    h = (frame(*way)[0] + 2) % 4
                    k = 0 if f == 0 else 4 if f > 2 else 1 if (h - quadrant) % 2 else 2 if h == quadrant else 3
                    c = 4 * (5 * min(max(map(abs, way)).bit_length(), 11) + k) + (0 if i == 1 else min(i, 5) - 2)
                    last = self.told(self.close + c)
                c = 2 * (96 + 4 * i + p) if triangle else 2 * (6 * (4 * p + min(u, 3)) + min(a1.bit_length(), 5))
                klass = self.told(self.klass + c)
                klass += self.told(self.klass + c + 1) if klass else 0
                if last:
                    dy, dx = -way[0], -way[1]
                else:
                    g, m1, m2 = 3 + i if triangle else klass, min(a1.bit_length(), 5), min(a2.bit_length(), 4)
                    c, before = self.turn + 3 * (4 * (5 * (6 * g + m1) + m2) + v), r
                    low = self.told(c)
                    r = low + 2 * self.told(c + 1 + low)
                    v = min(r, 2)
                    e = a2 - 1 if i > 1 and (r + before) % 2 == 0 else -1
                    a = 1 + self.number(self.length + 13 * (6 * (3 * g + v) + m1), self.lower + 546 * g, e)
                    c = self.aside + 2 * (3 * (4 * (7 * g + min(a.bit_length(), 6)) + r) + 1 + (b1 > 0) - (b1 < 0))
                    b = 0
                    if self.told(c):
                        negative = self.told(c + 1) if a > 1 else 0
                        b = (1 + self.number(self.off + 13 * min(a, 15), self.off_lower)) * (-1 if negative else 1)
                    quadrant = (quadrant + r) % 4
                    dy, dx = ((b, a), (a, -b), (-b, -a), (-a, b))[quadrant]
                    a1, a2, b1 = a, a1, b
                u, p = (u + 1 if klass == p else 0), klass
                area += way[1] * (way[0] + dy) - way[0] * (way[1] + dx)
                walk.append((root_y + way[0], x + way[1], root_y + way[0] + dy, x + way[1] + dx, klass))
                way = (way[0] + dy, way[1] + dx)
                box = [min(box[0], way[0]), max(box[1], way[0]), min(box[2], way[1]), max(box[3], way[1])]
                i += 1
            o = int(area <= 0)
            z = o * (1 + min(box[1] - box[0], box[3] - box[2], 7))
            told_one = False
            for k, edge in enumerate(walk):
                if edge[4] == 1:
                    edges.append((*edge, 0))
                    continue
                if not told_one or not self.told(self.same + 2 * o + (walk[k - 1][4] != 1)):
                    node = 1
                    for _ in range(5):
                        node = 2 * node + self.told(self.thickness + 32 * z + node)
                    thick = node - 32
                    thick += self.number(self.large) if thick == 31 else 0
                told_one = True
                edges.append((*edge, thick))
        return edges


def frame(dy: int, dx: int) -> tuple[int, int, int]:
    """(quadrant, a, b) of a step."""
    for quadrant, (a, b) in enumerate(((dx, dy), (dy, -dx), (-dx, -dy), (-dy, dx))):
        if -a < b <= a:
            return quadrant, a, b
    raise AssertionError("a step to nowhere")


@pytest.mark.parametrize("seed", range(6))
def test_the_page_is_enough_to_read_it(seed: int) -> None:
    vector_map = ragged(seed)
    found = set()
    for y0, x0, y1, x1, klass, thickness in Page(protocol.encode_snapshot(vector_map, mode=2)).read():
        left, right = ((0, 1), (0, 2), (1, 2))[klass]
        forwards = (y0, x0) < (y1, x1)
        ends = (y0, x0, y1, x1) if forwards else (y1, x1, y0, x0)
        found.add((*ends, 3 * left + right if forwards else 3 * right + left, thickness))
    assert found == {(*e, t) for e, t in zip(vector_map.edges.tolist(), vector_map.thickness.tolist(), strict=True)}


def test_golden_payloads_are_read() -> None:
    """The bytes of format version 1: a change here breaks every fleet that is under way."""
    golden = Path(__file__).parent / "data" / "mode2.hex"
    lines = [line.split() for line in golden.read_text().splitlines() if not line.startswith("#")]
    for payload_hex, digest in lines:
        vector_map = read(bytes.fromhex(payload_hex))
        assert f"{vector_map.digest:016x}" == digest
        assert protocol.encode_snapshot(vector_map, mode=2).hex() == payload_hex
    assert len(lines) == 3


def test_the_start_table_is_the_one_of_the_format() -> None:
    assert len(START) == len(SEEN) == CONTEXTS
    assert max(SEEN) <= 8
    assert (
        hashlib.sha256(START + SEEN).hexdigest() == "4b360a02f5961fc96bcb36ddbcb407cf693229f9e02df26b86c4085022d50e9f"
    )


@settings(max_examples=300)
@given(st.binary(max_size=120))
def test_random_bytes_are_refused_or_a_map(data: bytes) -> None:
    try:
        delta = protocol.decode(b"\x02" + data, EMPTY, robot="r")
    except WireError as error:
        assert error.robot == "r"
    else:
        assert len(delta) <= mode2.EDGES + mode2.EDGES_PER_BYTE * (1 + len(data))
        apply(EMPTY, delta)


def test_each_flipped_bit_is_refused_or_gives_another_map() -> None:
    payload = protocol.encode_snapshot(ragged(3), mode=2)
    digest = ragged(3).digest
    refused = 0
    for bit in range(8, 8 * len(payload)):
        damaged = bytearray(payload)
        damaged[bit // 8] ^= 1 << bit % 8
        try:
            other = read(bytes(damaged))
        except (WireError, ValueError):
            refused += 1
            continue
        assert other.digest != digest
    assert refused > 0


@pytest.mark.parametrize("count", [300, 40_000])
def test_equal_squares_go_in_mode_0_and_too_many_of_them_must(count: int) -> None:
    """Each costs next to nothing, and a payload of mode 2 holds no more than 16 edges a byte, and 2^17."""
    corners = np.array([[0, 0, 0, 2, 2], [0, 0, 2, 0, 6], [0, 2, 2, 2, 2], [2, 0, 2, 2, 6]])
    rows = (corners + np.arange(count)[:, None, None] * np.array([4, 0, 4, 0, 0])).reshape(-1, 5).astype(np.int32)
    vector_map = VectorMap(Lattice(50_000), rows, np.zeros(len(rows), np.uint8))
    payload = protocol.encode_snapshot(vector_map)
    assert payload[0] & 0x0F == 0
    assert read(payload).digest == vector_map.digest
    if len(rows) > mode2.MAX_EDGES:
        with pytest.raises(ConfigError, match="is for mode 0"):
            protocol.encode_snapshot(vector_map, mode=2)
