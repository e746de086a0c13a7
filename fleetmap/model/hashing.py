"""The digest: a sum mod 2^64 of one hash per record, so that it doesn't depend on their order.

It finds errors; it is no signature. ``docs/format.md`` states it for other languages.
"""

from __future__ import annotations

_GOLDEN = 0x9E3779B97F4A7C15
_MIX1, _MIX2 = 0xBF58476D1CE4E5B9, 0x94D049BB133111EB
_MASK = (1 << 64) - 1


def hash_ints(values: tuple[int, ...], salt: int) -> int:
    """Of a record of integers (taken mod 2^64): each is xored in and mixed by splitmix64's finaliser.

    Edges are hashed by ``row_kernels`` in the same way.
    """
    h = salt & _MASK
    for value in values:
        h = ((h ^ (value & _MASK)) + _GOLDEN) & _MASK
        h = ((h ^ (h >> 30)) * _MIX1) & _MASK
        h = ((h ^ (h >> 27)) * _MIX2) & _MASK
        h ^= h >> 31
    return h


def hash_text(text: str, salt: int) -> int:
    """The same for a name: its UTF-8 bytes, one field each, then their count."""
    return hash_bytes(text.encode(), salt)


def hash_bytes(raw: bytes, salt: int) -> int:
    """The same for bytes, one field each, then their count."""
    return hash_ints((*raw, len(raw)), salt)
