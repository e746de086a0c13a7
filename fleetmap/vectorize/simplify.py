"""Boundary to chains of edges: keep what still holds, choose the rest, then repair."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetmap.vectorize.boundary import Boundary
from fleetmap.vectorize.topology import repair

REDO_RATIO, REDO_SLACK = 1.15, 2
"""An arc is simplified anew if keeping old edges makes it have more edges than this times the fewest, and so
many more: it bounds what stickiness costs."""


@dataclass(frozen=True, slots=True, eq=False)
class Chains:
    """Closed chains of directed edges, free (or hidden occupied) space on the left.

    Parameters
    ----------
    at : (v, 2) int64 lattice vertices (y, x)
    labels : (v,) uint8 label of the edge that leaves each vertex
    following, preceding : (v,) int64 next and last vertex of the same chain
    points : (v, 2) int64 the point of the boundary that each vertex stands for
    bends : (v,) uint8 how the boundary passes there
    thickness : (v,) int64 quarters of a cell, of the edge that leaves each vertex
    """

    at: NDArray[np.int64]
    labels: NDArray[np.uint8]
    following: NDArray[np.int64]
    preceding: NDArray[np.int64]
    points: NDArray[np.int64]
    bends: NDArray[np.uint8]
    thickness: NDArray[np.int64]


def simplify(boundary: Boundary, epsilon2: int, old: Chains | None) -> tuple[Chains, NDArray[np.int64]]:
    """Simplify a boundary within epsilon, keeping the old edges whose certificate still holds.

    Parameters
    ----------
    epsilon2 : epsilon squared, in sixteenths of a cell squared
    old : the chains of the last map of this epoch, if any

    Returns
    -------
    chains : the new ones; their thickness is the old one for kept edges, else -1
    edge_of : (n,) int64 for each point of the boundary the edge (its first vertex) that owns the step leaving it
    """
    from fleetmap.vectorize.simplify_kernels import choose_vertices
    from fleetmap.vectorize.sticky_kernels import keep_edges

    if old is not None and len(old.at) == 0:
        old = None
    size = len(boundary.points)
    nodes = boundary.nodes()
    preceding = np.empty(size, np.int64)
    preceding[boundary.following] = np.arange(size)
    bends = _bends(boundary.points, boundary.following, preceding)

    def choose(kept: NDArray[np.bool_]) -> NDArray[np.uint8]:
        """Flag the vertices of the fewest edges beside the kept ones, which start at the points ``kept``."""
        stops = nodes.copy()
        stops[kept] = 1
        stops[ends[kept]] = 1
        is_vertex = np.zeros(size, np.uint8)
        choose_vertices(
            boundary.points, boundary.turns, boundary.offsets, *boundary.phase_yx, epsilon2,
            stops, kept.astype(np.uint8), at, is_vertex,
        )  # fmt: skip
        return is_vertex

    # 1. Old edges that still hold.
    at = boundary.points.copy()
    old_edge = np.full(size, -1, np.int64)
    ends = np.zeros(size, np.int64)
    if old is not None:
        keep_edges(
            old.at, old.labels, old.following, old.preceding, old.points, old.bends,
            boundary.points, boundary.labels, boundary.turns, bends, boundary.following, preceding,
            *boundary.phase_yx, epsilon2, at, old_edge, ends,
        )  # fmt: skip
    kept = old_edge >= 0

    # 2. The fewest edges between them; arcs that would then have too many are done anew.
    is_vertex = choose(kept)
    if kept.any():
        redo = _wasteful(boundary, nodes, kept, is_vertex, choose)
        if redo.any():
            kept &= ~redo
            loose = np.ones(size, bool)
            loose[kept] = False
            loose[ends[kept]] = False
            at[loose] = boundary.points[loose]
            is_vertex = choose(kept)

    # 3. Edges meet only at vertices, all hold, and enclose what the boundary encloses.
    tails, heads = repair(boundary, epsilon2, at, is_vertex)

    following = np.searchsorted(tails, heads)
    before = np.empty(len(tails), np.int64)
    before[following] = np.arange(len(tails))
    thickness = np.full(len(tails), -1, np.int64)
    if old is not None:
        i = old_edge[tails]
        same = (i >= 0) & kept[tails] & (ends[tails] == heads)
        same &= (old.at[i] == at[tails]).all(axis=1) & (old.at[old.following[i]] == at[heads]).all(axis=1)
        thickness[same] = old.thickness[i[same]]
    chains = Chains(
        at[tails], boundary.labels[tails], following, before, boundary.points[tails], bends[tails], thickness
    )
    return chains, _last_start(boundary.offsets, tails)


def _bends(points: NDArray[np.int64], following: NDArray[np.int64], preceding: NDArray[np.int64]) -> NDArray[np.uint8]:
    """(n,) a number for the directions in which the walk enters and leaves each point."""
    step = points[following] - points
    direction = (3 * step[:, 0] + step[:, 1] + 3).astype(np.uint8)  # 0, 2, 4 or 6
    return direction + 8 * direction[preceding]


def _last_start(offsets: NDArray[np.int64], starts: NDArray[np.int64]) -> NDArray[np.int64]:
    """(n,) for each point the last of ``starts`` (ascending) on the way to it in its loop; -1 in a loop without."""
    size = offsets[-1]
    loop_of = np.repeat(np.arange(len(offsets) - 1), np.diff(offsets))
    bounds = np.searchsorted(starts, offsets)
    last = np.searchsorted(starts, np.arange(size), side="right") - 1
    # Before the first start of its loop a point belongs to the loop's last one.
    early = last < bounds[:-1][loop_of]
    last[early] = (bounds[1:] - 1)[loop_of[early]]
    last[(bounds[1:] == bounds[:-1])[loop_of]] = -1
    return last


def _wasteful(
    boundary: Boundary,
    nodes: NDArray[np.uint8],
    kept: NDArray[np.bool_],
    is_vertex: NDArray[np.uint8],
    choose: Callable[[NDArray[np.bool_]], NDArray[np.uint8]],
) -> NDArray[np.bool_]:
    """(n,) points on arcs that have too many edges because old ones were kept."""
    # Arcs start at nodes; a loop without one is an arc.
    loop_of = np.repeat(np.arange(len(boundary.offsets) - 1), np.diff(boundary.offsets))
    starts = np.flatnonzero(nodes)
    arc_of = _last_start(boundary.offsets, starts)
    arc_of[arc_of < 0] = len(starts) + loop_of[arc_of < 0]
    arcs = len(starts) + len(boundary.offsets) - 1

    def count_edges(where: NDArray[np.generic]) -> NDArray[np.int64]:
        return np.bincount(arc_of[np.flatnonzero(where)], minlength=arcs)

    # Arcs on which all was kept stay as they are.
    has_gap = count_edges((is_vertex == 1) & ~kept) > 0
    fewest = count_edges(choose(kept & ~has_gap[arc_of]))
    wasteful = has_gap & (count_edges(is_vertex) > REDO_RATIO * fewest + REDO_SLACK)
    return wasteful[arc_of]
