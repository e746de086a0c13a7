"""The digest: a sum mod 2^64 of one hash per record, so that it doesn't depend on their order.

It finds errors; it is no signature. ``docs/format.md`` states it for other languages.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_GOLDEN = 0x9E3779B97F4A7C15
_MIX1, _MIX2 = 0xBF58476D1CE4E5B9, 0x94D049BB133111EB
_MASK = (1 << 64) - 1


def hash_rows(rows: NDArray[np.integer], salt: int) -> NDArray[np.uint64]:
    """(n, k) integers -> (n,) uint64: each field is xored in and mixed by splitmix64's finaliser.

    Maps are hashed by ``row_kernels``; this is what the tests hold those against.
    """
    h = np.full(len(rows), salt & _MASK, np.uint64)
    for column in rows.astype(np.int64).astype(np.uint64).T:
        h ^= column
        h += np.uint64(_GOLDEN)
        h ^= h >> np.uint64(30)
        h *= np.uint64(_MIX1)
        h ^= h >> np.uint64(27)
        h *= np.uint64(_MIX2)
        h ^= h >> np.uint64(31)
    return h


def hash_ints(values: tuple[int, ...], salt: int) -> int:
    """The same for one record of Python integers (taken mod 2^64)."""
    h = salt & _MASK
    for value in values:
        h = ((h ^ (value & _MASK)) + _GOLDEN) & _MASK
        h = ((h ^ (h >> 30)) * _MIX1) & _MASK
        h = ((h ^ (h >> 27)) * _MIX2) & _MASK
        h ^= h >> 31
    return h


def hash_text(text: str, salt: int) -> int:
    """The same for a name: its UTF-8 bytes, one field each, then their count."""
    raw = text.encode()
    return hash_ints((*raw, len(raw)), salt)


def sum_mod64(hashes: NDArray[np.uint64]) -> int:
    """Sum mod 2^64."""
    return int(np.add.reduce(hashes, dtype=np.uint64)) if len(hashes) else 0
