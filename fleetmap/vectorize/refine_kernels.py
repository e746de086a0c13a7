"""Numba kernels that better a chosen chain: one vertex for two where that holds, then each vertex where it fits best.

Gaps and their chains as in ``fewest_kernels``; the first and last vertex of a chain stay.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.kernel import kernel
from fleetmap.vectorize.fewest_kernels import (
    AT_X,
    AT_Y,
    CORNER,
    PLACE_X,
    PLACE_Y,
    TRUE_X,
    TRUE_Y,
    holds,
    may_lead,
    narrow,
)

WORTH = 8.0
"""An edge saved may add so much to the sum of squared distances, in cells cubed: it is a long strip that loses more
than it saves, when one of its ends is cut off slantwise."""


@kernel("void(i8[:,::1], i8, f8[:,::1])")
def sum_moments(gap: NDArray[np.int64], n: int, moments: NDArray[np.float64]) -> None:
    """Fill (n, 6): length, and moments y, x, yy, xx, yx, of the boundary from corner 0 to each; in cells from it."""
    ty, tx = gap[TRUE_Y], gap[TRUE_X]
    length, sy, sx, syy, sxx, syx = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    ay, ax = 0.0, 0.0
    for q in range(n):
        by, bx = (ty[q] - ty[0]) * 0.0625, (tx[q] - tx[0]) * 0.0625
        dy, dx, my, mx = by - ay, bx - ax, 0.5 * (ay + by), 0.5 * (ax + bx)
        step = abs(dy) + abs(dx)
        length += step
        sy += step * my
        sx += step * mx
        syy += step * (my * my + dy * dy * (1 / 12))
        sxx += step * (mx * mx + dx * dx * (1 / 12))
        syx += step * (my * mx + dy * dx * (1 / 12))
        moments[q, 0], moments[q, 1], moments[q, 2] = length, sy, sx
        moments[q, 3], moments[q, 4], moments[q, 5] = syy, sxx, syx
        ay, ax = by, bx


@kernel("Tuple((f8, f8, f8))(f8[:,::1], i8, i8, f8, f8)", inline="always")
def moments_about(moments: NDArray[np.float64], a: int, b: int, y: float, x: float) -> tuple[float, float, float]:
    """Second moments yy, xx, yx about (y, x), in cells from corner 0, of the boundary from corner a to corner b."""
    length = moments[b, 0] - moments[a, 0]
    sy, sx = moments[b, 1] - moments[a, 1], moments[b, 2] - moments[a, 2]
    return (
        moments[b, 3] - moments[a, 3] - 2.0 * y * sy + y * y * length,
        moments[b, 4] - moments[a, 4] - 2.0 * x * sx + x * x * length,
        moments[b, 5] - moments[a, 5] - y * sx - x * sy + y * x * length,
    )


@kernel("f8(f8[:,::1], i8, i8, f8, f8, f8, f8)", inline="always")
def error_of(moments: NDArray[np.float64], a: int, b: int, ay: float, ax: float, by: float, bx: float) -> float:
    """Sum of squared distances of the boundary from corner a to b from the line through (ay, ax) and (by, bx)."""
    yy, xx, yx = moments_about(moments, a, b, ay, ax)
    dy, dx = by - ay, bx - ax
    length2 = dy * dy + dx * dx
    if length2 == 0.0:
        return yy + xx
    return max((xx * dy * dy - 2.0 * yx * dy * dx + yy * dx * dx) / length2, 0.0)


@kernel("b1(u1[:,::1], i8, i8, i8[:,::1], i8, i8, i8, i8)")
def may_stand(
    cracks: NDArray[np.uint8], oy: int, ox: int, gap: NDArray[np.int64], n: int, m: int, y: int, x: int
) -> bool:
    """Whether a vertex for corner m may stand at (y, x): there is no boundary, or it is the one beside the corner.

    Elsewhere on the boundary it would touch another arc, or soon be in the way of one.
    """
    if cracks[y - oy, x - ox] & 15 == 0:
        return True
    vy, vx = gap[AT_Y], gap[AT_X]
    for q in range(max(m - 1, 0), min(m + 1, n - 1)):
        if min(vy[q], vy[q + 1]) <= y <= max(vy[q], vy[q + 1]) and min(vx[q], vx[q + 1]) <= x <= max(vx[q], vx[q + 1]):
            return True
    return False


@kernel("i8(u1[:,::1], i8, i8, i8[:,::1], i8, f8[:,::1], i8, f8, i8, i8, f8[:,::1])")
def merge_vertices(
    cracks: NDArray[np.uint8],
    oy: int,
    ox: int,
    gap: NDArray[np.int64],
    n: int,
    moments: NDArray[np.float64],
    epsilon2: int,
    epsilon: float,
    k: int,
    least: int,
    wedges: NDArray[np.float64],
) -> int:
    """Put one vertex, anywhere on the lattice within epsilon of a corner, in the place of two where that holds.

    Takes a chain of k vertices and returns its new number of vertices, at least ``least``. ``wedges`` (n, 6) is room
    to work in.
    """
    ty, tx, corner, wy, wx = gap[TRUE_Y], gap[TRUE_X], gap[CORNER], gap[PLACE_Y], gap[PLACE_X]
    zy, zx = ty[0] * 0.0625, tx[0] * 0.0625
    t = 0
    while t + 3 < k and k > least:
        a, d = corner[t], corner[t + 3]
        ay, ax, dy, dx = wy[t] * 1.0, wx[t] * 1.0, wy[t + 3] * 1.0, wx[t + 3] * 1.0
        # The wedge, seen from the last of four vertices, of what lies behind each corner, as far as there is one.
        alive, bounded, hy, hx, ly, lx, farthest2 = True, False, 0.0, 0.0, 0.0, 0.0, 0.0
        first = d
        while alive and first > a + 1:
            first -= 1
            wedges[first, 0], wedges[first, 1], wedges[first, 2], wedges[first, 3] = hy, hx, ly, lx
            wedges[first, 4], wedges[first, 5] = 1.0 if bounded else 0.0, farthest2
            ry, rx = ty[first] * 0.0625 - dy, tx[first] * 0.0625 - dx
            farthest2 = max(farthest2, ry * ry + rx * rx)
            alive, bounded, hy, hx, ly, lx = narrow(ry, rx, epsilon, bounded, hy, hx, ly, lx)
        # And from the first one, of what lies before each.
        best = -1.0
        best_corner, best_y, best_x = np.int64(-1), np.int64(0), np.int64(0)
        alive, bounded, hy, hx, ly, lx, farthest2 = True, False, 0.0, 0.0, 0.0, 0.0, 0.0
        m = a
        while alive and m < d - 1:
            m += 1
            if m >= first:
                if best < 0.0:
                    best = WORTH
                    for q in range(3):
                        best += error_of(
                            moments, corner[t + q], corner[t + q + 1],
                            wy[t + q] - zy, wx[t + q] - zx, wy[t + q + 1] - zy, wx[t + q + 1] - zx,
                        )  # fmt: skip
                cy, cx = (ty[m] + 8) >> 4, (tx[m] + 8) >> 4
                for y in range(cy - 1, cy + 2):
                    for x in range(cx - 1, cx + 2):
                        if not may_lead(y - ay, x - ax, epsilon, farthest2, bounded, hy, hx, ly, lx) or not may_lead(
                            y - dy, x - dx, epsilon, wedges[m, 5], wedges[m, 4] > 0.0,
                            wedges[m, 0], wedges[m, 1], wedges[m, 2], wedges[m, 3],
                        ):  # fmt: skip
                            continue
                        error = error_of(moments, a, m, ay - zy, ax - zx, y - zy, x - zx)
                        error += error_of(moments, m, d, dy - zy, dx - zx, y - zy, x - zx)
                        if (
                            error < best
                            and may_stand(cracks, oy, ox, gap, n, m, y, x)
                            and holds(gap, a, m, wy[t], wx[t], y, x, epsilon2)
                            and holds(gap, m, d, y, x, wy[t + 3], wx[t + 3], epsilon2)
                        ):
                            best = error
                            best_corner, best_y, best_x = m, y, x
            ry, rx = ty[m] * 0.0625 - ay, tx[m] * 0.0625 - ax
            farthest2 = max(farthest2, ry * ry + rx * rx)
            alive, bounded, hy, hx, ly, lx = narrow(ry, rx, epsilon, bounded, hy, hx, ly, lx)
        if best_corner < 0:
            t += 1
            continue
        corner[t + 1], wy[t + 1], wx[t + 1] = best_corner, best_y, best_x
        for q in range(t + 2, k - 1):
            corner[q], wy[q], wx[q] = corner[q + 1], wy[q + 1], wx[q + 1]
        k -= 1
        t = max(t - 1, 0)
    return k


@kernel("i8(u1[:,::1], i8, i8, i8[:,::1], i8, f8[:,::1], i8, i8)")
def refit_vertices(
    cracks: NDArray[np.uint8],
    oy: int,
    ox: int,
    gap: NDArray[np.int64],
    n: int,
    moments: NDArray[np.float64],
    epsilon2: int,
    k: int,
) -> int:
    """Move each inner vertex to the lattice point where its two edges fit the boundary best; returns how many moved.

    Least squares for small moves, then the lattice points around the optimum; a move is made only if it lessens the
    true error and both edges hold.
    """
    ty, tx, corner, wy, wx = gap[TRUE_Y], gap[TRUE_X], gap[CORNER], gap[PLACE_Y], gap[PLACE_X]
    moved = 0
    zy, zx = ty[0] * 0.0625, tx[0] * 0.0625
    for t in range(1, k - 1):
        a, m, b = corner[t - 1], corner[t], corner[t + 1]
        ay, ax, by, bx = wy[t - 1] - zy, wx[t - 1] - zx, wy[t + 1] - zy, wx[t + 1] - zx
        y, x = wy[t] - zy, wx[t] - zx
        # Moving by (u, v) changes the distance of a point, a share s along an edge, by s times the move across it.
        hyy, hyx, hxx, gy, gx = 0.0, 0.0, 0.0, 0.0, 0.0
        now = 0.0
        for side in range(2):
            cy, cx, low, high = (ay, ax, a, m) if side == 0 else (by, bx, m, b)
            yy, xx, yx = moments_about(moments, low, high, cy, cx)
            dy, dx = y - cy, x - cx
            length2 = dy * dy + dx * dx
            if length2 == 0.0:  # a vertex that must stay lies where this corner does
                now += yy + xx
                continue
            along2 = (yy * dy * dy + 2.0 * yx * dy * dx + xx * dx * dx) / (length2 * length2)  # sum of s^2
            across = (yy * dy * dx - yx * (dy * dy - dx * dx) - xx * dy * dx) / (length2 * np.sqrt(length2))  # s e
            now += max((xx * dy * dy - 2.0 * yx * dy * dx + yy * dx * dx) / length2, 0.0)
            length = np.sqrt(length2)
            ny, nx = dx / length, -dy / length
            hyy += along2 * ny * ny
            hyx += along2 * ny * nx
            hxx += along2 * nx * nx
            gy += across * ny
            gx += across * nx
        damp = 0.02 * (hyy + hxx) + 1e-9
        hyy += damp
        hxx += damp
        det = hyy * hxx - hyx * hyx
        u, v = (hxx * gy - hyx * gx) / det, (hyy * gx - hyx * gy) / det
        u, v = min(max(u, -2.0), 2.0), min(max(v, -2.0), 2.0)
        base_y, base_x = int(np.floor(wy[t] + u)), int(np.floor(wx[t] + v))
        best = now * (1.0 - 1e-9) - 1e-9
        for y1 in range(base_y, base_y + 2):
            for x1 in range(base_x, base_x + 2):
                if y1 == wy[t] and x1 == wx[t]:
                    continue
                error = error_of(moments, a, m, ay, ax, y1 - zy, x1 - zx)
                if error >= best:
                    continue
                error += error_of(moments, m, b, by, bx, y1 - zy, x1 - zx)
                if (
                    error < best
                    and may_stand(cracks, oy, ox, gap, n, m, y1, x1)
                    and holds(gap, a, m, wy[t - 1], wx[t - 1], y1, x1, epsilon2)
                    and holds(gap, m, b, y1, x1, wy[t + 1], wx[t + 1], epsilon2)
                ):
                    best = error
                    wy[t], wx[t] = y1, x1
                    moved += 1
    return moved
