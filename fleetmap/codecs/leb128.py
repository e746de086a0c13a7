"""LEB128 and zigzag: whole numbers as bytes, a vector of them at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

MAX_BYTES = 5
"""Longest number, in bytes: 35 bits, far more than any count or coordinate takes."""

REASONS = (
    "",
    "the last number is cut off",
    f"a number is longer than {MAX_BYTES} bytes",
    "a number is not in its shortest form",
)
"""In words what is wrong, by its number in ``number_kernels``."""


def encode_leb128(values: NDArray[np.int64]) -> bytes:
    """(n,) numbers in [0, 2^35) -> seven bits a byte, least significant first, top bit set on all but the last."""
    from fleetmap.codecs.number_kernels import to_leb128

    good, data = to_leb128(np.ascontiguousarray(values))
    if not good:
        raise ValueError(f"expected numbers in [0, 2^{7 * MAX_BYTES})")
    return data.tobytes()


def decode_leb128(data: bytes) -> NDArray[np.int64]:
    """(n,) int64: all the numbers in ``data``.

    Raises
    ------
    ValueError : a number is cut off, longer than ``MAX_BYTES``, or not in its shortest form
    """
    from fleetmap.codecs.number_kernels import from_leb128

    found, values = from_leb128(np.frombuffer(bytearray(data), np.uint8))
    if found:
        raise ValueError(REASONS[found])
    return values


def zigzag(values: NDArray[np.int64]) -> NDArray[np.int64]:
    """0, -1, 1, -2, ... -> 0, 1, 2, 3, ..."""
    return (values << 1) ^ (values >> 63)


def unzigzag(values: NDArray[np.int64]) -> NDArray[np.int64]:
    """0, 1, 2, 3, ... -> 0, -1, 1, -2, ..."""
    return (values >> 1) ^ -(values & 1)
