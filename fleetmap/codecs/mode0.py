"""Mode 0: LEB128 numbers, deflated if that is smaller. Any language can read it; ``docs/format.md`` is its page."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.codecs.deflate import deflate, inflate
from fleetmap.codecs.fields import DeltaFields
from fleetmap.codecs.leb128 import decode_leb128, encode_leb128, unzigzag
from fleetmap.model.errors import ConfigError
from fleetmap.model.vectormap import VectorMap

MODE = 0
DEFLATED = 0x10
"""Flag: the numbers are compressed with raw deflate."""
THICK_FRONTIERS = 0x20
"""Flag: the thickness of frontiers is written too; without it they have none."""

MAX_INFLATED_BYTES = 4 << 20
"""A map of 2^18 edges takes less than 2 MB before deflate; the numbers of 4 MB take 32 MB of memory."""

COUNTS = 6
"""Numbers at the front: removed, known roots, absolute roots, chains, thickness runs, rethickened."""


def encode(fields: DeltaFields, base: VectorMap) -> bytes:
    """The numbers of a delta as bytes; the first one is the mode and its flags.

    Raises
    ------
    ConfigError : the delta is larger than a payload may be
    """
    from fleetmap.codecs.number_kernels import numbers_of

    numbers = numbers_of(
        fields.removed,
        fields.known_roots,
        fields.absolute_roots,
        fields.edges,
        fields.rethickened,
        fields.thick_frontiers,
    )
    body = encode_leb128(numbers)
    if len(body) > MAX_INFLATED_BYTES:
        reason = (
            f"takes {len(body)} B; a payload may take {MAX_INFLATED_BYTES} B: use several submaps, or a larger epsilon"
        )
        changed = len(fields.removed) + len(fields.edges) + len(fields.rethickened)
        raise ConfigError(option="map", value=f"{changed} changed edges", reason=reason)
    flags = MODE | (THICK_FRONTIERS if fields.thick_frontiers else 0)
    squeezed = deflate(body)
    if len(squeezed) < len(body):
        return bytes([flags | DEFLATED]) + squeezed
    return bytes([flags]) + body


def decode(payload: bytes, base: VectorMap) -> DeltaFields:
    """The numbers in a payload.

    Raises
    ------
    ValueError : anything about the bytes is not as it must be
    """
    from fleetmap.codecs.chain_kernels import endpoints

    flags, body = payload[0], payload[1:]
    if flags & ~(DEFLATED | THICK_FRONTIERS):
        raise ValueError(f"unknown flags {flags:#x}")
    numbers = _Reader(decode_leb128(inflate(body, max_bytes=MAX_INFLATED_BYTES) if flags & DEFLATED else body))
    n_removed, n_known, n_absolute, n_chains, n_runs, n_rethickened = numbers.take(COUNTS).tolist()
    removed = _places(numbers.take(n_removed))
    known_roots = np.cumsum(numbers.take(n_known))
    absolute_roots = unzigzag(numbers.take(2 * n_absolute)).reshape(-1, 2)
    heads = numbers.take(n_chains)
    counts = heads // 6 + 1
    if counts.max(initial=0) > numbers.left:
        raise ValueError("a chain is longer than the payload")
    edges = np.zeros((int(counts.sum()), 5), np.int64)
    edges[:, :2] = unzigzag(numbers.take(2 * len(edges))).reshape(-1, 2)
    edges[:, 2] = np.repeat(heads // 2 % 3, counts)
    edges[np.cumsum(counts) - counts, 3] = heads % 2 == 0
    runs = numbers.take(2 * n_runs).reshape(-1, 2)
    rethickened = numbers.take(2 * n_rethickened).reshape(-1, 2).copy()
    rethickened[:, 0] = _places(rethickened[:, 0])
    if numbers.left:
        raise ValueError(f"{numbers.left} numbers are left over")
    if len(heads) and heads[0] % 2:
        raise ValueError("a chain has no root")
    thick = bool(flags & THICK_FRONTIERS)
    edges[:, 4] = _thickness(runs, edges[:, 2], thick)
    for places in (removed, rethickened[:, 0]):
        _check_below(len(base), places)
    rows = base.bands.take(removed)
    _check_below(len(endpoints(rows)[0]), known_roots)
    if rethickened[:, 1].max(initial=0) > 255:
        raise ValueError("a thickness is above 255 quarters of a cell")
    return DeltaFields(removed, known_roots, absolute_roots, edges, rethickened, thick, rows[:, :5].copy())


class _Reader:
    """The numbers of a payload, taken from the front."""

    def __init__(self, numbers: NDArray[np.int64]) -> None:
        self._numbers, self._at = numbers, 0

    @property
    def left(self) -> int:
        return len(self._numbers) - self._at

    def take(self, count: int) -> NDArray[np.int64]:
        if count > self.left:
            raise ValueError(f"expected {count} more numbers; {self.left} are left")
        self._at += count
        return self._numbers[self._at - count : self._at]


def _places(gaps: NDArray[np.int64]) -> NDArray[np.int64]:
    """How many places are skipped before each -> ascending places."""
    return np.cumsum(gaps + 1) - 1


def _thickness(runs: NDArray[np.int64], classes: NDArray[np.int64], thick_frontiers: bool) -> NDArray[np.int64]:
    """(E,) the thickness of each edge, from runs over those that have one."""
    values, lengths = runs.T
    has = (classes != 1) | thick_frontiers
    if (values > 255).any() or (lengths > len(classes)).any() or lengths.sum() != has.sum():
        raise ValueError("the thickness runs don't fit the added edges")
    result = np.zeros(len(classes), np.int64)
    result[has] = np.repeat(values, lengths)
    return result


def _check_below(count: int, places: NDArray[np.int64]) -> None:
    # A running sum of numbers below 2^35 may overflow only after it has passed the count.
    if len(places) and (places.min() < 0 or places.max() >= count):
        raise ValueError(f"a place is not below {count}")
