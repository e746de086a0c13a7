"""Numba kernels that choose vertices along a gap of boundary: the fewest edges that hold.

A *gap* is a run of n corners between two vertices that must stay: an int64 array whose rows are, for each corner, its
true place (``TRUE_Y``, ``TRUE_X``) in sixteenths of a cell, and the vertex that stands or would stand for it (``AT_Y``,
``AT_X``) in cells of the lattice; two rows to work in; and, for each vertex of the chain that was chosen, which
``CORNER`` it stands for and where it lies (``PLACE_Y``, ``PLACE_X``).

The certificate of an edge from vertex a to vertex b, corners of the gap:

* both its ends are within epsilon of the corners they stand for, and
* all corners between are within epsilon of the edge.

Then every point of the run is within epsilon of the edge (the set of points that are is convex), and every
point of the edge within epsilon of the run (the nearest point of the edge moves continuously along it).

What is chosen is guided by floats and tested by integers. Bits: |coordinates| <= 2^24 sixteenths and edges of at
most 2^12 cells, so products stay below 2^43, and what is squared below 2^31; epsilon2 (sixteenths) <= 2^20.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.kernel import kernel

TRUE_Y, TRUE_X, AT_Y, AT_X, COST, PREVIOUS, CORNER, PLACE_Y, PLACE_X = range(9)
GAP_ROWS = 9

LONGEST_EDGE_CELLS = 4096
"""No edge is longer along x or y, so that the products of the certificate fit 64 bits."""

SOURCES = 6
"""Of all vertices that take equally many edges, so many are gone on from, those that are farthest along: on long
straight walls there are hundreds. All of them find fewer edges in one of a thousand cases."""


@kernel("b1(i8, i8, i8, i8, i8, i8, i8)", inline="always")
def is_near(py: int, px: int, ay: int, ax: int, by: int, bx: int, epsilon2: int) -> bool:
    """Whether point p is within epsilon of the segment from a to b, all in sixteenths."""
    dy, dx = by - ay, bx - ax
    ry, rx = py - ay, px - ax
    along = dy * ry + dx * rx
    length2 = dy * dy + dx * dx
    if along <= 0:
        if abs(ry) > 1024 or abs(rx) > 1024:
            return False
        return ry * ry + rx * rx <= epsilon2
    if along >= length2:
        ry, rx = py - by, px - bx
        if abs(ry) > 1024 or abs(rx) > 1024:
            return False
        return ry * ry + rx * rx <= epsilon2
    cross = dx * ry - dy * rx
    if abs(cross) > 1 << 31:
        return False
    return cross * cross <= epsilon2 * length2


@kernel("b1(i8[:,::1], i8, i8, i8, i8, i8, i8, i8)")
def holds(gap: NDArray[np.int64], a: int, b: int, ay: int, ax: int, by: int, bx: int, epsilon2: int) -> bool:
    """Whether an edge from vertex (ay, ax), which stands for corner a, to (by, bx), for corner b, is certified."""
    ty, tx = gap[TRUE_Y], gap[TRUE_X]
    ay, ax, by, bx = 16 * ay, 16 * ax, 16 * by, 16 * bx
    if (ay == by and ax == bx) or max(abs(by - ay), abs(bx - ax)) > 16 * LONGEST_EDGE_CELLS:
        return False
    if not is_near(ty[a], tx[a], ay, ax, ay, ax, epsilon2) or not is_near(ty[b], tx[b], by, bx, by, bx, epsilon2):
        return False
    for m in range(a + 1, b):
        if not is_near(ty[m], tx[m], ay, ax, by, bx, epsilon2):
            return False
    return True


@kernel("Tuple((b1, b1, f8, f8, f8, f8))(f8, f8, f8, b1, f8, f8, f8, f8)", inline="always")
def narrow(
    ry: float, rx: float, epsilon: float, bounded: bool, hy: float, hx: float, ly: float, lx: float
) -> tuple[bool, bool, float, float, float, float]:
    """Narrow a wedge of directions to those that pass a point, at (ry, rx) from its tip, within epsilon.

    The wedge lies between the directions h, counter-clockwise, and l; without being ``bounded`` it is everything.
    Returns whether anything is left, and the new wedge.
    """
    along2 = ry * ry + rx * rx - epsilon * epsilon
    if along2 <= 0.0:
        return True, bounded, hy, hx, ly, lx
    # The directions of the tangents to the disc around the point.
    along = np.sqrt(along2)
    y0, x0 = ry * along + rx * epsilon, rx * along - ry * epsilon
    y1, x1 = ry * along - rx * epsilon, rx * along + ry * epsilon
    if not bounded:
        return True, True, y0, x0, y1, x1
    if hx * y0 - hy * x0 < 0.0:
        hy, hx = y0, x0
    if lx * y1 - ly * x1 > 0.0:
        ly, lx = y1, x1
    return lx * hy - ly * hx >= 0.0, True, hy, hx, ly, lx


@kernel("b1(f8, f8, f8, f8, b1, f8, f8, f8, f8)", inline="always")
def may_lead(
    by: float, bx: float, epsilon: float, farthest2: float, bounded: bool, hy: float, hx: float, ly: float, lx: float
) -> bool:
    """Whether an edge from the wedge's tip to (by, bx), seen from there, may pass all its points (to be tested).

    ``farthest2`` is the square of the distance of the farthest of them: the edge must reach it but for epsilon.
    """
    length2 = by * by + bx * bx
    slack = 1e-9 * length2 * farthest2
    return (
        length2 > 0.0
        and (not bounded or (hx * by - hy * bx <= slack and lx * by - ly * bx >= -slack))
        and (farthest2 <= length2 or np.sqrt(length2) + epsilon >= np.sqrt(farthest2) - 1e-9)
    )


@kernel("i8(i8[:,::1], i8, f8, f8[::1], i8)")
def choose_fewest(gap: NDArray[np.int64], n: int, epsilon: float, error: NDArray[np.float64], sources: int) -> int:
    """The fewest edges from corner 0 to n - 1, and of those the nearest to the boundary; returns how many vertices.

    Dynamic programming over the corners (Imai and Iri 1988, min-#), with the wedge of all corners passed, one number
    of edges after the other. Epsilon in cells; ``error`` (n,) is room to work in. Of all vertices that take equally
    many edges, ``sources`` are gone on from, those that are farthest along; see ``SOURCES``. Fills the chain.
    """
    ty, tx, vy, vx, cost, previous = gap[TRUE_Y], gap[TRUE_X], gap[AT_Y], gap[AT_X], gap[COST], gap[PREVIOUS]
    never = np.int64(1) << 60
    cost[0] = 0
    error[0] = 0.0
    for j in range(1, n):
        cost[j] = never
    level = 0
    farthest = 0
    while cost[n - 1] == never:
        expanded = 0
        next_farthest = farthest
        i = farthest
        while i >= 0 and expanded < sources and (expanded == 0 or i > farthest - 64):
            if cost[i] != level:
                i -= 1
                continue
            expanded += 1
            ay, ax = 16 * vy[i], 16 * vx[i]
            bounded = False
            farthest2 = 0.0
            hy, hx, ly, lx = 0.0, 0.0, 0.0, 0.0
            syy, sxx, sxy = 0.0, 0.0, 0.0
            qy, qx = (ty[i] - ay) * 0.0625, (tx[i] - ax) * 0.0625
            for j in range(i + 1, n):
                by, bx = (16 * vy[j] - ay) * 0.0625, (16 * vx[j] - ax) * 0.0625
                if abs(by) > 4096.0 or abs(bx) > 4096.0:
                    break
                ry, rx = (ty[j] - ay) * 0.0625, (tx[j] - ax) * 0.0625
                # The second moments, about the tip, of the straight run from the last corner to this one.
                my, mx, sy, sx = 0.5 * (ry + qy), 0.5 * (rx + qx), ry - qy, rx - qx
                length = abs(sy) + abs(sx)
                syy += length * (my * my + sy * sy * (1 / 12))
                sxx += length * (mx * mx + sx * sx * (1 / 12))
                sxy += length * (my * mx + sy * sx * (1 / 12))
                qy, qx = ry, rx
                if cost[j] > level and may_lead(by, bx, epsilon, farthest2, bounded, hy, hx, ly, lx):
                    off = (sxx * by * by - 2.0 * sxy * bx * by + syy * bx * bx) / (by * by + bx * bx)
                    total = error[i] + max(off, 0.0)
                    if cost[j] == never or total < error[j]:
                        cost[j] = level + 1
                        error[j] = total
                        previous[j] = i
                        next_farthest = max(next_farthest, j)
                farthest2 = max(farthest2, ry * ry + rx * rx)
                alive, bounded, hy, hx, ly, lx = narrow(ry, rx, epsilon, bounded, hy, hx, ly, lx)
                if not alive:
                    break
            i -= 1
        if next_farthest == farthest:
            break  # two ends in one place
        farthest = next_farthest
        level += 1
    count = 0
    if cost[n - 1] == never:
        count = n
        for q in range(n):
            gap[CORNER, q] = q
    else:
        j = n - 1
        count = cost[j] + 1
        for q in range(count - 1, 0, -1):
            gap[CORNER, q] = j
            j = previous[j]
        gap[CORNER, 0] = 0
    for q in range(count):
        gap[PLACE_Y, q], gap[PLACE_X, q] = vy[gap[CORNER, q]], vx[gap[CORNER, q]]
    return count
