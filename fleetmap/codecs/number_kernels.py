"""Numba kernels of payload mode 0: a delta's fields as a row of numbers, and numbers as LEB128."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.codecs.chain_kernels import CLASS, DX, DY, STARTS, THICKNESS
from fleetmap.model.kernel import kernel

MAX_BYTES = 5
"""Longest number, in bytes: 35 bits, far more than any count or coordinate takes."""

GOOD, CUT_OFF, TOO_LONG, NOT_SHORTEST = range(4)
"""What is wrong with bytes (``leb128.REASONS``)."""


@kernel("i8(i8)")
def _zigzag(value: int) -> int:
    """0, -1, 1, -2, ... -> 0, 1, 2, 3, ..."""
    return value << 1 ^ value >> 63


@kernel("i8[::1](i8[::1], i8[::1], i8[:,::1], i8[:,::1], i8[:,::1], i8)")
def numbers_of(
    removed: NDArray[np.int64],
    known_roots: NDArray[np.int64],
    absolute_roots: NDArray[np.int64],
    edges: NDArray[np.int64],
    rethickened: NDArray[np.int64],
    thick_frontiers: int,
) -> NDArray[np.int64]:
    """The numbers of mode 0, in their order: a chain is a run of edges of one class in a walk."""
    n = len(edges)
    chains = runs = 0
    head, run = np.empty(n, np.int64), np.empty((n, 2), np.int64)
    for i in range(n):
        if edges[i, STARTS] or edges[i, CLASS] != edges[i - 1, CLASS]:
            head[chains] = (0 if edges[i, STARTS] else 1) + 2 * edges[i, CLASS]
            chains += 1
        else:
            head[chains - 1] += 6
        if edges[i, CLASS] != 1 or thick_frontiers:
            if runs == 0 or run[runs - 1, 0] != edges[i, THICKNESS]:
                run[runs, 0], run[runs, 1] = edges[i, THICKNESS], 0
                runs += 1
            run[runs - 1, 1] += 1
    size = 6 + len(removed) + len(known_roots) + 2 * len(absolute_roots) + chains + 2 * n + 2 * runs
    numbers = np.empty(size + 2 * len(rethickened), np.int64)
    numbers[0], numbers[1], numbers[2] = len(removed), len(known_roots), len(absolute_roots)
    numbers[3], numbers[4], numbers[5] = chains, runs, len(rethickened)
    at = 6
    place = -1
    for i in range(len(removed)):
        numbers[at] = removed[i] - place - 1
        place = removed[i]
        at += 1
    rank = 0
    for i in range(len(known_roots)):
        numbers[at] = known_roots[i] - rank  # two walks may leave the same root
        rank = known_roots[i]
        at += 1
    for i in range(len(absolute_roots)):
        numbers[at], numbers[at + 1] = _zigzag(absolute_roots[i, 0]), _zigzag(absolute_roots[i, 1])
        at += 2
    for i in range(chains):
        numbers[at] = head[i]
        at += 1
    for i in range(n):
        numbers[at], numbers[at + 1] = _zigzag(edges[i, DY]), _zigzag(edges[i, DX])
        at += 2
    for i in range(runs):
        numbers[at], numbers[at + 1] = run[i, 0], run[i, 1]
        at += 2
    place = -1
    for i in range(len(rethickened)):
        numbers[at], numbers[at + 1] = rethickened[i, 0] - place - 1, rethickened[i, 1]
        place = rethickened[i, 0]
        at += 2
    return numbers


@kernel("Tuple((b1, u1[::1]))(i8[::1])")
def to_leb128(values: NDArray[np.int64]) -> tuple[bool, NDArray[np.uint8]]:
    """Whether all numbers are in [0, 2^35), and them, seven bits a byte."""
    data = np.empty(MAX_BYTES * len(values), np.uint8)
    at = 0
    for i in range(len(values)):
        value = values[i]
        if value < 0 or value >> 7 * MAX_BYTES:
            return False, data[:0]
        while value > 127:
            data[at] = 128 | (value & 127)
            value >>= 7
            at += 1
        data[at] = value & 127
        at += 1
    return True, data[:at]


@kernel("Tuple((i8, i8[::1]))(u1[::1])")
def from_leb128(data: NDArray[np.uint8]) -> tuple[int, NDArray[np.int64]]:
    """All the numbers in ``data``, and what is wrong with them."""
    values = np.empty(len(data), np.int64)
    count, value, size = 0, 0, 0
    for i in range(len(data)):
        byte = int(data[i])
        if size == MAX_BYTES:
            return TOO_LONG, values[:0]
        value |= (byte & 127) << (7 * size)
        size += 1
        if byte < 128:
            if byte == 0 and size > 1:
                return NOT_SHORTEST, values[:0]
            values[count] = value
            count += 1
            value = 0
            size = 0
    return (CUT_OFF if size else GOOD), values[:count]
