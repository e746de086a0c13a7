"""The codec's kernels against a plain twin, without their compiler, and on deltas that were damaged."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetmap.codecs import mode1, protocol
from fleetmap.codecs.fields import to_delta, to_fields
from fleetmap.codecs.removal_kernels import MAX_WINDOWS, choose_windows
from fleetmap.model.delta import apply, diff
from fleetmap.model.errors import ConfigError, WireError
from fleetmap.model.lattice import Lattice
from fleetmap.model.vectormap import VectorMap

LATTICE = Lattice(50_000)
EMPTY = VectorMap.empty(LATTICE)
Point = tuple[int, int]
Edge = tuple[int, ...]


def random_map(rng: np.random.Generator, count: int, span: int, label_of: tuple[int, ...] = (1, 2, 3, 6)) -> VectorMap:
    """Edges between few vertices, so that many meet; some frontiers are thick."""
    vertices = rng.integers(-span, span, (max(count // 2, 3), 2))
    edges = np.concatenate([vertices[rng.integers(0, len(vertices), count)] for _ in range(2)], axis=1)
    edges = np.column_stack([edges, rng.choice(label_of, count)])
    edges = edges[(edges[:, :2] != edges[:, 2:4]).any(axis=1)]
    return VectorMap(LATTICE, edges, rng.choice([0, 3, 4, 15, 40, 255], len(edges)))


def changed(base: VectorMap, rng: np.random.Generator, share: float) -> VectorMap:
    """The map with a share of its edges replaced, and of the others made thicker."""
    more = random_map(rng, int(len(base) * share) + 1, 300)
    keep = rng.random(len(base)) > share
    thickness = np.where(rng.random(len(base)) > share, base.thickness, 7)
    rows = np.concatenate([base.edges[keep], more.edges])
    return VectorMap(LATTICE, rows, np.concatenate([thickness[keep], more.thickness]))


def plain_walks(removed: list[Edge], added: list[Edge]) -> list[tuple[Point, list[tuple[int, Point]]]]:
    """The slow twin of ``find_walks``: for each walk its root, and class and end of each edge."""

    def directed(edge: Edge) -> tuple[int, Point, Point]:
        left, right = divmod(edge[4], 3)
        a, b = (edge[0], edge[1]), (edge[2], edge[3])
        return left + right - 1, *((a, b) if left < right else (b, a))

    leaving: defaultdict[Point, list[tuple[int, Point]]] = defaultdict(list)
    surplus: defaultdict[Point, int] = defaultdict(int)
    for kind, a, b in map(directed, added):
        leaving[a].append((kind, b))
        surplus[a] += 1
        surplus[b] -= 1

    def walk(vertex: Point) -> list[tuple[int, Point]]:
        steps: list[tuple[int, Point]] = []
        while leaving[vertex]:
            same = [step for step in leaving[vertex] if steps and step[0] == steps[-1][0]]
            steps.append(min(same or leaving[vertex]))
            leaving[vertex].remove(steps[-1])
            vertex = steps[-1][1]
        return steps

    known = {point for edge in removed for point in ((edge[0], edge[1]), (edge[2], edge[3]))}
    walks = []
    tails = {v for v in leaving if surplus[v] > 0}
    for starts in (tails, set(leaving)):
        for group in (known, None):
            for vertex in sorted(v for v in starts if (v in known) == (group is known)):
                for _ in range(surplus[vertex] if starts is tails else len(leaving[vertex])):
                    if leaving[vertex]:
                        walks.append((vertex, walk(vertex)))
    return sorted(walks, key=lambda w: (w[0] not in known, w[0]))


@settings(max_examples=150)
@given(st.integers(0, 2**32), st.integers(1, 60), st.sampled_from([3, 8, 300]), st.sampled_from([0.1, 0.5, 1.0]))
def test_walks_are_those_of_the_plain_twin(seed: int, count: int, span: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    old = random_map(rng, count, span)
    delta = diff(old, changed(old, rng, share))
    fields = to_fields(delta, old)
    removed, added = delta.removed.tolist(), delta.added.tolist()
    walks = plain_walks(removed, added)
    rows = []
    for root, steps in walks:
        for i, (kind, end) in enumerate(steps):
            y, x = steps[i - 1][1] if i else root
            rows.append((end[0] - y, end[1] - x, kind, int(i == 0)))
    assert [tuple(row[:4]) for row in fields.edges.tolist()] == rows
    known = sorted({point for edge in removed for point in ((edge[0], edge[1]), (edge[2], edge[3]))})
    assert [known[rank] for rank in fields.known_roots.tolist()] == [root for root, _ in walks if root in known]
    assert len(fields.absolute_roots) == sum(root not in known for root, _ in walks)
    back = to_delta(fields, old)
    for name in ("removed", "added", "added_thickness", "rethickened", "rethickened_to"):
        assert getattr(back, name).tolist() == getattr(delta, name).tolist()


@settings(max_examples=60)
@given(st.integers(0, 2**32), st.integers(0, 200), st.integers(1, 4000))
def test_windows_hold_each_removed_edge_once(seed: int, count: int, span: int) -> None:
    rng = np.random.default_rng(seed)
    removed = random_map(rng, count, 64 * span).edges[:count]
    numbers = np.unique(removed[:, 0] >> 6).astype(np.int64)
    windows = np.zeros((MAX_WINDOWS, 5), np.int64)
    found = choose_windows(removed, numbers, np.arange(len(numbers)), windows)
    held = np.zeros(len(removed), np.int64)
    for first, bands, column, columns, gone in windows[:found].tolist():
        band, x = np.searchsorted(numbers, removed[:, 0] >> 6) - first, (removed[:, 1] >> 6) - column
        inside = (band >= 0) & (band < bands) & (x >= 0) & (x < columns)
        assert int(inside.sum()) == gone > 0
        held += inside
    assert (held == 1).all()


@pytest.mark.parametrize("mode", [0, 1])
@pytest.mark.parametrize("seed", range(6))
def test_larger_maps_come_back(mode: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    old = random_map(rng, 600, [200, 2000, 30_000][seed % 3], (1, 2, 3, 6) if seed < 3 else (1, 2, 3, 5, 6, 7))
    new = changed(old, rng, 0.05)
    payload = protocol.encode(diff(old, new), old, mode=mode)
    made = apply(old, protocol.decode(payload, old, robot="r"))
    assert made.digest == new.digest
    assert np.array_equal(made.edges, new.edges)


def fuzz(seed: int, rounds: int) -> str:
    """What comes of damaged payloads, all of it in one hash; anything but ``WireError`` goes through."""
    rng = np.random.default_rng(seed)
    outcomes = hashlib.sha256()
    for _ in range(rounds):
        old = random_map(rng, int(rng.integers(1, 60)), int(rng.choice([5, 300, 3000])))
        payload = protocol.encode(diff(old, changed(old, rng, 0.2)), old, mode=int(rng.integers(0, 2)))
        damaged = bytearray(payload)
        for _ in range(int(rng.integers(0, 4))):
            damaged[int(rng.integers(0, len(damaged)))] ^= 1 << int(rng.integers(0, 8))
        damaged = damaged[: int(rng.integers(1, len(damaged) + 1))] if rng.random() < 0.3 else damaged
        for data in (payload, bytes(damaged), b"\x01" + rng.bytes(int(rng.integers(0, 40)))):
            try:
                delta = protocol.decode(data, old, robot="r")
            except WireError as error:
                outcomes.update(error.reason.encode())
                continue
            try:
                made = apply(old, delta)
            except ValueError as error:
                assert "delta" in str(error)
                outcomes.update(str(error).encode())
                continue
            again = protocol.encode(diff(old, made), old)
            outcomes.update(made.digest.to_bytes(8, "big") + data + again)
    return outcomes.hexdigest()


def test_damaged_payloads_are_refused_or_a_delta() -> None:
    fuzz(7, 400)


def test_the_kernels_do_the_same_without_their_compiler() -> None:
    """Integers only, and none that overflows but in the hash: numpy would warn of it."""
    folder = str(Path(__file__).parent)
    code = f"import sys; sys.path.insert(0, {folder!r}); import test_codecs_kernels as t; print(t.fuzz(3, 12))"
    run = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        env=os.environ | {"NUMBA_DISABLE_JIT": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    assert run.stdout.strip() == fuzz(3, 12)


def test_a_coder_that_has_no_room_left_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    new = random_map(np.random.default_rng(1), 40, 300)
    size = len(protocol.encode(diff(EMPTY, new), EMPTY, mode=1))
    for room in (0, 1, 4, size - 1):
        monkeypatch.setattr(mode1, "MAX_BYTES", room)
        with pytest.raises(ConfigError, match="mode 0"):
            protocol.encode(diff(EMPTY, new), EMPTY, mode=1)
