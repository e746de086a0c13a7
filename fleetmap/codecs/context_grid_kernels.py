"""Numba kernels of the exact layer: one procedure writes and reads the states of a grid, row by row."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.codecs.range_kernels import AT, GOOD, MODE, NOT_SHORTEST, READ, STATUS, decide
from fleetmap.model.kernel import kernel

# Literals, since numba compiles globals in: FREE = 0, OCCUPIED = 1, UNKNOWN = 2.

MODELS, BASE_MODELS = 4, 6
"""Neighbourhoods that are mixed: without and with a base."""

MOST_SEEN = 1000
"""A chance moves 1 / (n + 1.5) of its way to what has happened after n times, and no less than after so many."""

SEEN_BITS = 10
"""A cell of a table holds a chance, out of 2^22, and in the bits below how often it was used."""

CERTAIN = (1 << 22) - 1
START = 1 << 31

BEHIND = 24
"""Reading ends in error so many bytes behind the last one: more zeros than these no writer leaves out, and without an
end they would be states that cost a liar nothing."""

START_WEIGHT = 22938
"""0.35, in 65536ths: weights add up to more than 1, since neighbourhoods are surer together."""


@kernel("void(u4[::1], i8, i8)", inline="always")
def learn(table: NDArray[np.uint32], at: int, value: int) -> None:
    """Move a chance towards what has happened."""
    cell = np.int64(table[at])
    chance, seen = cell >> SEEN_BITS, cell & ((1 << SEEN_BITS) - 1)
    chance += ((CERTAIN * value - chance) * (131072 // (2 * seen + 3))) >> 16
    table[at] = (chance << SEEN_BITS) | min(seen + 1, MOST_SEEN)


@kernel("i8(i8)", inline="always")
def log_size(run: int) -> int:
    """The length in bits of a run, at most 12."""
    size = 0
    while run > 0 and size < 12:
        run >>= 1
        size += 1
    return size


@kernel("i8(u1[:,::1], i8, i8)", inline="always")
def base_at(base: NDArray[np.uint8], y: int, x: int) -> int:
    """The base's state; unknown beyond its rim."""
    return np.int64(base[y, x]) if 0 <= y < base.shape[0] and 0 <= x < base.shape[1] else 2


