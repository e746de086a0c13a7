"""The compiled inverse sensor model: one scan into a grid of log-odds."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.kernel import kernel

CLAMP = 200
"""Most votes that a cell remembers either way: what changes in the world shows after a hundred near scans."""

DECIDED = 2
"""Votes from which on an unknown cell is free or occupied."""

REVISED = 12
"""Votes for the other state that a decided cell needs to change: with 2, noise makes the deltas 9 % larger."""


@kernel(
    "void(int16[:,::1], uint8[:,::1], float64, float64, float64, float64[::1], float64, float64, float64)",
)
def integrate(
    votes: NDArray[np.int16],
    states: NDArray[np.uint8],
    x: float,
    y: float,
    yaw: float,
    ranges: NDArray[np.float64],
    reach: float,
    depth: float,
    near: float,
) -> None:
    """Let every cell in reach vote by the beam that passes nearest to its centre.

    (x, y) and the lengths are in cells of the grid. A centre nearer than the return votes free; one at most
    ``depth`` behind it votes occupied; so the border between the two lies on the measured surface, on neither
    side of it. Looking up cells instead of drawing beams leaves no combs between far beams. A vote counts
    3 up to ``near`` cells, 2 up to twice that, then 1: the gap between beams grows with the distance. The
    state of a cell changes late, so that one on the surface doesn't flicker.
    """
    height, width = votes.shape
    count = ranges.shape[0]
    per_beam = count / (2.0 * math.pi)
    farthest = min(ranges.max() + depth, reach)
    for i in range(max(int(y - farthest), 0), min(int(y + farthest) + 1, height)):
        dy = i + 0.5 - y
        for j in range(max(int(x - farthest), 0), min(int(x + farthest) + 1, width)):
            dx = j + 0.5 - x
            d2 = dx * dx + dy * dy
            if d2 >= farthest * farthest:
                continue
            beam = int(math.floor((math.atan2(dy, dx) - yaw) * per_beam + 0.5)) % count
            d = math.sqrt(d2)
            z = ranges[beam]
            weight = 3 if d < near else (2 if d < 2.0 * near else 1)
            if d < z:
                vote = max(int(votes[i, j]) - weight, -CLAMP)
            elif z < reach and d < z + depth:
                vote = min(int(votes[i, j]) + weight, CLAMP)
            else:
                continue
            votes[i, j] = np.int16(vote)
            if vote <= -(REVISED if states[i, j] == 1 else DECIDED):
                states[i, j] = 0
            elif vote >= (REVISED if states[i, j] == 0 else DECIDED):
                states[i, j] = 1
