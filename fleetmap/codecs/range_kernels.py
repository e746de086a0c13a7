"""Numba kernels of the range coder: decisions with learned probabilities, and whole numbers made of them.

One procedure describes what is written *and* read: each function takes a value, and returns the value that it wrote,
or what it read instead. ``coder`` is (8,) int64, its fields below; ``data`` holds the bytes, and ``probabilities``
the chance, out of 2^12, that a context's next decision is 0. Whole numbers below 2^45 only: the same bytes everywhere.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fleetmap.codecs.mode1_layout import WIDTH

MODE, LOW, RANGE, AT, STATUS, ITEMS, MOST_ITEMS, MOST_EDGES = range(8)
"""READ, WRITE or COUNT; the interval's start (of the code in it, when reading) and width; bytes written or read; what
went wrong first; what was coded so far, and how much may be."""

READ, WRITE, COUNT = 0, 1, 2
"""COUNT writes nothing: it adds up each context's decisions in ``probabilities[2 * context + decision]``."""

GOOD, FULL, FIRST, LEFT_OVER, NOT_SHORTEST, LONG, TOO_MANY, FAR, NO_TARGET, THICK, NOT_THERE, TWICE = range(12)
"""What went wrong (``mode1.REASONS``)."""

PROBABILITY_BITS = 12
RATE = 5
"""A probability moves 1 / 2^RATE of its way to what has happened."""

LENGTHS = 12
MAX_LENGTH = 34
"""Longest number, in bits."""

TOP = 1 << 24
WHOLE = (1 << 32) - 1


@njit("void(i8[::1], u1[::1])", cache=True, nogil=True)
def begin(coder: NDArray[np.int64], data: NDArray[np.uint8]) -> None:
    """Start writing, or read the first four bytes; the other fields of ``coder`` are set already."""
    coder[RANGE] = WHOLE
    coder[LOW] = 0
    coder[AT] = 0
    if coder[MODE] == READ:
        for i in range(4):
            coder[LOW] = coder[LOW] << 8 | (int(data[i]) if i < len(data) else 0)
        coder[AT] = 4
        if coder[LOW] >= coder[RANGE]:
            coder[STATUS] = FIRST


@njit("void(u1[::1], i8)", cache=True, nogil=True)
def _carry(data: NDArray[np.uint8], at: int) -> None:
    """Add one to the number that the first ``at`` bytes are."""
    at -= 1
    while at >= 0 and data[at] == 255:
        data[at] = 0
        at -= 1
    if at >= 0:
        data[at] = data[at] + 1


@njit("void(i8[::1], u1[::1])", cache=True, nogil=True)
def renew(coder: NDArray[np.int64], data: NDArray[np.uint8]) -> None:
    """Bytes out, or in, until the interval is wide enough for the next decision."""
    if coder[LOW] > WHOLE:  # only when writing
        _carry(data, coder[AT])
        coder[LOW] &= WHOLE
    while coder[RANGE] < TOP:
        coder[RANGE] <<= 8
        at = coder[AT]
        if coder[MODE] == READ:
            coder[LOW] = coder[LOW] << 8 | (int(data[at]) if at < len(data) else 0)
            coder[AT] = at + 1
        else:
            if at < len(data):
                data[at] = coder[LOW] >> 24
                coder[AT] = at + 1
            elif coder[STATUS] == GOOD:
                coder[STATUS] = FULL
            coder[LOW] = coder[LOW] << 8 & WHOLE


@njit("i8(i8[::1], i8[::1], u1[::1], i8, i8)", cache=True, nogil=True, inline="always")
def bit(
    coder: NDArray[np.int64], probabilities: NDArray[np.int64], data: NDArray[np.uint8], context: int, value: int
) -> int:
    """One decision, whose probability is learned in ``context``."""
    if coder[MODE] == COUNT:
        probabilities[2 * context + value] += 1
        return value
    zero = probabilities[context]
    bound = (coder[RANGE] >> PROBABILITY_BITS) * zero
    if coder[MODE] == READ:
        value = 1 if coder[LOW] >= bound else 0
    if value:
        coder[LOW] += -bound if coder[MODE] == READ else bound
        coder[RANGE] -= bound
        probabilities[context] = zero - (zero >> RATE)
    else:
        coder[RANGE] = bound
        probabilities[context] = zero + (((1 << PROBABILITY_BITS) - zero) >> RATE)
    if coder[RANGE] < TOP or coder[LOW] > WHOLE:
        renew(coder, data)
    return value


@njit("i8(i8[::1], u1[::1], i8)", cache=True, nogil=True)
def even(coder: NDArray[np.int64], data: NDArray[np.uint8], value: int) -> int:
    """One decision that is as likely as not."""
    if coder[MODE] == COUNT:
        return value
    half = coder[RANGE] >> 1
    if coder[MODE] == READ:
        value = 1 if coder[LOW] >= half else 0
    if value:
        coder[LOW] += -half if coder[MODE] == READ else half
        coder[RANGE] -= half
    else:
        coder[RANGE] = half
    if coder[RANGE] < TOP or coder[LOW] > WHOLE:
        renew(coder, data)
    return value


