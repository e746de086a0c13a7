"""Edges to cells: which cell centres are blocked, free or unknown, by exact integers.

Free is where the winding sum of the free faces is positive: a sum along each row, so that nothing can
leak through a gap as it would in a flood fill. A wall then blocks

* cells that are not free, within its thickness (a cell at least) on its sides that are not free,
* free cells only within half a cell of it, on a side that is not free, so that no thickness covers space
  that another source saw as free,
* and, if both its sides are free, half a cell on each side.

Maps of the profiles ``full`` and ``exact`` have occupied faces of their own; in ``full`` half a cell behind each
surface is occupied, too. At last what no cell's centre lies in is sealed (``model.seal``), but in ``exact``, whose
cells are what they were.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.errors import MapFormatError
from fleetmap.model.grid import MAX_CELLS
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN
from fleetmap.model.seal import seal_walls
from fleetmap.model.vectormap import THICKNESS_PER_CELL, VectorMap

Y0, X0, Y1, X1, LEFT, RIGHT, OBSTACLE, THICKNESS = range(8)
"""Columns of the rows that are painted: those of ``MergedMap.edges``."""

CELL = 16
"""Units in which vector maps are painted: sixteenths of a cell, so that a grid of any phase can be."""


def merged_states(edges: NDArray[np.int32], step: int) -> tuple[NDArray[np.uint8], tuple[int, int]]:
    """Rasterise the arrangement of a merged map.

    Parameters
    ----------
    edges : (n, 8) int32 as in ``MergedMap``
    step : size of a cell in fleet lattice steps, at least 1; cell corners lie on its multiples

    Returns
    -------
    states_yx : (height, width) uint8 FREE, OCCUPIED or UNKNOWN, just large enough for all that is painted
    low_yx : cell (0, 0) has its lower left corner at ``step * low_yx``

    Raises
    ------
    MapFormatError : more than ``MAX_CELLS`` cells
    """
    rows = edges.astype(np.int64)
    low_yx, shape = _extent(rows, step)
    return _states(rows, step, low_yx, shape), low_yx


def vector_map_states(
    vector_map: VectorMap,
    *,
    low_yx: tuple[int, int] | None = None,
    shape: tuple[int, int] | None = None,
    phase_yx: tuple[int, int] = (0, 0),
) -> tuple[NDArray[np.uint8], tuple[int, int]]:
    """Rasterise a vector map on the cells of its own lattice.

    Parameters
    ----------
    low_yx, shape : the window in cells, (y, x) and (height, width); give both, or neither for the extent of
        the map
    phase_yx : moves the window by so many sixteenths of a cell, each -8 to 7

    Returns
    -------
    states_yx : (height, width) uint8 FREE, OCCUPIED or UNKNOWN
    low_yx : lattice point of the lower left corner of cell (0, 0)

    Raises
    ------
    MapFormatError : more than ``MAX_CELLS`` cells
    """
    # In sixteenths of a cell a vector map looks like a merged one.
    rows = np.zeros((len(vector_map), 8), np.int64)
    rows[:, :LEFT] = vector_map.edges[:, :4].astype(np.int64) * CELL - [*phase_yx, *phase_yx]
    rows[:, LEFT], rows[:, RIGHT] = np.divmod(vector_map.edges[:, 4], 3)
    rows[:, OBSTACLE] = vector_map.obstacle
    rows[:, THICKNESS] = vector_map.thickness.astype(np.int64) * (CELL // THICKNESS_PER_CELL)
    if low_yx is None or shape is None:
        low_yx, shape = _extent(rows, CELL)
    return _states(rows, CELL, low_yx, shape, profile=vector_map.profile), low_yx


def _extent(rows: NDArray[np.int64], step: int) -> tuple[tuple[int, int], tuple[int, int]]:
    """Find the least window that holds all edges and painted walls: (low_yx, shape); one cell if empty."""
    if len(rows) == 0:
        return (0, 0), (1, 1)
    two_sided = (rows[:, LEFT] == FREE) & (rows[:, RIGHT] == FREE)
    depth = np.where(two_sided, step, np.maximum(rows[:, THICKNESS], step))
    pad = np.where(rows[:, OBSTACLE] == 1, depth, 0)[:, None]
    low = np.minimum(rows[:, [Y0, X0]], rows[:, [Y1, X1]]) - pad
    high = np.maximum(rows[:, [Y0, X0]], rows[:, [Y1, X1]]) + pad
    low_y, low_x = (low.min(axis=0) // step).tolist()
    high_y, high_x = (-(-high.max(axis=0) // step)).tolist()
    return (low_y, low_x), (max(high_y - low_y, 1), max(high_x - low_x, 1))


def _states(
    rows: NDArray[np.int64], step: int, low_yx: tuple[int, int], shape: tuple[int, int], *, profile: str = "merged"
) -> NDArray[np.uint8]:
    """Free faces, then walls; in vector maps also occupied faces, the only walls of ``full`` and ``exact``."""
    if shape[0] * shape[1] > MAX_CELLS:
        raise MapFormatError(
            path="<map>", field="extent", reason=f"{shape[0]} x {shape[1]} cells; at most {MAX_CELLS} are painted"
        )
    from fleetmap.model.raster_kernels import SQUARE, add_crossings

    # Half steps: cell centres are integers.
    doubled = np.ascontiguousarray(rows[:, : X1 + 1] * 2)
    left, right = rows[:, LEFT], rows[:, RIGHT]

    def inside(state: int, counts: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """(height, width) where faces of a state lie, by the edges that count."""
        sums = np.zeros(shape, np.int32)
        weights = ((right == state).astype(np.int64) - (left == state)) * counts
        add_crossings(doubled, weights, 2 * step, *low_yx, sums)
        return np.cumsum(sums, axis=1, out=sums) > 0

    free = inside(FREE, np.ones(len(rows), bool))
    if profile in ("share", "full"):
        # Half a cell beside each frontier, lest a ray of one cell vanish between its two sides.
        frontiers = ((left == FREE) & (right == UNKNOWN)) | ((left == UNKNOWN) & (right == FREE))
        sides = ((left == FREE) + 2 * (right == FREE)).astype(np.int64)[frontiers]
        reach = np.full((len(sides), 2), step, np.int64)
        free |= _paint(doubled[frontiers], sides, reach, step, low_yx, np.zeros(shape, bool)) == 1
    states = np.where(free, FREE, UNKNOWN).astype(np.uint8)
    if profile in ("full", "exact"):
        states[inside(OCCUPIED, np.ones(len(rows), bool)) & ~free] = OCCUPIED
        if profile == "exact":
            return states
        # Half a cell behind each surface, lest a wall of one cell vanish between its two.
        surfaces = (left == OCCUPIED) | (right == OCCUPIED)
        sides = ((left == OCCUPIED) + 2 * (right == OCCUPIED)).astype(np.int64)[surfaces]
        reach = np.full((len(sides), 2), step, np.int64)
        blocked = _paint(doubled[surfaces], sides, reach, step, low_yx, free)
        states[(blocked == 1) & ~free] = OCCUPIED
    # Between occupied and unknown: as thick as they say; those of former versions, which don't, enclose what they mean.
    hidden = (left != FREE) & (right != FREE) if profile == "share" else np.zeros(len(rows), bool)
    thick = hidden & (rows[:, THICKNESS] > 0)
    hidden &= ~thick
    if hidden.any():
        states[inside(OCCUPIED, hidden) & ~free] = OCCUPIED
    if thick.any():
        # Round ends would reach out of the obstacle, where nothing holds them back.
        sides = ((left == OCCUPIED) + 2 * (right == OCCUPIED)).astype(np.int64)[thick] | SQUARE
        reach = np.full((len(sides), 2), step, np.int64)
        reach[:, 0] = 2 * np.maximum(rows[thick, THICKNESS], step)
        states[(_paint(doubled[thick], sides, reach, step, low_yx, free) == 1) & ~free] = OCCUPIED

    walls = rows[:, OBSTACLE] == 1
    edges, left, right = doubled[walls], left[walls], right[walls]
    two_sided = (left == FREE) & (right == FREE)
    sides = np.where(two_sided, 3, (left != FREE) + 2 * (right != FREE)).astype(np.int64)
    if profile != "full":
        reach = np.full((len(edges), 2), step, np.int64)  # half a cell
        reach[:, 0] = np.where(two_sided, step, 2 * np.maximum(rows[walls, THICKNESS], step))
        states[_paint(edges, sides, reach, step, low_yx, free) == 1] = OCCUPIED
    sealed = (states == OCCUPIED).astype(np.uint8)
    seal_walls(edges, sides, 2 * step, low_yx, sealed)
    states[sealed == 1] = OCCUPIED
    return states


def _paint(
    edges: NDArray[np.int64],
    sides: NDArray[np.int64],
    reach: NDArray[np.int64],
    step: int,
    low_yx: tuple[int, int],
    free: NDArray[np.bool_],
) -> NDArray[np.uint8]:
    """(height, width) 1 where walls block; arguments as those of ``paint_walls``."""
    from fleetmap.model.raster_kernels import paint_walls

    blocked = np.zeros(free.shape, np.uint8)
    paint_walls(
        edges, sides, reach, _reach_times_length(edges, reach), 2 * step, *low_yx, free.astype(np.uint8), blocked
    )
    return blocked


def _reach_times_length(edges: NDArray[np.int64], reach: NDArray[np.int64]) -> NDArray[np.int64]:
    """floor(reach * length of the edge), (n, 2): in Python integers, since its square needs up to 80 bits."""
    length2 = (edges[:, 2] - edges[:, 0]) ** 2 + (edges[:, 3] - edges[:, 1]) ** 2
    pairs = zip(reach.tolist(), length2.tolist(), strict=True)
    return np.array([[math.isqrt(r * r * n) for r in both] for both, n in pairs], np.int64).reshape(-1, 2)
