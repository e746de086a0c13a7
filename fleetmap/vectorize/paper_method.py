"""The paper's own way from a grid to a vector map, to be run and compared with ``vectorize``.

Baizid, Lozenguez, Fabresse, Bouraqadi: "Vector Maps: A Lightweight and Accurate Map Format for Multi-robot
Systems", ICIRA 2016. A vector map <V, E> is asked to keep two constraints: every occupied cell's centre lies
within epsilon of an edge, and every point of an edge within epsilon of an occupied cell's centre. The paper starts
from the complete graph of the centres at most epsilon = sqrt(2) cells apart, and shortens it greedily.
``docs/paper_method.md`` says what comes of it, and how the three readings differ.
"""

from __future__ import annotations

import math
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.checks import check_type
from fleetmap.model.errors import ConfigError
from fleetmap.model.graded import warn_of_thresholds
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import EPSILON_CELLS, FREE, OCCUPIED, Lattice
from fleetmap.model.pose import FixedPose, Pose2
from fleetmap.model.vectormap import OBSTACLE_LABELS, THICKNESS_PER_CELL, VectorMap

Reading = Literal["B", "C", "mended"]
Cells = Literal["occupied", "surface"]

MIN_EPSILON_CELLS, MAX_EPSILON_CELLS = 1.0, 4.0
"""Below 1 the graph has no edge; at 4 a vertex has 48 neighbours, and the integers of the kernels end."""

THICKNESS = THICKNESS_PER_CELL // 2
"""An edge runs through the middle of its cells: the wall behind it is known to be half a cell deep."""


def vectorize_by_paper(
    grid: OccupancyGrid,
    *,
    reading: Reading = "C",
    epsilon_cells: float = EPSILON_CELLS,
    cells: Cells | None = None,
) -> VectorMap:
    """Vectorize a grid by the paper's greedy.

    Where a vertex v2 has edges (v1, v2) and (v2, v3), and lies within epsilon of the segment from v1 to v3, these
    edges are replaced by (v1, v3), until nothing changes. Vertices take turns in row-major order; of a vertex's
    pairs of neighbours, in the same order, the first that allows it is taken.

    Parameters
    ----------
    reading : what becomes of v2 if it has more edges.

        * ``B``: it is deleted, with all its edges.
        * ``C``: it stays as long as it has edges.
        * ``mended``: as C, and the new edge must keep the constraints: it stands for all that both edges stood
          for, and for v2 once that is gone; all this lies within epsilon of it, and all of it within epsilon of
          the cells' centres. A cell without neighbours becomes an edge of one cell to the right of its centre.
    epsilon_cells : error bound, 1 to 4 cells; its square is rounded down to sixteenths
    cells : the vertices of the graph: all ``occupied`` cells, as in the paper (the default of B and C), or only
        the ``surface``, those that touch a free cell by a side or corner (the default of mended: an edge inside a
        thick wall delimits nothing)

    Returns
    -------
    VectorMap : its vertices are cell centres, so that its lattice is the grid's own moved by half a cell. All
        edges are obstacles, free on the side that has more free cells right beside the edge, and on the left
        (from the lower end) if there are as many on both. They may cross, and most walls are one edge, with
        free space on both sides in truth.

    Raises
    ------
    ConfigError : an unknown reading or kind of cells, or epsilon out of its range
    MapFormatError : the grid is larger than a lattice

    Examples
    --------
    >>> import numpy as np
    >>> from fleetmap.model.grid import OccupancyGrid
    >>> wall = np.zeros((9, 20), np.int8)
    >>> wall[4, 2:18] = 100
    >>> vectorize_by_paper(OccupancyGrid(wall, 0.05)).edges.tolist()
    [[4, 2, 4, 17, 1]]
    """
    for option, value, choices in (("reading", reading, get_args(Reading)), ("cells", cells, get_args(Cells))):
        if value not in choices and not (option == "cells" and value is None):
            raise ConfigError(option=option, value=value, reason=f"expected one of {', '.join(choices)}")
    if not MIN_EPSILON_CELLS <= epsilon_cells <= MAX_EPSILON_CELLS:
        raise ConfigError(
            option="epsilon_cells",
            value=epsilon_cells,
            reason=f"expected {MIN_EPSILON_CELLS:g} to {MAX_EPSILON_CELLS:g} cells for the paper's method",
        )
    check_type("grid", grid, OccupancyGrid)
    warn_of_thresholds(grid)
    from fleetmap.vectorize import paper_kernels

    # 1. The vertices: centres of occupied cells, in row-major order.
    states = grid.states_yx()
    chosen = states == OCCUPIED
    if (cells or ("surface" if reading == "mended" else "occupied")) == "surface":
        chosen &= _touches(states == FREE)
    points = np.ascontiguousarray(np.argwhere(chosen), np.int64)
    vertex_of = np.full(states.shape, -1, np.int32)
    vertex_of[chosen] = np.arange(len(points))

    # 2. The complete graph of all that are at most epsilon apart.
    epsilon2 = math.floor(16 * epsilon_cells**2 + 1e-6)
    start, neighbour = paper_kernels.link_cells(vertex_of, points, _offsets(epsilon2))
    alone = np.flatnonzero(np.diff(start) == 0)

    # 3. The greedy.
    code = {"B": paper_kernels.READING_B, "C": paper_kernels.READING_C, "mended": paper_kernels.MENDED}[reading]
    pairs = paper_kernels.shorten(points, start, neighbour, chosen.view(np.uint8), epsilon2, code)
    ends = points[pairs].reshape(-1, 4)

    # 4. A vector map holds edges alone. B and C lose the cells that have none; mended may not.
    if reading == "mended":
        ends = np.concatenate([ends, np.hstack([points[alone], points[alone] + [0, 1]])])

    # 5. Labels: which side is free. Vertices are numbered from the lowest row up, so that lower ends come first.
    left, right = _free_beside(states, ends)
    labels = np.where(left >= right, *OBSTACLE_LABELS)
    edges = np.column_stack([ends, labels]).astype(np.int32)
    half_m = grid.resolution_m / 2
    lattice = Lattice(round(grid.resolution_m * 1e6), FixedPose.from_pose(grid.origin @ Pose2(half_m, half_m)))
    return VectorMap(lattice, edges, np.full(len(edges), THICKNESS, np.uint8), epsilon_cells)


