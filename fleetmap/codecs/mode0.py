"""Mode 0: LEB128 numbers, deflated if that is smaller. Any language can read it; ``docs/format.md`` is its page.

A delta names removed edges by their place in the base's canonical order and added ones as chains. Chains of a
closed boundary start where a removed edge ended, so their roots are small numbers and not coordinates.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.codecs.chains import DIRECTED_LABELS, Chain, find_chains
from fleetmap.codecs.deflate import deflate, inflate
from fleetmap.codecs.leb128 import decode_leb128, encode_leb128, unzigzag, zigzag
from fleetmap.model.arcs import flip
from fleetmap.model.delta import MapDelta, find_rows
from fleetmap.model.errors import ConfigError
from fleetmap.model.lattice import MAX_COORDINATE
from fleetmap.model.vectormap import VectorMap, canonical_edges

MODE = 0
DEFLATED = 0x10
"""Flag: the numbers are compressed with raw deflate."""
THICK_FRONTIERS = 0x20
"""Flag: the thickness of frontiers is written too; without it they have none."""

MAX_INFLATED_BYTES = 4 << 20
"""A map of 2^18 edges takes less than 2 MB before deflate; the numbers of 4 MB take 32 MB of memory."""

COUNTS = 6
"""Numbers at the front: removed, known roots, absolute roots, chains, thickness runs, rethickened."""


def encode(delta: MapDelta, base: VectorMap) -> bytes:
    """A delta against ``base`` as bytes; the first one is the mode and its flags.

    Raises
    ------
    ConfigError : the delta is larger than a payload may be
    """
    known = _endpoints(delta.removed)
    chains = find_chains(delta.added, map(tuple, known.tolist()))
    starts = np.array([c.points[0] for c in chains if not c.continues], np.int64).reshape(-1, 2)
    known_roots = _rank_among(known, starts)
    absolute = starts[known_roots < 0]
    known_roots = known_roots[known_roots >= 0]
    reference = delta.removed[:1, :2] if len(delta.removed) else np.zeros((1, 2), np.int64)
    order = np.array([i for c in chains for i in c.edges], np.int64)
    thick_frontiers = bool((delta.added_thickness[_is_frontier(delta.added)] > 0).any())
    thickness = delta.added_thickness[order]
    if not thick_frontiers:
        thickness = thickness[~_is_frontier(delta.added[order])]
    runs = _runs(thickness)
    rethickened = find_rows(base.edges, delta.rethickened)
    counts = [len(delta.removed), len(known_roots), len(absolute), len(chains), len(runs), len(rethickened)]
    numbers = np.concatenate(
        [
            np.array(counts, np.int64),
            _gaps(find_rows(base.edges, delta.removed)),
            # Two walks may leave the same root: these gaps may be 0.
            np.diff(known_roots, prepend=0),
            _pairs(np.diff(np.concatenate([reference, absolute]), axis=0)),
            np.array([_header(c) for c in chains], np.int64),
            _pairs(_steps(chains)),
            runs.ravel(),
            np.column_stack([_gaps(rethickened), delta.rethickened_to]).astype(np.int64).ravel(),
        ]
    )
    body = encode_leb128(numbers)
    if len(body) > MAX_INFLATED_BYTES:
        reason = (
            f"takes {len(body)} B; a payload may take {MAX_INFLATED_BYTES} B: use several submaps, or a larger epsilon"
        )
        raise ConfigError(option="map", value=f"{len(delta)} changed edges", reason=reason)
    flags = MODE | (THICK_FRONTIERS if thick_frontiers else 0)
    squeezed = deflate(body)
    if len(squeezed) < len(body):
        return bytes([flags | DEFLATED]) + squeezed
    return bytes([flags]) + body


def decode(payload: bytes, base: VectorMap) -> MapDelta:
    """The delta in a payload that ``encode`` made against the same base.

    Raises
    ------
    ValueError : anything about the bytes is not as it must be (``MapFormatError`` is one, too)
    """
    flags, body = payload[0], payload[1:]
    if flags & ~(DEFLATED | THICK_FRONTIERS):
        raise ValueError(f"unknown flags {flags:#x}")
    numbers = _Reader(decode_leb128(inflate(body, max_bytes=MAX_INFLATED_BYTES) if flags & DEFLATED else body))
    counts = numbers.take(COUNTS).tolist()
    n_removed, n_known, n_absolute, n_chains, n_runs, n_rethickened = counts
    removed = base.edges[_places(numbers.take(n_removed), len(base))]
    known = _endpoints(removed)
    known_roots = known[_checked(np.cumsum(numbers.take(n_known)), len(known))]
    reference = removed[:1, :2].astype(np.int64) if len(removed) else np.zeros((1, 2), np.int64)
    absolute = reference + np.cumsum(_unpairs(numbers.take(2 * n_absolute)), axis=0)
    roots = np.concatenate([known_roots, absolute])
    added, order_labels = _chains_to_edges(numbers, roots, n_chains)
    values, lengths = numbers.take(2 * n_runs).reshape(-1, 2).T
    has_thickness = np.ones(len(added), bool) if flags & THICK_FRONTIERS else order_labels != DIRECTED_LABELS[1]
    if (values > 255).any() or (lengths > len(added)).any() or lengths.sum() != has_thickness.sum():
        raise ValueError("the thickness runs don't fit the added edges")
    thickness = np.zeros(len(added), np.uint8)
    thickness[has_thickness] = np.repeat(values, lengths)
    rethickened, rethickened_to = numbers.take(2 * n_rethickened).reshape(-1, 2).T
    if (rethickened_to > 255).any():
        raise ValueError("a thickness is above 255 quarters of a cell")
    numbers.end()
    if len(added) and np.abs(added[:, :4]).max() > MAX_COORDINATE:
        raise ValueError(f"a coordinate is farther than {MAX_COORDINATE} cells from the lattice's origin")
    edges, edge_thickness = canonical_edges(added.astype(np.int32), thickness)
    if len(edges) != len(added):
        raise ValueError("an edge is added twice")
    return MapDelta(
        removed,
        edges,
        edge_thickness,
        base.edges[_places(rethickened, len(base))],
        rethickened_to.astype(np.uint8),
    )


class _Reader:
    """The numbers of a payload, taken from the front."""

    def __init__(self, numbers: NDArray[np.int64]) -> None:
        self._numbers, self._at = numbers, 0

    def take(self, count: int) -> NDArray[np.int64]:
        if count > len(self._numbers) - self._at:
            raise ValueError(f"expected {count} more numbers; {len(self._numbers) - self._at} are left")
        self._at += count
        return self._numbers[self._at - count : self._at]

    def end(self) -> None:
        if self._at != len(self._numbers):
            raise ValueError(f"{len(self._numbers) - self._at} numbers are left over")


def _chains_to_edges(
    numbers: _Reader, roots: NDArray[np.int64], n_chains: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(m, 5) edges, first vertex first as walked, and (m,) their directed labels."""
    heads = numbers.take(n_chains)
    continues, label_code, counts = heads & 1, (heads >> 1) % 3, (heads >> 1) // 3 + 1
    if len(heads) and (continues[0] or counts.max() > len(numbers._numbers)):
        raise ValueError("a chain has no root, or is longer than the payload")
    if int((continues == 0).sum()) != len(roots):
        raise ValueError("the number of roots is not the number of walks")
    steps = _unpairs(numbers.take(2 * int(counts.sum())))
    walk = np.repeat(np.cumsum(continues == 0) - 1, counts)
    ends = np.cumsum(steps, axis=0)
    before = ends - steps
    first_of_walk = np.searchsorted(walk, np.arange(len(roots)))
    shift = (roots - before[first_of_walk])[walk] if len(walk) else np.zeros((0, 2), np.int64)
    labels = np.array(DIRECTED_LABELS)[np.repeat(label_code, counts)]
    return np.column_stack([before + shift, ends + shift, labels]), labels


