"""No drawn wall has a hole: what is painted after all cells have got the state of their centres.

Where the two surfaces of a thin wall run together, or one of them meets the frontier behind it, no centre of a cell
may lie between them, and a planner on the grid would drive through. So, for each obstacle edge:

1. Of two neighbouring cells, one is blocked if the edge passes between their centres. Then no 4-connected path of cells
   that aren't blocked crosses an obstacle edge, but where it ends.
2. Of each cell that the edge passes through, that cell is blocked or the next one on its not free side; if both of its
   sides block, the cell.

What is painted here contains a point of the wall, so that each side of a gap loses sqrt(2) cells at most.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def seal_walls(
    edges: NDArray[np.int64],
    sides: NDArray[np.int64],
    cell: int,
    low_yx: tuple[int, int],
    blocked: NDArray[np.uint8],
) -> None:
    """Block, in place, what the two rules above ask for.

    Parameters
    ----------
    edges : (n, 4) int64 obstacle edges (y0, x0, y1, x1), in units of which a cell has an even number, ``cell``
    sides : (n,) on which sides each edge blocks: 1 left, 2 right, 3 both, seen from (y0, x0)
    low_yx : cell (0, 0) has its lower left corner at ``cell * low_yx``
    blocked : (height, width) uint8, not 0 where a cell is blocked already
    """
    from fleetmap.model.seal_kernels import T_BITS, block_passed_cells, list_open_steps

    found = np.empty((256, 4), np.int64)
    count = list_open_steps(edges, cell, *low_yx, blocked, found)
    if count > len(found):
        found = np.empty((count, 4), np.int64)
        list_open_steps(edges, cell, *low_yx, blocked, found)
    crossed: dict[tuple[int, int, int], tuple[int, int]] = {}
    for row, column, axis, t in found[:count].tolist():
        first, last = crossed.get((row, column, axis), (t, t))
        crossed[row, column, axis] = min(first, t), max(last, t)
    for (row, column, axis), (first, last) in sorted(crossed.items()):
        ends = (row, column), (row + (axis == 0), column + (axis == 1))
        if not any(blocked[end] for end in ends):
            # The cell that the middle of the wall lies in.
            blocked[ends[first + last > 1 << T_BITS]] = 1
    block_passed_cells(edges, sides, cell, *low_yx, blocked)
