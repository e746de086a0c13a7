"""Part of step 5: of second sights that would go, those stay that close a hole.

Where two sights of a thin wall cross, they are one wall up to the crossing, a wedge whose tip lies there, and side by
side beyond it. Each sight of the part beyond may lie within reach of the walls at both of its ends, and be explained
by them, though nothing is left between the tips.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.merge.arrange import pack, unpack

LONGEST_CELLS = 8
"""Holes are no longer than twice the reach of a second sight (6 cells), along the axes a little more."""

DETOUR = 3
"""Walls that stay lead around a hole, if at all, by a way that is at least so many times as long."""

MOST_VERTICES = 100
"""So many are looked at around a tip, so that nobody's map of dense crossings takes the time of all."""

MOST_WALLS = 8
"""A tip has no more walls: they leave it within a right angle. Nor are more pieces of one vertex looked at."""

BEND_FIFTHS = 6
"""What closes a hole goes on from the tip rather straight: its way is no longer than 6 / 5 of the distance, and a
cell."""


def bridges(
    ends: NDArray[np.int64], cell: NDArray[np.int64], stays: NDArray[np.bool_], gone: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Which of the walls that go lead on from the tip of one that stays to another one; (n,) bool.

    From each tip the shortest way is taken (the sum of |dy| + |dx|, ties by place) that leads away from the tip's own
    walls, and to where these lead by a long detour only, if at all. So the result doesn't depend on any order.

    Parameters
    ----------
    ends : (n, 4) int64 pieces, which meet only at vertices
    cell : (n,) size of a cell of the source of each, lattice steps
    stays, gone : (n,) boundaries that stay, and walls that would go
    """
    from fleetmap.merge.bridge_kernels import find_bridges

    found = np.zeros(len(ends), bool)
    part = np.flatnonzero(stays | gone)
    vertices, ids = np.unique(pack(ends[part].reshape(-1, 2)), return_inverse=True)
    ids, goes = ids.reshape(-1, 2), gone[part]
    ways, walls = _pieces_at(ids, goes, len(vertices)), _pieces_at(ids, ~goes, len(vertices))
    tips = np.intersect1d(ids[goes], ids[~goes])
    found[part] = find_bridges(unpack(vertices), np.ascontiguousarray(ids), cell[part], tips, *ways, *walls)
    return found


def _pieces_at(
    ids: NDArray[np.int64], among: NDArray[np.bool_], n_vertices: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Some of the pieces by their vertices: those at v are ``items[start[v]:start[v + 1]]``, ascending."""
    pieces = np.flatnonzero(among)
    at = ids[pieces].ravel()
    order = np.argsort(at, kind="stable")
    return np.searchsorted(at[order], np.arange(n_vertices + 1)), np.repeat(pieces, 2)[order]
