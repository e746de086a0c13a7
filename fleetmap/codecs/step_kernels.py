"""Numba kernels of modes 1 and 2: a step of a walk by its turn against the step before, its length and its slant.

Walls run straight on, turn at right angles, and turn back at their ends; told in the frame of the step before, all
walls look alike, whichever way they run.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.codecs.contexts import ALONG, GROUP, LOWER, OFF, OFF_LOWER, SLANT, STEP, TURNS, UNARY
from fleetmap.codecs.range_kernels import amount, length_of, told
from fleetmap.model.kernel import kernel

QUADRANT, ONE, TWO, ASIDE, TURN, LAST_TURN, FIELDS = range(7)
"""What a walk remembers: the quadrant of its last step; how far along that one and the one before went; how far to the
left the last one went; its turn, 0 on, 1 left, 2 else, 3 none yet; and that turn in quadrants."""


@kernel("Tuple((i8, i8, i8))(i8, i8)")
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


@kernel("void(i8[::1], i8, i8)")
def look_back(walk: NDArray[np.int64], dy: int, dx: int) -> None:
    """A walk begins, as if (dy, dx) had been the step before; (0, 0): it looks back to nothing."""
    walk[:] = 0
    walk[QUADRANT], walk[ONE], walk[ASIDE] = in_frame(dy, dx)
    walk[TURN] = 3


@kernel("Tuple((i8, i8))(i8[::1], i8[::1], u1[::1], i8, i8, i8[::1], i8, i8, i8)")
def code_step(
    coder: NDArray[np.int64],
    memory: NDArray[np.int64],
    data: NDArray[np.uint8],
    context: int,
    group: int,
    walk: NDArray[np.int64],
    expected: int,
    dy: int,
    dx: int,
) -> tuple[int, int]:
    """A step, never to nowhere, in the contexts of a group from ``context`` on; ``walk`` remembers it.

    ``expected`` is how far along it may well go; 0 unless something is known.
    """
    at = context + STEP + group * GROUP
    q, along, left = in_frame(dy, dx)
    r = (q - walk[QUADRANT]) & 3
    one_bits = min(length_of(walk[ONE]), 5)
    turns = at + TURNS + 3 * ((one_bits * 5 + min(length_of(walk[TWO]), 4)) * 4 + walk[TURN])
    low = told(coder, memory, data, turns, r & 1)
    r = 2 * told(coder, memory, data, turns + 1 + low, r >> 1) + low
    way = min(r, 2)
    # A side across from an equal one.
    if walk[TWO] > 0 and (r + walk[LAST_TURN]) & 1 == 0:
        expected = walk[TWO]
    along = 1 + amount(
        coder, memory, data, at + ALONG + (way * 6 + one_bits) * UNARY, at + LOWER, expected - 1, along - 1
    )
    sign = 1 + (1 if walk[ASIDE] > 0 else -1 if walk[ASIDE] < 0 else 0)
    slant = at + SLANT + 2 * ((min(length_of(along), 6) * 4 + r) * 3 + sign)
    if told(coder, memory, data, slant, 1 if left != 0 else 0):
        right = 0
        if along > 1:
            right = told(coder, memory, data, slant + 1, 1 if left < 0 else 0)
        off = context + OFF + min(along, 15) * UNARY
        left = 1 + amount(coder, memory, data, off, context + OFF_LOWER, -1, abs(left) - 1)
        if right:
            left = -left
    else:
        left = np.int64(0)
    q = (walk[QUADRANT] + r) & 3
    walk[TWO], walk[ONE], walk[ASIDE], walk[QUADRANT] = walk[ONE], along, left, q
    walk[TURN], walk[LAST_TURN] = way, r
    dy = left if q == 0 else along if q == 1 else -left if q == 2 else -along
    dx = along if q == 0 else -left if q == 1 else -along if q == 2 else left
    return dy, dx
