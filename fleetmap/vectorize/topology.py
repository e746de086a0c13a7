"""Repair: chains whose edges hold, meet only at vertices, and enclose what the boundary encloses."""

from __future__ import annotations

import math
from itertools import count

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.lattice import FREE
from fleetmap.vectorize.boundary import Boundary
from fleetmap.vectorize.pinches import find_swapped

BUCKET_CELLS = 16
"""Edges are looked up in squares, or rows, of this size when they are tested against others."""

ROUNDS_OF_ONE = 4
"""So often only the longer edge of two that meet is split, which takes 10 % fewer edges; then both are, which ends
sooner."""


def repair(
    boundary: Boundary, epsilon2: int, at: NDArray[np.int64], is_vertex: NDArray[np.uint8]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Split edges until all is as it should be; returns their tails and heads, points of the boundary.

    It ends: each round splits an edge or puts a vertex onto the boundary, and the boundary itself is as it
    should be. ``at`` and ``is_vertex`` (see ``simplify_kernels``) are changed in place.
    """
    from fleetmap.vectorize.crossing_kernels import find_crossings
    from fleetmap.vectorize.simplify_kernels import choose_vertices, find_uncertified, split_edges

    size = len(boundary.points)
    tested = np.full(size, -1, np.int64)  # the head of the edge from each point that was tested already
    turns_before = np.cumsum(boundary.turns, dtype=np.int64)
    loop_of_point = np.repeat(np.arange(len(boundary.offsets) - 1), np.diff(boundary.offsets))
    turns_of_loop = np.bincount(loop_of_point, boundary.turns, len(boundary.offsets) - 1).astype(np.int64)
    for attempt in count():
        tails, heads = _edges(boundary.offsets, is_vertex)
        raw = (at == boundary.points).all(axis=1)
        # An edge along which the boundary doesn't turn, with both ends on it, can't be improved.
        between = turns_before[heads] - turns_before[tails] - boundary.turns[heads]
        between[heads <= tails] += turns_of_loop[loop_of_point[tails[heads <= tails]]]
        final = (between == 0) & raw[tails] & raw[heads]

        bad = np.zeros(len(tails), np.uint8)
        find_uncertified(
            boundary.points, boundary.turns, boundary.following, tails, heads, *boundary.phase_yx, epsilon2, at, bad
        )
        edges, ends = np.column_stack([at[tails], at[heads]]), np.column_stack([tails, heads])
        fresh = (tested[tails] != heads).astype(np.uint8)
        find_crossings(
            edges, ends, raw[ends].astype(np.uint8), final.astype(np.uint8), fresh,
            BUCKET_CELLS, attempt >= ROUNDS_OF_ONE, bad,
        )  # fmt: skip
        if not bad.any():
            find_swapped(boundary, at, tails, heads, bad)
            _find_jumped(boundary, epsilon2, at, tails, heads, edges, bad)
        bad[final] = 0
        if not bad.any():
            return tails, heads
        moved = split_edges(boundary.points, boundary.turns, boundary.following, tails, heads, bad, at, is_vertex)
        # The halves are chosen anew: an end at the farthest turn may be a bad one for the rest.
        holds = np.zeros(size, np.uint8)
        holds[tails[bad == 0]] = 1
        choose_vertices(
            boundary.points, boundary.turns, boundary.offsets, *boundary.phase_yx, epsilon2,
            is_vertex.copy(), holds, at, is_vertex,
        )  # fmt: skip
        tested[tails] = np.where(bad == 0, heads, -1)
        if moved:
            tested[:] = -1
    raise AssertionError("unreachable")


def _edges(offsets: NDArray[np.int64], is_vertex: NDArray[np.uint8]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Tails and heads, as points of the boundary, of the edges between consecutive vertices of each loop."""
    tails = np.flatnonzero(is_vertex)
    bounds = np.searchsorted(tails, offsets)
    heads = np.empty_like(tails)
    heads[:-1] = tails[1:]
    heads[bounds[1:] - 1] = tails[bounds[:-1]]
    return tails, heads


def _find_jumped(
    boundary: Boundary,
    epsilon2: int,
    at: NDArray[np.int64],
    tails: NDArray[np.int64],
    heads: NDArray[np.int64],
    edges: NDArray[np.int64],
    bad: NDArray[np.uint8],
) -> None:
    """Set ``bad`` for edges that have jumped over their own loop, or over another that lies on their other side."""
    from fleetmap.vectorize.nesting_kernels import find_jumpers, find_misplaced

    bounds = np.searchsorted(tails, boundary.offsets)
    loops = len(boundary.offsets) - 1
    loop_of = np.repeat(np.arange(loops), np.diff(bounds))
    # Around a hole there is one winding more of its own kind than around what is solid.
    kinds = np.where(boundary.labels[boundary.offsets[:-1]] // 3 == FREE, 1, 1024).astype(np.int64)
    steps = np.column_stack([boundary.points, boundary.points[boundary.following]])
    areas = _areas(steps, boundary.offsets)
    expected = np.where(areas < 0, kinds, 0)
    turned_over = np.sign(_areas(edges, bounds)) != np.sign(areas)
    bad[turned_over[loop_of]] = 1
    misplaced = np.empty(loops, np.int64)
    find_misplaced(edges, bounds, kinds, expected, loop_of, BUCKET_CELLS, misplaced)
    reach = math.isqrt(epsilon2) // 16 + 1
    for loop in np.flatnonzero(misplaced >= 0).tolist():
        where = int(tails[misplaced[loop]])
        if not find_jumpers(boundary.points, boundary.following, at, tails, heads, loop_of, loop, where, reach, bad):
            # Vertices that were kept off the boundary have moved it: all that is near goes back.
            low, high = np.minimum(at[tails], at[heads]), np.maximum(at[tails], at[heads])
            place = boundary.points[where]
            bad[((low - 2 * reach <= place) & (place <= high + 2 * reach)).all(axis=1)] = 1


def _areas(edges: NDArray[np.int64], bounds: NDArray[np.int64]) -> NDArray[np.int64]:
    """(k,) twice the area of each loop, positive if it runs counter-clockwise; edges are (y0, x0, y1, x1)."""
    cross = edges[:, 1] * edges[:, 2] - edges[:, 3] * edges[:, 0]
    return np.diff(np.concatenate([[0], np.cumsum(cross)])[bounds])
