"""LEB128 and zigzag: whole numbers as bytes, a vector of them at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

MAX_BYTES = 5
"""Longest number, in bytes: 35 bits, far more than any count or coordinate takes."""


def encode_leb128(values: NDArray[np.int64]) -> bytes:
    """(n,) numbers in [0, 2^35) -> seven bits a byte, least significant first, top bit set on all but the last."""
    if len(values) == 0:
        return b""
    if values.min() < 0 or int(values.max()) >> (7 * MAX_BYTES):
        raise ValueError(f"expected numbers in [0, 2^{7 * MAX_BYTES})")
    shifts = 7 * np.arange(MAX_BYTES)
    groups = (values[:, None] >> shifts) & 0x7F
    more = (values[:, None] >> (shifts + 7)) > 0
    used = np.ones_like(more)
    used[:, 1:] = more[:, :-1]
    return (groups | (more << 7)).astype(np.uint8)[used].tobytes()


def decode_leb128(data: bytes) -> NDArray[np.int64]:
    """(n,) int64: all the numbers in ``data``.

    Raises
    ------
    ValueError : a number is cut off, longer than ``MAX_BYTES``, or not in its shortest form
    """
    raw = np.frombuffer(data, np.uint8)
    if len(raw) == 0:
        return np.zeros(0, np.int64)
    last = raw < 0x80
    if not last[-1]:
        raise ValueError("the last number is cut off")
    stops = np.flatnonzero(last)
    starts = np.concatenate([[0], stops[:-1] + 1])
    lengths = stops - starts + 1
    if lengths.max() > MAX_BYTES:
        raise ValueError(f"a number is longer than {MAX_BYTES} bytes")
    if ((lengths > 1) & (raw[stops] == 0)).any():
        raise ValueError("a number is not in its shortest form")
    place = np.arange(len(raw)) - np.repeat(starts, lengths)
    parts = (raw & 0x7F).astype(np.int64) << (7 * place)
    return np.add.reduceat(parts, starts).astype(np.int64)


def zigzag(values: NDArray[np.int64]) -> NDArray[np.int64]:
    """0, -1, 1, -2, ... -> 0, 1, 2, 3, ..."""
    return (values << 1) ^ (values >> 63)


def unzigzag(values: NDArray[np.int64]) -> NDArray[np.int64]:
    """0, 1, 2, 3, ... -> 0, -1, 1, -2, ..."""
    return (values >> 1) ^ -(values & 1)
