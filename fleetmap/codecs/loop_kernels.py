"""Numba kernels of payload mode 2: a whole map as closed walks, each edge told by its turn and its length.

One procedure writes and reads, as in ``growth_kernels``. ``memory`` is (contexts, 3) int64: two chances of a 1 out of
2^16, one that moves fast and one that moves slowly, and how often both were used.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fleetmap.codecs import mode2_layout as at
from fleetmap.codecs.chain_kernels import CLASS, DX, DY, STARTS, THICKNESS
from fleetmap.codecs.range_kernels import (
    COUNT,
    FAR,
    GOOD,
    LONG,
    MODE,
    READ,
    STATUS,
    THICK,
    TOO_MANY,
    WRITE,
    decide,
    even,
    length_of,
    spend,
)
from fleetmap.model.row_kernels import LIMIT

FAST, SLOW = 65536 // 16, 65536 // 128
"""The least steps of both chances towards what has happened, out of 2^16."""

MOST_SEEN = 255


@njit("i8(i8[::1], i8[:,::1], u1[::1], i8, i8)", cache=True, nogil=True)
def told(coder: NDArray[np.int64], memory: NDArray[np.int64], data: NDArray[np.uint8], context: int, value: int) -> int:
    """One decision, whose chance is learned in ``context``; COUNT adds it up in ``memory[context, value]``."""
    if coder[MODE] == COUNT:
        memory[context, value] += 1
        return value
    cell = memory[context]
    value = decide(coder, data, min(max((cell[0] + cell[1]) >> 1, 32), 65504), value)
    step = 327680 // (5 * cell[2] + 8)
    aim = 65535 if value else 0
    cell[0] += ((aim - cell[0]) * max(step, FAST)) >> 16
    cell[1] += ((aim - cell[1]) * max(step, SLOW)) >> 16
    cell[2] = min(cell[2] + 1, MOST_SEEN)
    return value


@njit("i8(i8[::1], i8[:,::1], u1[::1], i8, i8, i8, i8)", cache=True, nogil=True)
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
    while told(coder, memory, data, context + min(length, at.UNARY - 1), 1 if length < size else 0):
        length += 1
        if length > 24:
            coder[STATUS] = LONG if coder[STATUS] == GOOD else coder[STATUS]
            return 0
    result, tree = 1, 1
    for k in range(length - 1, -1, -1):
        bit = (value + 1) >> k & 1
        if lower < 0 or length >= at.LENGTHS:
            bit = even(coder, data, bit)
        else:
            done = length - 1 - k
            node = 3 * (tree - 1 if done < 3 else min(4 + done, 12))
            if (expected + 1) >> (k + 1) == result:
                node += 1 + ((expected + 1) >> k & 1)
            bit = told(coder, memory, data, lower + length * at.TREE + node, bit)
        result, tree = 2 * result + bit, 2 * tree + bit
    return result - 1


@njit("Tuple((i8, i8, i8))(i8, i8)", cache=True, nogil=True)
def in_frame(dy: int, dx: int) -> tuple[int, int, int]:
    """Of a step the quadrant it goes to (0 right, 1 up, 2 left, 3 down), how far along, and how far to the left.

    Left lies within (-along, along]; a step to nowhere is (0, 0, 0).
    """
    if dx > 0 and -dx < dy <= dx:
        return 0, dx, dy
    if dy > 0 and -dy < -dx <= dy:
        return 1, dy, -dx
    if dx < 0 and dx < -dy <= -dx:
        return 2, -dx, -dy
    if dy < 0:
        return 3, -dy, dx
    return 0, 0, 0


@njit(
    "void(i8[::1], i8[:,::1], u1[::1], i8[:,::1], i8[:,::1], i8[::1])",
    cache=True,
    nogil=True,
)
def code_loops(
    coder: NDArray[np.int64],
    memory: NDArray[np.int64],
    data: NDArray[np.uint8],
    roots: NDArray[np.int64],
    edges: NDArray[np.int64],
    counts: NDArray[np.int64],
) -> None:
    """Closed walks: ``counts`` holds how many there are, and how many edges, in ``edges`` as ``DeltaFields`` has them.

    ``roots`` (n, 2) are places (y, x), ascending; the arrays' lengths bound what is read.
    """
    reading = coder[MODE] == READ
    loops = amount(coder, memory, data, at.LOOPS, -1, -1, counts[0])
    spend(coder, loops, loops)
    if coder[STATUS] == GOOD and loops > len(roots):
        coder[STATUS] = TOO_MANY
    if coder[STATUS] != GOOD or loops == 0:
        counts[0] = counts[1] = 0
        return
    low_y, low_x, high_x = np.int64(0), np.int64(0), np.int64(0)
    if not reading:
        low_y, low_x, high_x = roots[0, 0], roots[:loops, 1].min(), roots[:loops, 1].max()
    low_y = amount(coder, memory, data, at.WIDTH, -1, -1, low_y + LIMIT) - LIMIT
    low_x = amount(coder, memory, data, at.WIDTH, -1, -1, low_x + LIMIT) - LIMIT
    width_bits = length_of(amount(coder, memory, data, at.WIDTH, -1, -1, high_x - low_x))
    y, n = low_y, 0
    thickness = np.int64(4)
    triangle = was_triangle = np.int64(0)
    for loop in range(loops):
        y += amount(coder, memory, data, at.ROW, -1, -1, roots[loop, 0] - y)
        x = np.int64(0)
        for k in range(width_bits - 1, -1, -1):
            x = 2 * x + even(coder, data, (roots[loop, 1] - low_x) >> k & 1)
        x += low_x
        if coder[STATUS] == GOOD and max(abs(y), abs(x)) > LIMIT:
            coder[STATUS] = FAR
        if coder[STATUS] != GOOD:
            return
        roots[loop, 0], roots[loop, 1] = y, x
        to_y, to_x = np.int64(0), np.int64(0)  # the way walked from the root
        low_h, low_w, high_h, high_w = np.int64(0), np.int64(0), np.int64(0), np.int64(0)
        first, area = n, np.int64(0)
        before, run, quadrant, turn, last_turn = 3, 0, 0, 3, np.int64(0)
        if not reading:
            third = first + 3
            triangle = 1 if third <= counts[1] and (third == counts[1] or edges[third, STARTS]) else 0
            if triangle and (edges[first + 1, STARTS] or edges[first + 2, STARTS]):
                triangle = 0
        triangle = told(coder, memory, data, at.TRIANGLE + was_triangle, triangle)
        was_triangle = triangle
        one, two, aside = np.int64(0), np.int64(0), np.int64(0)  # lengths of the last edges, and the last one's left
        closes = 0
        while not closes:
            i = n - first
            spend(coder, 1, n + 1)
            if coder[STATUS] == GOOD and n >= len(edges):
                coder[STATUS] = TOO_MANY
            if coder[STATUS] == GOOD and max(abs(y + to_y), abs(x + to_x)) > LIMIT:
                coder[STATUS] = FAR
            if coder[STATUS] != GOOD:
                return
            edge = edges[n]
            if triangle:
                closes = np.int64(i == 2)
            elif i >= 3 or i == 1:  # two edges that go back and forth are a walk, too
                home = (in_frame(to_y, to_x)[0] + 2) & 3
                far = max(abs(to_y), abs(to_x))
                off = min(abs(to_y), abs(to_x))
                kind = 0 if off == 0 else 1 if (home - quadrant) & 1 else 2 if home == quadrant else 3
                kind = 4 if kind and off > 2 else kind
                context = at.CLOSE + (min(length_of(far), 11) * 5 + kind) * 4 + min(i, 5) - 2 + (1 if i == 1 else 0)
                last = n + 1 >= counts[1] or edges[n + 1, STARTS]
                closes = told(coder, memory, data, context, 1 if not reading and last else 0)
            context = at.CLASS + 2 * ((before * 4 + min(run, 3)) * 6 + min(length_of(one), 5))
            if triangle:
                context = at.CLASS + 2 * (4 * 4 * 6 + 4 * i + before)
            label = told(coder, memory, data, context, 1 if edge[CLASS] > 0 else 0)
            if label:
                label += told(coder, memory, data, context + 1, 1 if edge[CLASS] > 1 else 0)
            if closes:
                dy, dx = -to_y, -to_x
            else:
                group = 3 + i if triangle else label
                q, along, left = in_frame(edge[DY], edge[DX])
                r = (q - quadrant) & 3
                one_bits, two_bits = min(length_of(one), 5), min(length_of(two), 4)
                context = at.TURN + 3 * (((group * 6 + one_bits) * 5 + two_bits) * 4 + turn)
                low = told(coder, memory, data, context, r & 1)
                r = 2 * told(coder, memory, data, context + 1 + low, r >> 1) + low
                q = (quadrant + r) & 3
                way = 0 if r == 0 else 1 if r == 1 else 2
                context = at.LENGTH + ((group * 3 + way) * 6 + one_bits) * at.UNARY
                lower = at.LOWER + group * at.LENGTHS * at.TREE
                # A side across from an equal one.
                expected = two - 1 if i >= 2 and (r + last_turn) & 1 == 0 else -1
                along = 1 + amount(coder, memory, data, context, lower, expected, along - 1)
                sign = 1 + (1 if aside > 0 else -1 if aside < 0 else 0)
                context = at.ASIDE + 2 * (((group * 7 + min(length_of(along), 6)) * 4 + r) * 3 + sign)
                if told(coder, memory, data, context, 1 if left != 0 else 0):
                    right = 0
                    if along > 1:
                        right = told(coder, memory, data, context + 1, 1 if left < 0 else 0)
                    left = 1 + amount(
                        coder, memory, data, at.OFF + min(along, 15) * at.UNARY, at.OFF_LOWER, -1, abs(left) - 1
                    )
                    if right:
                        left = -left
                else:
                    left = np.int64(0)
                dy = left if q == 0 else along if q == 1 else -left if q == 2 else -along
                dx = along if q == 0 else -left if q == 1 else -along if q == 2 else left
                two, one, aside, quadrant, turn, last_turn = one, along, left, q, way, r
            edge[STARTS], edge[CLASS], edge[DY], edge[DX] = 1 if i == 0 else 0, label, dy, dx
            run = run + 1 if label == before else 0
            before = label
            area += to_x * (to_y + dy) - to_y * (to_x + dx)
            to_y, to_x = to_y + dy, to_x + dx
            low_h, high_h, low_w, high_w = min(low_h, to_y), max(high_h, to_y), min(low_w, to_x), max(high_w, to_x)
            n += 1
        # Thickness, now that the shape is known: small islands have that of their size.
        island = 1 if area <= 0 else 0
        shape = 1 + min(min(high_h - low_h, high_w - low_w), 7) if island else 0
        has_one = 0
        for k in range(first, n):
            if edges[k, CLASS] == 1:
                edges[k, THICKNESS] = 0
                continue
            same = 0
            if has_one:
                beside = 1 if edges[k - 1, CLASS] != 1 else 0
                context = at.SAME + 2 * island + beside
                same = told(coder, memory, data, context, 1 if edges[k, THICKNESS] == thickness else 0)
            if not same:
                small, node = min(edges[k, THICKNESS], 31), 1
                for b in range(4, -1, -1):
                    node = 2 * node + told(coder, memory, data, at.THICKNESS + 32 * shape + node, small >> b & 1)
                thickness = np.int64(node - 32)
                if thickness == 31:
                    thickness += amount(coder, memory, data, at.LARGE, -1, -1, edges[k, THICKNESS] - 31)
                    if thickness > 255:
                        coder[STATUS] = THICK if coder[STATUS] == GOOD else coder[STATUS]
                        return
            edges[k, THICKNESS] = thickness
            has_one = 1
    counts[0], counts[1] = loops, n


__all__ = ["WRITE", "code_loops"]
