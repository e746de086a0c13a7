"""The first map of an epoch: all arcs of a grid's boundary, traced at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.grid import OccupancyGrid
from fleetmap.vectorize.arcs import Arcs
from fleetmap.vectorize.store import Store

APART_CELLS = 6
"""A free speck stays where no larger free space is that near: dropping those that lie apart costs UPDF. (On 21 real
maps none falls below 99.7 by it; with 3 the maps of the paper's terrains have a third more edges.)"""


def read_grid(grid: OccupancyGrid, store: Store, shift_yx: tuple[int, int]) -> tuple[NDArray[np.int32], int]:
    """Read a grid's states into an empty store and find their cracks; the corners (y, x), and how many there are."""
    from fleetmap.vectorize.cells_kernels import find_corners, find_cracks, read_states

    states, cracks = store.states, store.cracks
    height, width = states.shape
    y, x = shift_yx[0] - store.low_yx[0], shift_yx[1] - store.low_yx[1]
    read_states(grid.cells_yx, states, y, x, *grid.limits)
    store.raw[:] = states
    find_cracks(states, cracks, 1, 1, height, width)
    room = 1 << 14
    while True:
        corners = np.empty((room, 2), np.int32)
        count = find_corners(cracks.view(np.uint64), cracks, 1, 1, height, width, corners)
        if count >= 0:
            return corners, count
        room *= 4


def trace_grid(
    grid: OccupancyGrid, store: Store, shift_yx: tuple[int, int], specks: int, share: bool
) -> tuple[Arcs, tuple[int, int]]:
    """Read a grid into an empty store and trace its arcs; returns them, and how many specks and cells were filled.

    Parameters
    ----------
    shift_yx : lattice point of the lower left corner of the grid's cell (0, 0)
    specks : largest speck that is filled, in cells
    share : leave out arcs between occupied and unknown, but for outlines of hidden obstacles
    """
    from fleetmap.vectorize.obstacle_kernels import find_explained, measure_depth
    from fleetmap.vectorize.speck_kernels import fill_specks
    from fleetmap.vectorize.walk_kernels import finish_points, trace_arcs

    states, cracks = store.states, store.cracks
    corners, count = read_grid(grid, store, shift_yx)
    filled = fill_specks(states, cracks, store.seen, corners, count, specks, APART_CELLS, *store.low_yx)

    points = np.empty((4 * count + 4, 2), np.int32)
    offsets = np.empty(2 * count + 4, np.int32)
    labels, closed = np.empty(2 * count + 4, np.uint8), np.empty(2 * count + 4, np.uint8)
    n_arcs, size = trace_arcs(states, cracks, corners, count, points, offsets, labels, closed)
    points, offsets, labels, closed = points[:size], offsets[: n_arcs + 1], labels[:n_arcs], closed[:n_arcs]
    thickness = np.zeros(n_arcs, np.uint8)
    if share:
        drop = np.zeros(n_arcs, np.uint8)
        find_explained(states, store.seen, points, offsets, closed, labels, n_arcs, drop)
        keep, lengths = drop == 0, np.diff(offsets)
        points = np.ascontiguousarray(points[np.repeat(keep, lengths)])
        offsets = np.concatenate([[0], np.cumsum(lengths[keep])]).astype(np.int32)
        labels, closed, thickness = labels[keep], closed[keep], thickness[keep]
        measure_depth(states, points, offsets, closed, labels, len(labels), thickness)
    special = np.empty(len(points), np.uint8)
    finish_points(cracks, *store.low_yx, points, special)
    return Arcs.untouched(points, offsets, labels, closed, thickness, special), (int(filled[0]), int(filled[1]))
