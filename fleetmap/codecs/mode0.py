"""Mode 0: LEB128 numbers, deflated if that is smaller. Any language can read it; ``docs/format.md`` is its page."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.codecs.deflate import deflate, inflate
from fleetmap.codecs.fields import DeltaFields, edges_per_chain
from fleetmap.codecs.leb128 import decode_leb128, encode_leb128, unzigzag, zigzag
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
    numbers = np.concatenate(
        [
            np.array(fields.counts, np.int64),
            _gaps(fields.removed),
            # Two walks may leave the same root: these gaps may be 0.
            np.diff(fields.known_roots, prepend=0),
            zigzag(fields.absolute_roots).ravel(),
            fields.heads,
            zigzag(fields.steps).ravel(),
            fields.runs.ravel(),
            np.column_stack([_gaps(fields.rethickened[:, 0]), fields.rethickened[:, 1]]).ravel(),
        ]
    )
    body = encode_leb128(numbers)
    if len(body) > MAX_INFLATED_BYTES:
        reason = (
            f"takes {len(body)} B; a payload may take {MAX_INFLATED_BYTES} B: use several submaps, or a larger epsilon"
        )
        changed = len(fields.removed) + len(fields.steps) + len(fields.rethickened)
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
    flags, body = payload[0], payload[1:]
    if flags & ~(DEFLATED | THICK_FRONTIERS):
        raise ValueError(f"unknown flags {flags:#x}")
    numbers = _Reader(decode_leb128(inflate(body, max_bytes=MAX_INFLATED_BYTES) if flags & DEFLATED else body))
    n_removed, n_known, n_absolute, n_chains, n_runs, n_rethickened = numbers.take(COUNTS).tolist()
    removed = _places(numbers.take(n_removed))
    known_roots = np.cumsum(numbers.take(n_known))
    absolute_roots = unzigzag(numbers.take(2 * n_absolute)).reshape(-1, 2)
    heads = numbers.take(n_chains)
    edges = edges_per_chain(heads)
    if edges.max(initial=0) > numbers.left:
        raise ValueError("a chain is longer than the payload")
    steps = unzigzag(numbers.take(2 * int(edges.sum()))).reshape(-1, 2)
    runs = numbers.take(2 * n_runs).reshape(-1, 2)
    rethickened = numbers.take(2 * n_rethickened).reshape(-1, 2).copy()
    rethickened[:, 0] = _places(rethickened[:, 0])
    if numbers.left:
        raise ValueError(f"{numbers.left} numbers are left over")
    thick = bool(flags & THICK_FRONTIERS)
    return DeltaFields(removed, known_roots, absolute_roots, heads, steps, runs, rethickened, thick)


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


def _gaps(places: NDArray[np.int64]) -> NDArray[np.int64]:
    """Ascending places -> how many are skipped before each."""
    return np.diff(places, prepend=-1) - 1


def _places(gaps: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.cumsum(gaps + 1) - 1