@kernel("void(i8[::1], u1[::1], u1[:,::1], u1[:,::1], i8[::1], i8[::1])")
def code_states(
    coder: NDArray[np.int64],
    data: NDArray[np.uint8],
    states: NDArray[np.uint8],
    base: NDArray[np.uint8],
    chances: NDArray[np.int64],
    odds: NDArray[np.int64],
) -> None:
    """Write the states, or read them into their array; see docs/format.md, Exact layer.

    A cell takes a decision whether it is other than the one on its left, w, and if so one which of the other two. If
    all twelve neighbours are alike (and the base says so, too) its chance stands in one table; else the models' chances
    are mixed.
    """
    height, width = states.shape
    edge = np.int64(len(chances) // 2)  # largest log odds
    has_base = len(base) > 0
    models = BASE_MODELS if has_base else MODELS
    sizes = (2 * 3**6, 2 * 3**12, 2 * 13 * 13 * 27, 2 * 3**9, 2 * 3**11, 2 * 3**9)
    offset = np.zeros(BASE_MODELS + 1, np.int64)
    for i in range(models):
        offset[i + 1] = offset[i] + sizes[i]
    table = np.full(offset[models], START, np.uint32)
    alike = np.full(2 * 3 * 13 * 13, START, np.uint32)
    weights = np.full((2 * 27, BASE_MODELS), START_WEIGHT, np.int64)
    above = np.full((4, width + 8), 2, np.uint8)  # this row and the three before it, with a rim
    fall = np.zeros(width, np.int64)  # since how many rows a column has not changed
    at, stretched = np.empty(BASE_MODELS, np.int64), np.empty(BASE_MODELS, np.int64)
    for y in range(height):
        for k in range(3):
            above[3 - k] = above[2 - k]
        above[0, :] = 2
        row, one, two, three = above[0], above[1], above[2], above[3]
        run = 0
        for x in range(width):
            c = x + 4
            w, ww, www = np.int64(row[c - 1]), np.int64(row[c - 2]), np.int64(row[c - 3])
            n, nw, ne = np.int64(one[c]), np.int64(one[c - 1]), np.int64(one[c + 1])
            nww, nee, nn = np.int64(one[c - 2]), np.int64(one[c + 2]), np.int64(two[c])
            nnw, nne, nnn = np.int64(two[c - 1]), np.int64(two[c + 1]), np.int64(three[c])
            across, down = log_size(run), log_size(fall[x])
            same = (
                w == nw == n == ne == ww == nn and w == nww == nee == nnw == nne == www == nnn
                and (
                    not has_base
                    or w == base_at(base, y, x) == base_at(base, y, x + 1) == base_at(base, y + 1, x - 1)
                    == base_at(base, y + 1, x) == base_at(base, y + 1, x + 1)
                )
            )  # fmt: skip
            is_other = np.int64(states[y, x] != w)
            is_second = np.int64((states[y, x] + 3 - w) % 3 == 2)
            if same:
                first = 2 * (169 * w + 13 * across + down)
                is_other = decide(coder, data, min(max(np.int64(alike[first]) >> 16, 2), 65534), is_other)
                learn(alike, first, is_other)
                if is_other:
                    chance = min(max(np.int64(alike[first + 1]) >> 16, 2), 65534)
                    is_second = decide(coder, data, chance, is_second)
                    learn(alike, first + 1, is_second)
            else:
                if coder[MODE] == READ and coder[AT] > len(data) + BEHIND:
                    coder[STATUS] = NOT_SHORTEST
                    return
                six = ((((w * 3 + nw) * 3 + n) * 3 + ne) * 3 + ww) * 3 + nn
                twelve = (((((six * 3 + www) * 3 + nww) * 3 + nee) * 3 + nnw) * 3 + nne) * 3 + nnn
                beside = (w * 3 + n) * 3 + ne
                wide = ((((n * 3 + ne) * 3 + nee) * 3 + one[c + 3]) * 3 + w) * 3 + nw
                wide = ((wide * 3 + nww) * 3 + one[c - 3]) * 3 + ww
                at[0], at[1] = offset[0] + 2 * six, offset[1] + 2 * twelve
                at[2], at[3] = offset[2] + 2 * ((across * 13 + down) * 27 + beside), offset[3] + 2 * wide
                if has_base:
                    around = np.int64(0)
                    for dy in range(-1, 2):
                        for dx in range(-1, 2):
                            around = 3 * around + base_at(base, y + dy, x + dx)
                    at[4] = offset[4] + 2 * (9 * around + 3 * w + n)
                    ahead = (base_at(base, y, x) * 3 + base_at(base, y, x + 1)) * 3 + base_at(base, y + 1, x)
                    at[5] = offset[5] + 2 * (27 * six + ahead)
                for node in range(2):
                    mix = np.int64(0)
                    own = weights[2 * beside + node]
                    for i in range(models):
                        stretched[i] = odds[np.int64(table[at[i] + node]) >> 20]
                        mix += own[i] * stretched[i]
                    chance = chances[min(max(mix >> 16, -edge), edge) + edge]
                    value = decide(coder, data, min(max(chance, 32), 65504), is_second if node else is_other)
                    error = 65535 * value - chance
                    for i in range(models):
                        own[i] += (stretched[i] * error * 14 + (1 << 17)) >> 18
                        learn(table, at[i] + node, value)
                    if node:
                        is_second = value
                    else:
                        is_other = value
                        if not value:
                            break
            state = w
            if is_other:
                state = (w + (2 if is_second else 1)) % 3
            states[y, x] = state
            row[c] = state
            run = run + 1 if state == w else 0
            fall[x] = fall[x] + 1 if state == n else 0
        if coder[STATUS] != GOOD:
            return
