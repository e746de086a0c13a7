"""Offices: corridors, rooms on both sides with doors, desks along the walls."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.sims.worlds import CELL_M

WALL = 3
"""Thickness of a wall in cells (0.15 m)."""

CORRIDOR_M = (1.8, 2.4)
ROOM_DEPTH_M = 5.5
ROOM_WIDTH_M = (3.0, 6.5)
DOOR_M = (0.95, 1.3)
SIDE_DOOR = 0.25
"""Chance of a door between two neighbouring rooms."""
DESK_M = (0.7, 1.4)


def generate(size_m: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Parallel corridors with a row of rooms on each side, joined by one or two cross corridors."""
    side = round(size_m / CELL_M)
    solid = np.zeros((side, side), bool)
    frame(solid)
    crossings = cross_corridors(side, rng)
    # Bands of room, corridor, room: as many as fit.
    bands = max(1, round(side / cells(2 * ROOM_DEPTH_M + 2.0)))
    edges = np.linspace(0, side - WALL, bands + 1).round().astype(int)
    for low, high in zip(edges[:-1], edges[1:], strict=True):
        middle, half = (low + high + WALL) // 2, cells(rng.uniform(*CORRIDOR_M)) // 2
        rows = [(low, middle - half - WALL, True), (middle + half, high, False)]  # outer walls' first rows
        for bottom, top, door_above in rows:
            columns = [0, *(c for crossing in crossings for c in crossing), side - WALL]
            for left, right in zip(columns[::2], columns[1::2], strict=True):
                if top - bottom >= cells(1.5) and right - left >= cells(1.5):
                    room_row(solid, bottom, top, left, right, door_above=door_above, rng=rng)
    return solid


def cells(metres: float) -> int:
    """Metres in whole cells."""
    return round(metres / CELL_M)


def frame(solid: NDArray[np.bool_]) -> None:
    """Close the world by an outer wall."""
    solid[:WALL] = solid[-WALL:] = True
    solid[:, :WALL] = solid[:, -WALL:] = True


def cross_corridors(side: int, rng: np.random.Generator) -> list[tuple[int, int]]:
    """Where the cross corridors begin and end: each pair holds the walls' first columns beside one."""
    count = 1 if side < cells(30) else 2
    found = []
    for k in range(count):
        middle = int(side * (k + 1) / (count + 1) + cells(rng.uniform(-1.5, 1.5)))
        half = cells(rng.uniform(*CORRIDOR_M)) // 2
        found.append((middle - half - WALL, middle + half))
    return found


def room_row(
    solid: NDArray[np.bool_],
    bottom: int,
    top: int,
    left: int,
    right: int,
    *,
    door_above: bool,
    rng: np.random.Generator,
) -> None:
    """Rooms side by side between the walls that begin at rows ``bottom``, ``top`` and columns ``left``, ``right``."""
    solid[bottom : bottom + WALL, left : right + WALL] = True
    solid[top : top + WALL, left : right + WALL] = True
    walls = [left]
    while right - walls[-1] > cells(ROOM_WIDTH_M[1]):
        widest = min(cells(ROOM_WIDTH_M[1]), right - walls[-1] - cells(ROOM_WIDTH_M[0]))
        walls.append(walls[-1] + int(rng.integers(min(cells(ROOM_WIDTH_M[0]), widest), widest + 1)))
    walls.append(right)
    for wall in walls:
        solid[bottom : top + WALL, wall : wall + WALL] = True
    door_row = top if door_above else bottom
    for k, (a, b) in enumerate(zip(walls[:-1], walls[1:], strict=True)):
        inner_left, inner_right = a + WALL, b
        width = min(cells(rng.uniform(*DOOR_M)), inner_right - inner_left - 2)
        door = int(rng.integers(inner_left + 1, inner_right - width))
        solid[door_row : door_row + WALL, door : door + width] = False
        desks(solid, bottom + WALL, top, inner_left, inner_right, door_above=door_above, rng=rng)
        if k and rng.random() < SIDE_DOOR:
            middle = (bottom + WALL + top) // 2
            solid[middle - cells(0.5) : middle + cells(0.5), a : a + WALL] = False


def desks(
    solid: NDArray[np.bool_],
    bottom: int,
    top: int,
    left: int,
    right: int,
    *,
    door_above: bool,
    rng: np.random.Generator,
) -> None:
    """Up to three desks along the wall that faces the door: flush with it, so that nothing is cut off."""
    deep, wide = cells(DESK_M[0]), cells(DESK_M[1])
    if top - bottom < deep + cells(2.2):
        return
    row = bottom if door_above else top - deep
    column = left
    for _ in range(int(rng.integers(0, 4))):
        # Either flush with the last one or with a gap that a robot could turn in.
        column += int(rng.choice([0, cells(1.2)]))
        if column + wide > right - cells(1.0):
            return
        solid[row : row + deep, column : column + wide] = True
        column += wide
