"""Mazes: a spanning tree of square chambers, with some loops."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.sims.worlds import CELL_M

WALL = 3
"""Thickness of a wall in cells (0.15 m)."""

PITCH_M = 3.3
"""Distance between the middles of two corridors, about."""

LOOPS = 0.08
"""Share of the remaining inner walls that are taken out again: a building has few dead ends only."""


def generate(size_m: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Grow a tree by depth-first search over the chambers, taking out the wall at each step; then the loops."""
    side = round(size_m / CELL_M)
    chambers = max(3, round(size_m / PITCH_M))
    lines = np.linspace(0, side - WALL, chambers + 1).round().astype(int)  # where walls begin, both ways
    solid = np.zeros((side, side), bool)
    for line in lines:
        solid[line : line + WALL] = True
        solid[:, line : line + WALL] = True

    def open_between(a: tuple[int, int], b: tuple[int, int]) -> None:
        (i, j), (k, m) = min(a, b), max(a, b)
        if i == k:
            solid[lines[i] + WALL : lines[i + 1], lines[m] : lines[m] + WALL] = False
        else:
            solid[lines[k] : lines[k] + WALL, lines[j] + WALL : lines[j + 1]] = False

    stack = [(int(rng.integers(chambers)), int(rng.integers(chambers)))]
    seen = {stack[0]}
    while stack:
        i, j = stack[-1]
        around = [(i + 1, j), (i - 1, j), (i, j + 1), (i, j - 1)]
        fresh = [c for c in around if c not in seen and min(c) >= 0 and max(c) < chambers]
        if not fresh:
            stack.pop()
            continue
        chosen = fresh[int(rng.integers(len(fresh)))]
        open_between((i, j), chosen)
        seen.add(chosen)
        stack.append(chosen)
    for i in range(chambers):
        for j in range(chambers):
            for other in ((i + 1, j), (i, j + 1)):
                if max(other) < chambers and rng.random() < LOOPS:
                    open_between((i, j), other)
    return solid
