"""Numba kernels of the range coder: decisions whose chances are learned, and whole numbers made of them.

One procedure describes what is written *and* read: each function takes a value, and returns the value that it wrote,
or what it read instead. ``coder`` is (8,) int64, its fields below; ``data`` holds the bytes. ``memory`` holds for each
context two chances of a 1, out of 2^16, one that moves fast and one that moves slowly, and how often they were used:
fast + 2^16 slow + 2^32 seen. Whole numbers below 2^48 only: the same bytes everywhere.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.codecs.contexts import LENGTHS, TREE, UNARY
from fleetmap.model.kernel import kernel

MODE, LOW, RANGE, AT, STATUS, ITEMS, MOST_ITEMS, MOST_EDGES = range(8)
"""READ, WRITE or COUNT; the interval's start (of the code in it, when reading) and width; bytes written or read; what
went wrong first; what was coded so far, and how much may be."""

READ, WRITE, COUNT = 0, 1, 2
"""COUNT writes nothing: it adds up each context's decisions in ``memory``, zeros + 2^32 ones."""

GOOD, FULL, FIRST, LEFT_OVER, NOT_SHORTEST, LONG, TOO_MANY, FAR, NO_TARGET, THICK, NOT_THERE, TWICE = range(12)
"""What went wrong (``range_coder.REASONS``)."""

FAST, SLOW = 65536 // 16, 65536 // 128
"""The least steps of both chances towards what has happened, out of 2^16."""

MOST_SEEN = 127
"""From here on neither step grows shorter."""

STEPS = np.array([[max(327680 // (5 * n + 8), least) for least in (FAST, SLOW)] for n in range(MOST_SEEN + 1)])
"""By how often a context was used: 1 / (n + 1.6), in 65536ths, but no less than those."""

MAX_LENGTH = 34
"""Longest number, in bits less one."""

TOP = 1 << 24
WHOLE = (1 << 32) - 1


@kernel("void(i8[::1], u1[::1])")
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


@kernel("void(u1[::1], i8)")
def _carry(data: NDArray[np.uint8], at: int) -> None:
    """Add one to the number that the first ``at`` bytes are."""
    at -= 1
    while at >= 0 and data[at] == 255:
        data[at] = 0
        at -= 1
    if at >= 0:
        data[at] = data[at] + 1


@kernel("void(i8[::1], u1[::1])")
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


@kernel("i8(i8[::1], u1[::1], i8, i8)", inline="always")
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


@kernel("i8(i8[::1], u1[::1], i8)")
def even(coder: NDArray[np.int64], data: NDArray[np.uint8], value: int) -> int:
    """One decision that is as likely as not."""
    return value if coder[MODE] == COUNT else decide(coder, data, 32768, value)


@kernel("i8(i8[::1], i8[::1], u1[::1], i8, i8)", inline="always")
def told(coder: NDArray[np.int64], memory: NDArray[np.int64], data: NDArray[np.uint8], context: int, value: int) -> int:
    """One decision, whose chance is learned in ``context``."""
    if coder[MODE] == COUNT:
        memory[context] += 1 << 32 if value else 1
        return value
    cell = memory[context]
    fast, slow, seen = cell & 65535, cell >> 16 & 65535, cell >> 32
    value = decide(coder, data, min(max((fast + slow) >> 1, 32), 65504), value)
    aim = 65535 if value else 0
    fast += ((aim - fast) * STEPS[seen, 0]) >> 16
    slow += ((aim - slow) * STEPS[seen, 1]) >> 16
    memory[context] = min(seen + 1, MOST_SEEN) << 32 | slow << 16 | fast
    return value


@kernel("i8(i8)")
def length_of(value: int) -> int:
    """How many bits a number >= 0 has."""
    length = 0
    while value > 0:
        value >>= 1
        length += 1
    return length


@kernel("i8(i8[::1], i8[::1], u1[::1], i8, i8, i8, i8)")
def amount(
    coder: NDArray[np.int64],
    memory: NDArray[np.int64],
    data: NDArray[np.uint8],
    context: int,
    lower: int,
    expected: int,
    value: int,
) -> int:
    """A number >= 0: the length of value + 1 less one in ones and a zero, then the bits below its leading one.

    With ``lower`` < 0 these are as likely as not; ``expected`` is what it may well be, or -1.
    """
    size, length = length_of(value + 1) - 1, 0
    while told(coder, memory, data, context + min(length, UNARY - 1), 1 if length < size else 0):
        length += 1
        if length > MAX_LENGTH:
            coder[STATUS] = LONG if coder[STATUS] == GOOD else coder[STATUS]
            return 0
    result, tree = 1, 1
    for k in range(length - 1, -1, -1):
        bit = (value + 1) >> k & 1
        if lower < 0 or length >= LENGTHS:
            bit = even(coder, data, bit)
        else:
            done = length - 1 - k
            node = 3 * (tree - 1 if done < 3 else min(4 + done, 12))
            if (expected + 1) >> (k + 1) == result:
                node += 1 + ((expected + 1) >> k & 1)
            bit = told(coder, memory, data, lower + length * TREE + node, bit)
        result, tree = 2 * result + bit, 2 * tree + bit
    return result - 1


@kernel("i8(i8[::1], i8[::1], u1[::1], i8, i8, i8)")
def signed(
    coder: NDArray[np.int64], memory: NDArray[np.int64], data: NDArray[np.uint8], context: int, lower: int, value: int
) -> int:
    """A number of either sign: the magnitude, and unless it is 0 whether it is negative."""
    size = amount(coder, memory, data, context, lower, -1, abs(value))
    return -size if size and even(coder, data, 1 if value < 0 else 0) else size


@kernel("void(i8[::1], i8, i8)")
def spend(coder: NDArray[np.int64], items: int, edges: int) -> None:
    """Note that so many items follow, and how many edges or roots there are by then: what hostile bytes may cost."""
    coder[ITEMS] += items
    if coder[STATUS] == GOOD and (coder[ITEMS] > coder[MOST_ITEMS] or edges > coder[MOST_EDGES]):
        coder[STATUS] = TOO_MANY


@kernel("void(i8[::1], u1[::1])")
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


@kernel("void(i8[::1], u1[::1])")
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