def _header(chain: Chain) -> int:
    return int(chain.continues) + 2 * (DIRECTED_LABELS.index(chain.label) + 3 * (len(chain.edges) - 1))


def _steps(chains: list[Chain]) -> NDArray[np.int64]:
    steps = [np.diff(np.array(c.points, np.int64), axis=0) for c in chains]
    return np.concatenate(steps) if steps else np.zeros((0, 2), np.int64)


def _pairs(steps: NDArray[np.int64]) -> NDArray[np.int64]:
    return zigzag(steps.astype(np.int64)).ravel()


def _unpairs(numbers: NDArray[np.int64]) -> NDArray[np.int64]:
    return unzigzag(numbers).reshape(-1, 2)


def _is_frontier(edges: NDArray[np.int32]) -> NDArray[np.bool_]:
    return np.isin(edges[:, 4], (DIRECTED_LABELS[1], flip(DIRECTED_LABELS[1])))


def _endpoints(edges: NDArray[np.int32]) -> NDArray[np.int64]:
    """(v, 2) the vertices (y, x) of some edges, ascending, each once."""
    return np.unique(edges[:, :4].reshape(-1, 2).astype(np.int64), axis=0)


def _rank_among(known: NDArray[np.int64], points: NDArray[np.int64]) -> NDArray[np.int64]:
    """(n,) place of each point among ascending known ones; -1 where it is not one of them."""
    places = {point: i for i, point in enumerate(map(tuple, known.tolist()))}
    return np.array([places.get(tuple(point), -1) for point in points.tolist()], np.int64)


def _gaps(places: NDArray[np.int64]) -> NDArray[np.int64]:
    """Ascending places -> how many are skipped before each."""
    return np.diff(places, prepend=-1) - 1


def _places(gaps: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    return _checked(np.cumsum(gaps + 1) - 1, count)


def _checked(places: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    # A running sum of numbers below 2^35 may overflow only after it has passed the count.
    if len(places) and (places.min() < 0 or places.max() >= count):
        raise ValueError(f"a place is not below {count}")
    return places


def _runs(values: NDArray[np.uint8]) -> NDArray[np.int64]:
    """(r, 2) rows (value, length)."""
    starts = np.flatnonzero(np.diff(values.astype(np.int64), prepend=-1))
    return np.column_stack([values[starts], np.diff(starts, append=len(values))]).astype(np.int64)
