"""The faces into which a vector map's edges divide the plane, and whether the edges meet only at vertices."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray


def find_crossings(edges: NDArray[np.int64]) -> NDArray[np.int64]:
    """Find the pairs of edges that share more than a common endpoint.

    Parameters
    ----------
    edges : (n, 4) rows (y0, x0, y1, x1), |coordinate| <= 2^20, so that each cross product fits 45 bits

    Returns
    -------
    (m, 2) int64 : indices of the two edges; exact
    """
    import shapely

    tree = shapely.STRtree(shapely.linestrings(edges.reshape(-1, 2, 2)))
    i, j = tree.query(tree.geometries)  # by bounding boxes alone, which are exact
    i, j = i[i < j], j[i < j]
    p, q = edges[i, :2], edges[i, 2:]
    r, s = edges[j, :2], edges[j, 2:]
    side_r, side_s, side_p, side_q = _side(p, q, r), _side(p, q, s), _side(r, s, p), _side(r, s, q)
    meet_badly = (side_r * side_s < 0) & (side_p * side_q < 0)
    meet_badly |= (p == r).all(axis=1) & (q == s).all(axis=1)
    for side, point, a, b in ((side_r, r, p, q), (side_s, s, p, q), (side_p, p, r, s), (side_q, q, r, s)):
        in_box = ((np.minimum(a, b) <= point) & (point <= np.maximum(a, b))).all(axis=1)
        is_end = (point == a).all(axis=1) | (point == b).all(axis=1)
        meet_badly |= (side == 0) & in_box & ~is_end
    return np.column_stack([i, j])[meet_badly]


def _side(a: NDArray[np.int64], b: NDArray[np.int64], point: NDArray[np.int64]) -> NDArray[np.int64]:
    """1, 0 or -1: the point lies left of, on or right of the line from a to b; (n, 2) rows (y, x)."""
    to_b, to_point = b - a, point - a
    result: NDArray[np.int64] = np.sign(to_b[:, 1] * to_point[:, 0] - to_b[:, 0] * to_point[:, 1])
    return result


@dataclass(frozen=True, eq=False)
class Faces:
    """The faces of n edges that meet only at vertices.

    Parameters
    ----------
    left, right : (n,) face to the left and right of each edge, seen from its first endpoint
    count : number of faces, with the unbounded one
    outside : the unbounded face
    """

    left: NDArray[np.int64]
    right: NDArray[np.int64]
    count: int
    outside: int


def find_faces(edges: NDArray[np.int64]) -> Faces:
    """Find the faces of edges, (n, 4) rows (y0, x0, y1, x1), that meet only at vertices.

    Half-edge 2 e runs along edge e, 2 e + 1 back; each has one face to its left. Half-edges that follow each
    other around a face, and those that see each other across it, belong to one face.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n = len(edges)
    tails_yx = edges.reshape(-1, 2)  # of half-edge 0, 1, 2...: since 2 e starts where 2 e + 1 ends
    vertices, tail = np.unique(tails_yx, axis=0, return_inverse=True)
    towards = tails_yx[np.arange(2 * n) ^ 1] - tails_yx
    # Directions of lattice edges differ by over 2^-42, which arctan2 resolves.
    order = np.lexsort((np.arctan2(towards[:, 0], towards[:, 1]), tail))
    first = np.searchsorted(tail[order], np.arange(len(vertices)))
    last = np.append(first[1:], 2 * n) - 1
    # Whoever comes back along a half-edge leaves by the next one clockwise, and keeps the face to the left.
    clockwise = np.arange(2 * n) - 1
    clockwise[first] = last
    links = [np.column_stack([order ^ 1, order[clockwise]])]

    _, component = connected_components(
        coo_array((np.ones(n, bool), (tail[0::2], tail[1::2])), shape=(len(vertices), len(vertices))), directed=False
    )
    by_x = np.lexsort((vertices[:, 0], vertices[:, 1], component))
    leftmost = by_x[np.diff(component[by_x], prepend=-1) > 0]
    outside = 2 * n
    # Each edge in each row y with y0 <= y < y1, to see what lies west of a vertex.
    y0, y1 = edges[:, 0], edges[:, 2]
    edge = np.repeat(np.arange(n), y1 - y0)
    row = np.arange(len(edge)) - np.repeat(np.cumsum(y1 - y0) - y1, y1 - y0)
    by_row = np.argsort(row, kind="stable")
    edge, row = edge[by_row], row[by_row]
    for v in leftmost.tolist():
        y, x = vertices[v].tolist()
        beside = edge[np.searchsorted(row, y) : np.searchsorted(row, y, side="right")]
        met = _first_to_the_west(edges, beside, y, x)
        # Around a leftmost vertex the half-edge before the lowest direction has the space to the west.
        links.append(np.array([[order[first[v]] ^ 1, outside if met is None else 2 * met + 1]]))
    a, b = np.concatenate(links).T
    count, face = connected_components(
        coo_array((np.ones(len(a), bool), (a, b)), shape=(outside + 1, outside + 1)), directed=False
    )
    face = face.astype(np.int64)
    return Faces(face[0:outside:2], face[1:outside:2], int(count), int(face[outside]))


def _first_to_the_west(edges: NDArray[np.int64], beside: NDArray[np.int64], y: int, x: int) -> int | None:
    """The edge, of those that pass the row just above ``y``, that one meets first going west from (y, x)."""
    y0, x0, y1, x1 = edges[beside].T
    west = (y - y0) * (x1 - x0) < (x - x0) * (y1 - y0)
    if not west.any():
        return None
    at = (x0 + (y - y0) * (x1 - x0) / (y1 - y0))[west]
    nearest: list[tuple[Fraction, Fraction, int]] = []
    for e in beside[west][at >= at.max() - 1e-3].tolist():  # the floats only narrow the choice
        ey0, ex0, ey1, ex1 = edges[e].tolist()
        slope = Fraction(ex1 - ex0, ey1 - ey0)  # where two edges start at one vertex, it decides just above
        nearest.append((ex0 + (y - ey0) * slope, slope, e))
    return max(nearest)[2]
