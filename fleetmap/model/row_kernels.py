"""Numba kernels on rows (y0, x0, y1, x1, label, thickness) of a map: order, hash, and whether an edge can be."""

from __future__ import annotations

from collections.abc import Callable
from types import FunctionType
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.kernel import kernel

LIMIT = 1 << 20
"""Largest |coordinate|: ``lattice.MAX_COORDINATE``."""

KEY_BITS = 22
"""Bits of a coordinate plus ``LIMIT``: the key of a vertex then has 43."""

GOOD, MISSING, THERE, FAR, LABEL, SHORT, THICK, TURNED = range(8)
"""What a kernel found: nothing wrong, or the first thing that is (``bands.REASONS``)."""

SALT_EDGE, SALT_THICKNESS = 2, 3

Kernel = TypeVar("Kernel", bound=Callable[..., object])

_GOLDEN, _MIX1, _MIX2 = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_S27, _S30, _S31 = np.uint64(27), np.uint64(30), np.uint64(31)


def modular(kernel: Kernel) -> Kernel:
    """Without its compiler numpy warns where a hash passes 2^64, which it is meant to."""
    return np.errstate(over="ignore")(kernel) if isinstance(kernel, FunctionType) else kernel


@kernel("u8(u8, i8)")
def _mix(h: np.uint64, value: int) -> np.uint64:
    """Take one number into a hash: ``hashing.hash_ints``."""
    h ^= np.uint64(np.int64(value))  # a negative number as its two's complement
    h += _GOLDEN
    h ^= h >> _S30
    h *= _MIX1
    h ^= h >> _S27
    h *= _MIX2
    h ^= h >> _S31
    return h


@kernel("u8(i4[:,::1], i8, i8)")
def row_hash(rows: NDArray[np.int32], i: int, thickness: int) -> np.uint64:
    """What an edge with its thickness adds to the digest."""
    h = np.uint64(SALT_EDGE)
    for k in range(5):
        h = _mix(h, int(rows[i, k]))
    if thickness > 0:
        t = np.uint64(SALT_THICKNESS)
        for k in range(5):
            t = _mix(t, int(rows[i, k]))
        h += _mix(t, thickness)
    return h


@modular
@kernel("u8(i4[:,::1])")
def sum_of_hashes(rows: NDArray[np.int32]) -> np.uint64:
    """What all rows, (n, 6), add to the digest, mod 2^64."""
    total = np.uint64(0)
    for i in range(len(rows)):
        total += row_hash(rows, i, int(rows[i, 5]))
    return total


@kernel("i8(i4[:,::1], i8, i4[:,::1], i8)")
def compare(a: NDArray[np.int32], i: int, b: NDArray[np.int32], j: int) -> int:
    """The canonical order of two rows: -1, 0 or 1."""
    for k in range(5):
        if a[i, k] != b[j, k]:
            return -1 if a[i, k] < b[j, k] else 1
    return 0


@kernel("i8(i4[:,::1], i8, i8, i4[:,::1], i8)")
def bound(rows: NDArray[np.int32], low: int, high: int, other: NDArray[np.int32], j: int) -> int:
    """The first place in [low, high) whose row is ``other[j]`` or behind it."""
    while low < high:
        middle = (low + high) // 2
        if compare(rows, middle, other, j) < 0:
            low = middle + 1
        else:
            high = middle
    return low


@kernel("i8(i8, i8, i8, i8, i8)")
def check_edge(y0: int, x0: int, y1: int, x1: int, label: int) -> int:
    """Whether an edge can be, in either direction."""
    # Each against both bounds: the absolute value of the least number is no number.
    if min(y0, x0, y1, x1) < -LIMIT or max(y0, x0, y1, x1) > LIMIT:
        return FAR
    if label < 0 or label > 8 or label // 3 == label % 3:
        return LABEL
    return SHORT if y0 == y1 and x0 == x1 else GOOD
