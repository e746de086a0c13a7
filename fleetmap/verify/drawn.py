"""Whether a drawn grid keeps the walls that it was drawn from, so that no robot steps through one.

A *step* leads from a cell that isn't blocked to one of its four neighbours that isn't. Steps that cross no obstacle
edge make regions. A wall is opened where steps across it join two regions, and that is looked at nearby only, since
around the end of a wall, or through a door, they may well be one. What leads nowhere, a dent in a wall that is still
thick enough, joins nothing: so a region counts if it has a cell in free space, or leaves the neighbourhood beyond
what a wall's thickness covers.

Shares no code with what draws; which steps cross which edges is decided in integers.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.lattice import FREE

Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]

NEIGHBOURHOOD = 6
"""Cells on each side of an opening that are looked at."""

MOST = 1000
"""Openings that are told; of a grid with more of them these are enough."""


def find_openings(
    edges: Ints,
    left: Ints,
    right: Ints,
    depth: Ints,
    *,
    cell: int,
    origin_yx: tuple[int, int],
    blocked: Mask,
) -> NDArray[np.float64]:
    """Find where a drawn grid opens a wall.

    Parameters
    ----------
    edges : (n, 4) int64 (y0, x0, y1, x1) in any unit, |coordinate| <= 2^25; the states FREE, OCCUPIED or UNKNOWN
        ``left`` and ``right`` of each (n,) are seen from (y0, x0)
    depth : (n,) how thick the wall behind an obstacle edge is, in that unit; -1 for edges that are no obstacles
    cell : the size of a cell in that unit
    origin_yx : the lower left corner of cell (0, 0) in that unit
    blocked : (height, width) what a robot can't enter; what lies outside of the grid it can, but steps there are not
        looked at

    Returns
    -------
    (k, 2) float64 places (y, x) in that unit: the middles of steps that join what a wall keeps apart, one a place
    """
    inside = np.pad(np.ones(blocked.shape, bool), NEIGHBOURHOOD + 1)
    blocked = np.pad(blocked, NEIGHBOURHOOD + 1)
    height, width = blocked.shape
    corner_yx = np.array(origin_yx, np.int64) - (NEIGHBOURHOOD + 1) * cell
    # Twice the unit, from the corner: so that centres of cells are whole numbers.
    doubled = 2 * (edges.astype(np.int64) - np.tile(corner_yx, 2))
    crossed = np.zeros((2, height, width), bool)  # axis 0: the step to the next row, axis 1: to the next column
    winding = np.zeros((height, width + 1), np.int64)
    for axis, shape in ((0, (height - 1, width)), (1, (height, width - 1))):
        edge, line, at = _crossings(doubled if axis == 1 else doubled[:, [1, 0, 3, 2]], cell, axis)
        if axis == 1:  # rightwards into free space counts 1
            up = np.where(edges[edge, 0] <= edges[edge, 2], 1, -1)
            rows = (line >= 0) & (line < height)
            steps = up * ((right[edge] == FREE).astype(np.int64) - (left[edge] == FREE))
            np.add.at(winding, (line[rows], np.clip(at[rows] + 1, 0, width)), steps[rows])
        row, column = (line, at) if axis == 1 else (at, line)
        seen = (depth[edge] >= 0) & (row >= 0) & (column >= 0) & (row < shape[0]) & (column < shape[1])
        crossed[axis, row[seen], column[seen]] = True
    free = np.cumsum(winding, axis=1)[:, :width] > 0

    looked_at = ~blocked & inside
    open_steps = crossed.copy()
    open_steps[0, :-1] &= looked_at[:-1] & looked_at[1:]
    open_steps[1, :, :-1] &= looked_at[:, :-1] & looked_at[:, 1:]
    walls, depth = doubled[depth >= 0], 2 * np.maximum(depth[depth >= 0], cell)
    places: list[tuple[float, float]] = []
    for axis, i, j in np.argwhere(open_steps).tolist():
        if len(places) == MOST:
            break
        near = (
            slice(i - NEIGHBOURHOOD, i + NEIGHBOURHOOD + 2),
            slice(j - NEIGHBOURHOOD, j + NEIGHBOURHOOD + 2),
        )
        here = (i - near[0].start, j - near[1].start)
        corner = (2 * cell * near[0].start, 2 * cell * near[1].start)
        counts = free[near] | _rim_beyond(walls, depth, 2 * cell, corner, free[near].shape)
        if _joins(~blocked[near], crossed[(slice(None), *near)], counts, here):
            y, x = i + (1.0 if axis == 0 else 0.5), j + (1.0 if axis == 1 else 0.5)
            places.append((y * cell + corner_yx[0], x * cell + corner_yx[1]))
    return np.array(places, np.float64).reshape(-1, 2)


def _crossings(edges: Ints, cell: int, axis: int) -> tuple[Ints, Ints, Ints]:
    """Where edges (v0, u0, v1, u1), doubled, cross the lines of centres at equal v: (edge, line, place) of each.

    ``place`` is the last centre of the line before the edge, which may be outside of the grid. A centre counts as a
    little to the right of where it is, and as far less above it, so that it lies on no edge.
    """
    v0, u0, v1, u1 = edges.T
    low, high = np.minimum(v0, v1), np.maximum(v0, v1)
    # Centres of lines in [low, high): line k is at (2 k + 1) cell.
    first, last = -(-(low - cell) // (2 * cell)), -(-(high - cell) // (2 * cell))
    counts = np.maximum(last - first, 0)
    edge = np.repeat(np.arange(len(edges)), counts)
    line = np.arange(len(edge)) - np.repeat(np.cumsum(counts) - counts, counts) + first[edge]
    dv, du = (v1 - v0)[edge], (u1 - u0)[edge]
    du, dv = np.where(dv < 0, -du, du), np.abs(dv)
    base_v, base_u = np.where(v0 <= v1, v0, v1)[edge], np.where(v0 <= v1, u0, u1)[edge]
    # The edge is at u = base_u + (v - base_v) du / dv; the centres at (2 k + 1) cell.
    over = (base_u - cell) * dv + ((2 * line + 1) * cell - base_v) * du
    before = -(-over // (2 * cell * dv)) - 1
    if axis == 0:  # columns, whose centres lie to the right: where the edge rises, a centre on it is below it
        before = np.where(du > 0, over // (2 * cell * dv), before)
    return edge, line, before


def _rim_beyond(walls: Ints, depth: Ints, cell: int, corner_yx: tuple[int, int], shape: tuple[int, int]) -> Mask:
    """Cells (h, w) on the rim of a window that are farther from all walls than these are thick."""
    rim = np.ones(shape, bool)
    rim[1:-1, 1:-1] = False
    at = np.argwhere(rim)
    points = at * float(cell) + np.array(corner_yx) + cell / 2
    low = np.minimum(walls[:, :2], walls[:, 2:]) - depth[:, None]
    high = np.maximum(walls[:, :2], walls[:, 2:]) + depth[:, None]
    near = ((low <= points.max(axis=0)) & (high >= points.min(axis=0))).all(axis=1)
    start, along = walls[near, None, :2].astype(float), (walls[near, 2:] - walls[near, :2])[:, None].astype(float)
    t = np.clip(((points - start) * along).sum(axis=2) / (along**2).sum(axis=2), 0, 1)
    distance = np.hypot(*np.moveaxis(points - start - t[..., None] * along, -1, 0))
    covered = (distance <= depth[near, None]).any(axis=0)
    rim[tuple(at[covered].T)] = False
    return rim


def _joins(enterable: Mask, crossed: Mask, counts: Mask, here: tuple[int, int]) -> bool:
    """Whether steps join, from ``here``, two regions that count and that no uncrossed steps join; all (h, w)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    height, width = enterable.shape
    number = np.arange(height * width).reshape(height, width)
    pairs, plain = [], []
    for axis, a, b in (
        (0, np.s_[:-1, :], np.s_[1:, :]),
        (1, np.s_[:, :-1], np.s_[:, 1:]),
    ):
        both = enterable[a] & enterable[b]
        pairs.append(np.stack([number[a][both], number[b][both]]))
        plain.append(~crossed[axis][a][both])

    def components(steps: Ints) -> NDArray[np.int32]:
        graph = coo_array((np.ones(steps.shape[1], np.int8), tuple(steps)), shape=(number.size, number.size))
        return np.asarray(connected_components(graph, directed=False)[1])

    steps = np.concatenate(pairs, axis=1)
    joined, regions = components(steps), components(steps[:, np.concatenate(plain)])
    reached = (enterable & counts).ravel() & (joined == joined[number[here]])
    return len(np.unique(regions[reached])) > 1
