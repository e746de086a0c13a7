"""Step 5: which pieces say something: boundaries of the united free space, and walls that nothing explains."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.merge.arrange import Arrangement
from fleetmap.merge.bridge import bridges
from fleetmap.merge.tiles import levels_of, tiles_of_edges
from fleetmap.model.lattice import FREE, OCCUPIED


def select(
    arrangement: Arrangement, left: NDArray[np.int64], right: NDArray[np.int64], *, reach_cells: int
) -> NDArray[np.int64]:
    """Rows (m, 8) of the merged map, before simplification.

    Parameters
    ----------
    left, right : (n,) states of the sides of each piece
    reach_cells : how far a second sight of a wall may lie from the first (see ``pair_cell``)

    Notes
    -----
    A wall of one robot inside the free space of another stays (law 3), but for one case: the other robot saw
    the same wall, a few cells farther, as noise and simplification have it. So a wall that doesn't bound the
    united free space goes if all of it lies within reach of walls that face the same way and stay: those
    that bound free space, and those that sources before it saw. A thin wall's two faces never explain each
    other, for they face opposite ways. And what closes a hole stays (``bridge``).

    Where the other robot saw only that space ends there, its frontier takes the wall's place: nobody has
    seen free space beyond it, and a frontier just behind a wall would send robots there.
    """
    a = arrangement
    wall = a.wall_left | a.wall_right
    bounds = (left == FREE) != (right == FREE)
    # What bounds free space faces that space; any other wall faces where its sources stood.
    faces = np.where(bounds, np.where(left == FREE, 1, 2), np.where(a.wall_right, 1, 0) + np.where(a.wall_left, 2, 0))

    # 1. Frontiers close behind walls that bound nothing are those walls.
    inner = wall & ~bounds
    behind = bounds & ~wall
    behind &= _second_sights(a, faces, np.where(inner, -1, 0), inner | behind, reach_cells)
    wall |= behind
    left = np.where(behind & (left != FREE), OCCUPIED, left)
    right = np.where(behind & (right != FREE), OCCUPIED, right)

    # 2. Walls that bound nothing go where others explain them.
    gone = _second_sights(a, faces, np.where(bounds, -1, a.rank), wall, reach_cells)
    gone &= ~bridges(a.ends, a.cell, (bounds | wall) & ~gone, gone)

    rows = np.column_stack([a.ends, left, right, wall, np.where(wall, a.thickness, 0)])
    return np.asarray(rows[(bounds | wall) & ~gone])


def _second_sights(
    a: Arrangement,
    faces: NDArray[np.int64],
    rank: NDArray[np.int64],
    among: NDArray[np.bool_],
    reach_cells: int,
) -> NDArray[np.bool_]:
    """Which pieces lie within reach of pieces of lower rank that stay and face the same way; (n,) bool.

    Only pieces ``among`` take part; those of rank -1 always stay.
    """
    from fleetmap.merge.select_kernels import explained

    out = np.zeros(len(a.ends), bool)
    part = np.flatnonzero(among)
    if len(part):
        ends, rank, cell = a.ends[part], rank[part], a.cell[part]
        order = np.argsort(rank, kind="stable")
        level = levels_of(cell)
        tiles = tiles_of_edges(ends, level)
        out[part] = explained(ends, faces[part], rank, cell, order, np.unique(level), *tiles, reach_cells)
    return out