def _touches(free: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which cells touch a free one by a side or corner, or are free themselves."""
    padded = np.pad(free, 1)
    rows = padded[:-2] | padded[1:-1] | padded[2:]
    touches: NDArray[np.bool_] = rows[:, :-2] | rows[:, 1:-1] | rows[:, 2:]
    return touches


def _offsets(epsilon2: int) -> NDArray[np.int64]:
    """The steps (dy, dx) to all neighbours, (n, 2) in row-major order; ``epsilon2`` in sixteenths."""
    reach = math.isqrt(epsilon2 // 16)
    dy, dx = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1)
    near = (16 * (dy * dy + dx * dx) <= epsilon2) & ((dy != 0) | (dx != 0))
    return np.ascontiguousarray(np.column_stack([dy, dx])[near], np.int64)


def _free_beside(states: NDArray[np.uint8], ends: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Count the free cells right beside each edge, on its left and on its right.

    An edge passes each row, or each column if it is flatter than a diagonal, in one cell (its lower or left one
    if it passes between two); the cells before and after that one are beside it.
    """
    y0, x0, y1, x1 = ends.T
    flat = np.abs(x1 - x0) > y1 - y0
    steps = np.where(flat, np.abs(x1 - x0), y1 - y0)
    edge = np.repeat(np.arange(len(ends)), steps + 1)
    step = np.arange(len(edge)) - np.repeat(np.cumsum(steps + 1) - (steps + 1), steps + 1)
    # The nearest cell, and of two the lower or left one: rounded up from half a cell less.
    rise = np.where(flat, y1 - y0, x1 - x0)[edge] * step
    across = (2 * rise + steps[edge] - 1) // (2 * steps[edge])
    y = np.where(flat[edge], y0[edge] + across, y0[edge] + step)
    x = np.where(flat[edge], x0[edge] + np.sign(x1 - x0)[edge] * step, x0[edge] + across)
    padded = np.pad(states == FREE, 2)
    counts = []
    for side in (1, -1):
        free = padded[y + 2 + np.where(flat[edge], side, 0), x + 2 + np.where(flat[edge], 0, side)]
        counts.append(np.bincount(edge[free], minlength=len(ends)))
    above, below = counts
    # Seen from the lower end, above is left if the edge goes right; a steep edge goes up, its left is at x - 1.
    left_is_above = flat & (x1 > x0)
    return np.where(left_is_above, above, below), np.where(left_is_above, below, above)