@njit("i8(i8[::1], u1[::1], i8, i8)", cache=True, nogil=True, inline="always")
def decide(coder: NDArray[np.int64], data: NDArray[np.uint8], chance: int, value: int) -> int:
    """One decision that is 1 with a chance out of 2^16; it is written, or read and returned."""
    bound = (coder[RANGE] >> 16) * chance
    if coder[MODE] == READ:
        value = 1 if coder[LOW] < bound else 0
    if value:
        coder[RANGE] = bound
    else:
        coder[LOW] += -bound if coder[MODE] == READ else bound
        coder[RANGE] -= bound
    if coder[RANGE] < TOP or coder[LOW] > WHOLE:
        renew(coder, data)
    return value


@njit("i8(i8)", cache=True, nogil=True)
def length_of(value: int) -> int:
    """How many bits a number >= 0 has."""
    length = 0
    while value > 0:
        value >>= 1
        length += 1
    return length


@njit("i8(i8[::1], i8[::1], u1[::1], i8, i8)", cache=True, nogil=True)
def number(
    coder: NDArray[np.int64], probabilities: NDArray[np.int64], data: NDArray[np.uint8], context: int, value: int
) -> int:
    """A number >= 0: its length in bits as ones and a zero, then the bits below the leading one."""
    size, length = length_of(value), 0
    while bit(coder, probabilities, data, context + min(length, LENGTHS - 1), 1 if length < size else 0):
        length += 1
        if length > MAX_LENGTH:
            coder[STATUS] = LONG if coder[STATUS] == GOOD else coder[STATUS]
            return 0
    if length < 2:
        return length
    place = length - 2
    below = context + LENGTHS + min(place, WIDTH - LENGTHS - 1)
    result = 2 + bit(coder, probabilities, data, below, value >> place & 1)
    while place > 0:
        place -= 1
        result = 2 * result + even(coder, data, value >> place & 1)
    return result


@njit("i8(i8[::1], i8[::1], u1[::1], i8, i8, i8)", cache=True, nogil=True)
def signed(
    coder: NDArray[np.int64],
    probabilities: NDArray[np.int64],
    data: NDArray[np.uint8],
    context: int,
    sign: int,
    value: int,
) -> int:
    """The magnitude, and unless it is 0 the sign, in the context ``sign`` (-1: as likely as not)."""
    size = number(coder, probabilities, data, context, abs(value))
    if size == 0:
        return 0
    negative = 1 if value < 0 else 0
    negative = even(coder, data, negative) if sign < 0 else bit(coder, probabilities, data, sign, negative)
    return -size if negative else size


@njit("void(i8[::1], i8, i8)", cache=True, nogil=True)
def spend(coder: NDArray[np.int64], items: int, edges: int) -> None:
    """Note that so many items follow, and how many edges or roots there are by then: what hostile bytes may cost."""
    coder[ITEMS] += items
    if coder[STATUS] == GOOD and (coder[ITEMS] > coder[MOST_ITEMS] or edges > coder[MOST_EDGES]):
        coder[STATUS] = TOO_MANY


@njit("void(i8[::1], u1[::1])", cache=True, nogil=True)
def finish_writing(coder: NDArray[np.int64], data: NDArray[np.uint8]) -> None:
    """The shortest bytes whose number lies in the interval, and of those the least; ``coder[AT]`` is their count."""
    if coder[STATUS] != GOOD:
        return
    at, low, end = coder[AT], coder[LOW], coder[LOW] + coder[RANGE]
    if at + 4 > len(data):
        coder[STATUS] = FULL
        return
    spare = 4
    while ((low + (1 << 8 * spare) - 1) >> 8 * spare) << 8 * spare >= end:
        spare -= 1
    low = ((low + (1 << 8 * spare) - 1) >> 8 * spare) << 8 * spare
    if low > WHOLE:
        _carry(data, at)
    for i in range(4 - spare):
        data[at + i] = low >> (24 - 8 * i) & 255
    at += 4 - spare
    while at > 0 and data[at - 1] == 0:
        at -= 1
    coder[AT] = at


@njit("void(i8[::1], u1[::1])", cache=True, nogil=True)
def finish_reading(coder: NDArray[np.int64], data: NDArray[np.uint8]) -> None:
    """Check that the data are what ``finish_writing`` gives for the decisions that were read."""
    if coder[STATUS] != GOOD:
        return
    missing = coder[AT] - len(data)
    if missing < 0:
        coder[STATUS] = LEFT_OVER
        return
    # The interval starts ``code`` below the data: neither a lesser number of this length may lie within, nor one of
    # fewer bytes, below (the last byte 0) or above. From four bytes missing on, all of the code lies behind the data.
    step = 8 * min(missing, 4)
    last = int(data[-1]) if len(data) else 0
    to_shorter = (256 - last) << step
    if coder[LOW] >> step or (len(data) and (last == 0 or to_shorter < coder[RANGE] - coder[LOW])):
        coder[STATUS] = NOT_SHORTEST
