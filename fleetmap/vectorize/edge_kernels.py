"""Numba kernels that list the edges between consecutive vertices of arcs.

Edges are rows of nine int64: the tail's and the head's place (y0, x0, y1, x1), the boundary points that they stand
for (the next four), and the direction of the crack that leaves the tail's point plus 4 times that of the one which
enters the head's.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.kernel import kernel

EDGE_COLUMNS = 9


@kernel("i8(i8, i8, i8, i8)", inline="always")
def direction(ay: int, ax: int, by: int, bx: int) -> int:
    """The direction of an axis-parallel step from a to b."""
    return 0 if bx > ax else 2 if bx < ax else 1 if by > ay else 3


@kernel("void(i4[:,::1], i8, i8, i4[:,::1], i8, i8, i8[:,::1], i8)")
def write_edge(
    points: NDArray[np.int32],
    start: int,
    end: int,
    at: NDArray[np.int32],
    tail: int,
    head: int,
    edges: NDArray[np.int64],
    k: int,
) -> None:
    """Row k: the edge between two corners of the arc that has the corners ``start`` to ``end``."""
    edges[k, 0], edges[k, 1], edges[k, 2], edges[k, 3] = at[tail, 0], at[tail, 1], at[head, 0], at[head, 1]
    edges[k, 4], edges[k, 5], edges[k, 6], edges[k, 7] = (
        points[tail, 0],
        points[tail, 1],
        points[head, 0],
        points[head, 1],
    )
    after = tail + 1 if tail + 1 < end else start
    before = head - 1 if head > start else end - 1
    leaves = direction(points[tail, 0], points[tail, 1], points[after, 0], points[after, 1])
    edges[k, 8] = leaves + 4 * direction(points[before, 0], points[before, 1], points[head, 0], points[head, 1])


@kernel(
    "i8(i4[:,::1], i4[::1], i4[:,::1], u1[::1], i8, i8, i8, i8, i4[::1], i4[::1], i4[::1], i8[:,::1])",
)
def list_run(
    points: NDArray[np.int32],
    offsets: NDArray[np.int32],
    at: NDArray[np.int32],
    is_vertex: NDArray[np.uint8],
    arc: int,
    tail: int,
    head: int,
    count: int,
    tails: NDArray[np.int32],
    heads: NDArray[np.int32],
    arc_of: NDArray[np.int32],
    edges: NDArray[np.int64],
) -> int:
    """Append the edges from one vertex of an arc to another one further on, or once around it; the new count."""
    start, end = np.int64(offsets[arc]), np.int64(offsets[arc + 1])
    m = tail
    while True:
        n = m + 1 if m + 1 < end else start
        while not is_vertex[n]:
            n = n + 1 if n + 1 < end else start
        tails[count], heads[count], arc_of[count] = m, n, arc
        write_edge(points, start, end, at, m, n, edges, count)
        count += 1
        m = n
        if m == head:
            return count


@kernel(
    "i8(i4[:,::1], i4[::1], u1[::1], i8, i4[:,::1], u1[::1], i4[::1], i4[::1], i4[::1], i8[:,::1])",
)
def list_edges(
    points: NDArray[np.int32],
    offsets: NDArray[np.int32],
    closed: NDArray[np.uint8],
    arcs: int,
    at: NDArray[np.int32],
    is_vertex: NDArray[np.uint8],
    tails: NDArray[np.int32],
    heads: NDArray[np.int32],
    arc_of: NDArray[np.int32],
    edges: NDArray[np.int64],
) -> int:
    """Fill the edges of all arcs, one arc after the other; returns how many."""
    count = np.int64(0)
    for arc in range(arcs):
        first, last = np.int64(offsets[arc]), np.int64(offsets[arc + 1]) - 1
        while first <= last and not is_vertex[first]:
            first += 1
        if first > last or (first == last and not closed[arc]):
            continue
        if closed[arc]:
            last = first
        count = list_run(points, offsets, at, is_vertex, arc, first, last, count, tails, heads, arc_of, edges)
    return count
