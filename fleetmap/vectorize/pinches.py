"""Vertices in which two stretches of the boundary touch: their edges must not change places."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.vectorize.boundary import Boundary


def find_swapped(
    boundary: Boundary,
    at: NDArray[np.int64],
    tails: NDArray[np.int64],
    heads: NDArray[np.int64],
    bad: NDArray[np.uint8],
) -> None:
    """Set ``bad`` for edges that leave a shared vertex on the wrong side of the other stretch's.

    The boundary passes a lattice point twice where cells of one state meet at a corner there. Each passage is a
    right angle that turns away from the other one; the two edges that a passage has become may enclose any
    angle, but still none of the other's edges.
    """
    incoming = np.empty(len(tails), np.int64)  # the edge that ends where each edge starts
    incoming[np.searchsorted(tails, heads)] = np.arange(len(tails))
    order = np.lexsort((at[tails, 1], at[tails, 0]))
    places = at[tails[order]]
    equal = (places[1:] == places[:-1]).all(axis=1)
    first, second = order[:-1][equal], order[1:][equal]

    def rays(edge: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The sides of the angle, the second one counter-clockwise of the first, in which the other has no edge."""
        here = at[tails[edge]]
        out, back = at[heads[edge]] - here, at[tails[incoming[edge]]] - here
        # A walk along the boundary that turns left has its angle on the left.
        point = boundary.points[tails[edge]]
        leaves = boundary.points[boundary.following[tails[edge]]] - point
        enters = point - boundary.points[preceding[tails[edge]]]
        left = (_cross(enters, leaves) > 0)[:, None]
        return np.where(left, out, back), np.where(left, back, out)

    preceding = np.empty(len(boundary.points), np.int64)
    preceding[boundary.following] = np.arange(len(boundary.points))
    a, b = rays(first)
    c, d = rays(second)
    swapped = _is_within(a, b, c) | _is_within(a, b, d) | _is_within(c, d, a) | _is_within(c, d, b)
    for edge in (first[swapped], second[swapped]):
        bad[edge] = 1
        bad[incoming[edge]] = 1


def _cross(a: NDArray[np.int64], b: NDArray[np.int64]) -> NDArray[np.int64]:
    """(n,) positive where b is counter-clockwise of a; (n, 2) rows (y, x)."""
    return a[:, 1] * b[:, 0] - a[:, 0] * b[:, 1]


def _is_within(a: NDArray[np.int64], b: NDArray[np.int64], ray: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(n,) whether the ray is strictly inside the angle from a counter-clockwise to b."""
    after_a, before_b = _cross(a, ray) > 0, _cross(ray, b) > 0
    wide = _cross(a, b)
    opposite = (wide == 0) & ((a * b).sum(axis=1) < 0)
    reflex = ~((_cross(b, ray) >= 0) & (_cross(ray, a) >= 0))
    return np.where(wide > 0, after_a & before_b, np.where(opposite, after_a, reflex & (wide < 0)))
