"""Edges and points by the tiles that they lie in: what makes every step of the fold look at its neighbourhood only.

A search that reads whole rows of the map is quick on maps of buildings and quadratic on what somebody may draw to
stop the others: a hundred thousand corners in one row. Here each search costs what lies in the tiles that it asks
for, so that the density of edges in tiles (``afford``) bounds the whole fold.

Tiles are squares of 64 steps of the fleet lattice (0.32 m): at usual cells one holds a handful of edges of a map.
Where cells are larger, walls are told apart by farther, and searched for farther away: those of a level l of cell
sizes have tiles 2^l times as large, so that no search asks for more than a few tiles along each axis.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

SHIFT = 6
"""Tiles of level 0 have sides of 2^6 lattice steps."""

LEVEL_CELL, LEVELS = 10, 8
"""Level l is of cells of up to 10 * 2^l lattice steps (5, 10, 20 cm ...); the largest possible ones have 2000."""

KEY_BITS = 20
"""A tile's key: its level, row and column, 20 bits for each of the last two, which are less than 2^17 from 0."""


class Tiles(NamedTuple):
    """What lies in which tile: ``items[start[k]:start[k + 1]]`` in the tile of key ``keys[k]``, ascending."""

    keys: NDArray[np.int64]
    start: NDArray[np.int64]
    items: NDArray[np.int64]

    @classmethod
    def sorted_by(cls, keys: NDArray[np.int64], items: NDArray[np.int64]) -> Tiles:
        """From (n,) keys and the item of each; within a tile the items keep their order."""
        from fleetmap.model.sort_kernels import order_of

        if len(keys) == 0:
            return cls(keys, np.zeros(1, np.int64), items)
        order = order_of(keys)
        keys = keys[order]
        first = np.concatenate([[0], np.flatnonzero(keys[1:] != keys[:-1]) + 1])
        return cls(keys[first], np.append(first, len(keys)), items[order])


def levels_of(cell: NDArray[np.int64]) -> NDArray[np.int64]:
    """(n,) cell sizes, lattice steps, at least 1 and at most 2000 -> (n,) their levels, 0 to 7."""
    return np.searchsorted(np.int64(LEVEL_CELL) << np.arange(LEVELS), cell)


def keys_of(points: NDArray[np.int64], level: NDArray[np.int64] | int = 0) -> NDArray[np.int64]:
    """(n, 2) points (y, x) -> (n,) keys of their tiles of a level."""
    half = 1 << (KEY_BITS - 1)
    row, column = points[:, 0] >> (SHIFT + level), points[:, 1] >> (SHIFT + level)
    return np.asarray((((level << KEY_BITS) + row + half) << KEY_BITS) + column + half, np.int64)


def tiles_of_points(points: NDArray[np.int64], level: NDArray[np.int64] | int = 0) -> Tiles:
    """(n, 2) points (y, x) by tile; each lies in one."""
    return Tiles.sorted_by(keys_of(points, level), np.arange(len(points)))


def tiles_of_edges(ends: NDArray[np.int64], level: NDArray[np.int64] | None = None) -> Tiles:
    """(n, 4) edges, lower end first, by the tiles that they pass at most one step from.

    Within a tile they ascend by their least x, so that a search can stop early.
    """
    from fleetmap.merge.tile_kernels import enter_tiles

    order = np.argsort(np.minimum(ends[:, 1], ends[:, 3]), kind="stable")
    if level is None:
        level = np.zeros(len(ends), np.int64)
    keys, items = enter_tiles(ends, order, level, np.iinfo(np.int64).max)
    return Tiles.sorted_by(keys, items)
