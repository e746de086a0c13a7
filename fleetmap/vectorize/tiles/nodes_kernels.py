"""Kernels that say where the vertex of each node lies: on its point of boundary, or where one lay before.

A node on a tile's border may lie one point beside the boundary, along the border, where it lay before: then noise of a
cell moves no edge. Both tiles decide it alike, by the cracks around it and by where nodes were before; and no edge of
either can be in the way, as between the node's point, its place and the next point of boundary lies half a cell.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fleetmap.model.kernel import kernel
from fleetmap.model.kernel_types import Bytes, Image, Points, Rows
from fleetmap.vectorize.tiles.boundary_kernels import Boundary


class Rules(NamedTuple):
    """What edges must hold, in sixteenths of a cell.

    The true boundary lies (phase_y, phase_x) off its points, and within epsilon (squared here) of the edges; new ones
    are chosen within ``choose2``. ``share`` is the profile.
    """

    phase_y: int
    phase_x: int
    epsilon2: int
    choose2: int
    share: bool


@kernel
def distance2(rules: Rules, py: int, px: int, y: int, x: int) -> int:
    """Squared distance of a point of boundary, at its true place, from a lattice point; sixteenths."""
    dy, dx = 16 * (py - y) + rules.phase_y, 16 * (px - x) + rules.phase_x
    return dy * dy + dx * dx


@kernel
def may_move(cracks: Image, was: Bytes, y: int, x: int, size: int) -> bool:
    """Whether the node at a point of a border may lie beside it: two cracks meet there, and no node lay there."""
    level = y in (0, size)
    along = x if level else y
    if along < 1 or along > size - 1 or was[along + 1]:
        return False
    bits = cracks[y + 1, x + 1] & 15
    lower = 8 if level else 4  # the crack of the tile that doesn't own the border
    return bits & lower != 0 and bits in (3, 5, 6, 9, 10, 12)


@kernel
def place_on_border(cracks: Image, was: Bytes, rules: Rules, y: int, x: int, size: int) -> tuple[int, int]:
    """Where the node at a point of a border lies.

    ``was`` (size + 3,) tells along that border, from -1 on, where nodes were before. An old node is for the one behind
    it, if that may move there, else for the one before it.
    """
    if not may_move(cracks, was, y, x, size):
        return y, x
    dy, dx = (0, 1) if y in (0, size) else (1, 0)
    along = x if dx else y
    for step in (-1, 1):
        there = along + step
        cy, cx = y + step * dy, x + step * dx
        if there < 1 or there > size - 1 or not was[there + 1] or cracks[cy + 1, cx + 1] & 15:
            continue
        if distance2(rules, y, x, cy, cx) > rules.epsilon2:
            continue
        if step == 1:
            oy, ox = cy + dy, cx + dx
            if (
                there < size - 1
                and may_move(cracks, was, oy, ox, size)
                and distance2(rules, oy, ox, cy, cx) <= rules.epsilon2
            ):
                continue
        return cy, cx
    return y, x


@kernel
def list_borders(old_nodes: Points, size: int) -> Image:
    """(4, size + 3): where nodes were on the lower, upper, left and right border, from -1 to size + 1."""
    was = np.zeros((4, size + 3), np.uint8)
    for k in range(len(old_nodes)):
        y, x = old_nodes[k, 0], old_nodes[k, 1]
        if -1 <= x <= size + 1 and (y in (0, size)):
            was[0 if y == 0 else 1, x + 1] = 1
        if -1 <= y <= size + 1 and (x in (0, size)):
            was[2 if x == 0 else 3, y + 1] = 1
    return was


@kernel
def is_at_border(y: int, x: int, size: int) -> bool:
    """Whether a point lies on the border of its tile."""
    return y in (0, size) or x in (0, size)


@kernel
def is_node(boundary: Boundary, y: int, x: int, size: int) -> bool:
    """Whether a crack of another tile ends at a point."""
    bits = boundary.cracks[y + 1, x + 1]
    others = (bits & 8 if y == 0 else 0) | (bits & 4 if x == 0 else 0)
    return others != 0 or y == size or x == size


@kernel
def pair_junctions(points: Points, old: Points, rules: Rules) -> Rows:
    """(k, 4): which points (y, x) get the places of old ones (y, x) that aren't theirs; nearest pairs first."""
    reach = int(np.sqrt(float(rules.epsilon2))) // 16 + 1
    pairs = np.empty((16, 5), np.int64)
    count = 0
    for i in range(len(points)):
        for j in range(len(old)):
            dy, dx = np.int64(old[j, 0]) - points[i, 0], np.int64(old[j, 1]) - points[i, 1]
            if abs(dy) > reach or abs(dx) > reach:
                continue
            if distance2(rules, points[i, 0], points[i, 1], old[j, 0], old[j, 1]) > rules.epsilon2 and (dy or dx):
                continue
            if count == len(pairs):
                pairs = np.concatenate((pairs, pairs))
            pairs[count, 0] = dy * dy + dx * dx
            pairs[count, 1], pairs[count, 2] = points[i, 0], points[i, 1]
            pairs[count, 3], pairs[count, 4] = old[j, 0], old[j, 1]
            count += 1
    # By distance, then place: a tile has at most 1024 cells each way.
    keys = np.empty(count, np.int64)
    for k in range(count):
        keys[k] = pairs[k, 0]
        for column in range(1, 5):
            keys[k] = (keys[k] << 11) + pairs[k, column]
    found = np.empty((count, 4), np.int64)
    used = 0
    for k in np.argsort(keys):
        taken = False
        for n in range(used):
            same = found[n, 0] == pairs[k, 1] and found[n, 1] == pairs[k, 2]
            taken = taken or same or (found[n, 2] == pairs[k, 3] and found[n, 3] == pairs[k, 4])
        if not taken:
            found[used] = pairs[k, 1:]
            used += 1
    return found[:used]


@kernel
def place_nodes(boundary: Boundary, old_nodes: Points, old_junctions: Points, rules: Rules, size: int) -> Points:
    """(arcs, 4): where the first and the last vertex of each open arc lie, (y, x) each.

    Parameters
    ----------
    old_nodes : where nodes were before on the borders of the tile, of all tiles
    old_junctions : where three states met before within the tile; the nearest pairs of old and new ones belong together
    """
    was = list_borders(old_nodes, size)
    arcs = len(boundary.labels)
    places = np.empty((arcs, 4), np.int32)
    inner = np.empty((2 * arcs, 2), np.int32)
    count = 0
    for arc in range(arcs):
        for side in range(2):
            m = boundary.offsets[arc + 1] - 1 if side else boundary.offsets[arc]
            y, x = np.int64(boundary.points[m, 0]), np.int64(boundary.points[m, 1])
            if not boundary.closed[arc]:
                if not is_at_border(y, x, size):
                    inner[count, 0], inner[count, 1] = y, x
                    count += 1
                elif (y in (0, size)) != (x in (0, size)):
                    border = (0 if y == 0 else 1) if y in (0, size) else (2 if x == 0 else 3)
                    y, x = place_on_border(boundary.cracks, was[border], rules, y, x, size)
            places[arc, 2 * side], places[arc, 2 * side + 1] = y, x
    moved = pair_junctions(inner[:count], old_junctions, rules)
    for arc in range(arcs):
        for side in range(2):
            for k in range(len(moved)):
                if not boundary.closed[arc] and (
                    places[arc, 2 * side] == moved[k, 0] and places[arc, 2 * side + 1] == moved[k, 1]
                ):
                    places[arc, 2 * side], places[arc, 2 * side + 1] = moved[k, 2], moved[k, 3]
                    break
    return places
