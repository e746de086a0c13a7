"""Numba kernels of ``model.seal``. Integers only; each states why 64 bits suffice."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.kernel import kernel

T_BITS = 10
"""Places on a step from one cell centre to the next are counted in 2^-10 of it."""


@kernel("i8(i8[:,::1], i8, i8, i8, u1[:,::1], i8[:,::1])")
def list_open_steps(
    edges: NDArray[np.int64],
    cell: int,
    low_y: int,
    low_x: int,
    blocked: NDArray[np.uint8],
    found: NDArray[np.int64],
) -> int:
    """List the steps between the centres of unblocked 4-neighbours that cross an edge; returns how many there are.

    ``edges`` are (y0, x0, y1, x1) in half units, in which a cell is ``cell`` wide and its centre an integer. A row of
    ``found`` is (row, column, axis, t): from that cell to the next row (axis 0) or column (axis 1), crossed at the
    fraction t / 2^10. What doesn't fit in ``found`` is counted only. Centres lie an epsilon to the right, and far less
    than that upwards, of where they are: so none is on an edge, and a path of steps can't slip through a vertex.
    |coordinate| <= 2^27 (a vector map's, in 1/32 of a cell, are within 2^25; a merged map's, in 0.25 mm, within
    2^26.4), so that products of two differences stay below 2^56. A cell is less than 2^23 half units: 2^10 of a step,
    times its divisor, is below 2^61.
    """
    height, width = blocked.shape
    half = cell // 2
    count = 0
    for k in range(len(edges)):
        for axis in range(2):
            # u runs along the rows or columns whose steps are crossed, v along the steps: axis 0 steps in y.
            v0, u0, v1, u1 = edges[k, 0], edges[k, 1], edges[k, 2], edges[k, 3]
            low_u, low_v, lines, cells = low_x, low_y, width, height
            if axis == 1:
                v0, u0, v1, u1 = u0, v0, u1, v1
                low_u, low_v, lines, cells = low_y, low_x, height, width
            if u0 > u1:
                v0, u0, v1, u1 = v1, u1, v0, u0
            du, dv = u1 - u0, v1 - v0
            if du == 0:
                continue
            # Centres in [u0, u1).
            first = max(-((half - u0) // cell) - low_u, 0)
            end = min(-((half - u1) // cell) - low_u, lines)
            for line in range(first, end):
                u = (low_u + line) * cell + half
                # The edge's height over the first centre of the line, times du.
                over = (v0 - low_v * cell - half) * du + (u - u0) * dv
                # On the edge itself a centre is before it only if it rises there (axis 0: the epsilon to the right).
                if axis == 0 and dv > 0:
                    at = over // (cell * du)
                else:
                    at = -(-over // (cell * du)) - 1
                if at < 0 or at + 1 >= cells:
                    continue
                if axis == 0:
                    row, column = at, line
                    open_step = blocked[row, column] == 0 and blocked[row + 1, column] == 0
                else:
                    row, column = line, at
                    open_step = blocked[row, column] == 0 and blocked[row, column + 1] == 0
                if open_step:
                    if count < len(found):
                        found[count, 0], found[count, 1], found[count, 2] = row, column, axis
                        found[count, 3] = ((over - at * cell * du) << T_BITS) // (cell * du)
                    count += 1
    return count


@kernel("b1(u1[:,::1], i8, i8, b1)")
def _is_blocked(blocked: NDArray[np.uint8], v: int, u: int, steep: bool) -> bool:
    """Whether cell v of line u is blocked; outside of the grid nothing is."""
    row, column = (u, v) if steep else (v, u)
    if row < 0 or column < 0 or row >= blocked.shape[0] or column >= blocked.shape[1]:
        return False
    return bool(blocked[row, column] != 0)


@kernel("i8(i8[:,::1], i8[::1], i8, i8, i8, u1[:,::1])")
def block_passed_cells(
    edges: NDArray[np.int64],
    sides: NDArray[np.int64],
    cell: int,
    low_y: int,
    low_x: int,
    blocked: NDArray[np.uint8],
) -> int:
    """Block what each edge passes through, unless the next cell on its blocking side is; returns how many were not.

    ``sides`` holds bits 1 (left blocks) and 2 (right blocks); an edge that blocks on both sides blocks each cell that
    it passes through. An edge along the border of cells passes through those on its blocking side (any, if both are).
    Units and bounds are those of ``list_open_steps``.
    """
    height, width = blocked.shape
    count = 0
    for k in range(len(edges)):
        dy, dx = edges[k, 2] - edges[k, 0], edges[k, 3] - edges[k, 1]
        steep = abs(dy) > abs(dx)
        # u along the longer axis, so that in each line of cells the edge passes through two at most.
        v0, u0, v1, u1 = edges[k, 0], edges[k, 1], edges[k, 2], edges[k, 3]
        low_u, low_v, lines, cells = low_x, low_y, width, height
        if steep:
            v0, u0, v1, u1 = u0, v0, u1, v1
            low_u, low_v, lines, cells = low_y, low_x, height, width
        if u0 > u1:
            v0, u0, v1, u1 = v1, u1, v0, u0
        du, dv = u1 - u0, v1 - v0
        if du == 0:
            continue
        # Where the blocking side is, along v: left of the edge is up, for an edge that goes right.
        toward = 0
        if sides[k] != 3:
            left_is_up = (edges[k, 3] > edges[k, 1]) if not steep else (edges[k, 2] < edges[k, 0])
            toward = 1 if left_is_up == (sides[k] == 1) else -1
        diagonal = abs(dv) == du
        across = 0
        if diagonal:  # "next" is then either of two neighbours
            across = -toward if dv > 0 else toward
        first = max(u0 // cell - low_u, 0)
        end = min(-(-u1 // cell) - low_u, lines)
        for line in range(first, end):
            a = max(u0, (low_u + line) * cell)
            b = min(u1, (low_u + line + 1) * cell)
            # Heights where the edge enters and leaves the line, times du, over the first cell's lower border.
            enter = (v0 - low_v * cell) * du + (a - u0) * dv
            leave = (v0 - low_v * cell) * du + (b - u0) * dv
            low, high = min(enter, leave), max(enter, leave)
            lowest = low // (cell * du)
            highest = -(-high // (cell * du)) - 1
            if dv == 0 and low % (cell * du) == 0:  # along a border
                highest = lowest
                if toward < 0:
                    lowest = highest = lowest - 1
                elif toward == 0:
                    if _is_blocked(blocked, lowest - 1, line, steep):
                        continue
            for at in range(max(lowest, 0), min(highest + 1, cells)):
                if _is_blocked(blocked, at, line, steep):
                    continue
                if toward != 0 and _is_blocked(blocked, at + toward, line, steep):
                    continue
                if across != 0 and _is_blocked(blocked, at, line + across, steep):
                    continue
                if steep:
                    blocked[line, at] = 1
                else:
                    blocked[at, line] = 1
                count += 1
    return count
