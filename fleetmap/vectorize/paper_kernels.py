"""Numba kernels of ``vectorize.paper_method``: the paper's graph of occupied cells, and its greedy shortcuts.

Points are cell centres, as whole cells (y, x) of the grid. Vertices are numbered in row-major order, and each
one's neighbours are kept in that order too, so that every step is determined by the grid alone.

Bits: |coordinate| < 2^20 cells, and epsilon2 (the square of epsilon, in sixteenths of a square cell) <= 2^8. So
squared lengths are <= 2^41, and epsilon2 times one <= 2^49. ``stays_near`` has limits of its own.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.kernel import kernel

READING_B, READING_C, MENDED = 0, 1, 2

LONGEST_EDGE_CELLS = 1024
"""No edge of ``mended`` is longer along x or y, so that ``stays_near`` fits 64 bits."""


@kernel("b1(i8, i8, i8, i8, i8, i8, i8)", inline="always")
def is_near(py: int, px: int, ay: int, ax: int, by: int, bx: int, epsilon2: int) -> bool:
    """Whether point p is at most epsilon away from the segment from a to b."""
    dy, dx = by - ay, bx - ax
    ry, rx = py - ay, px - ax
    along = dy * ry + dx * rx
    length2 = dy * dy + dx * dx
    if along <= 0:
        return 16 * (ry * ry + rx * rx) <= epsilon2
    if along >= length2:
        ry, rx = py - by, px - bx
        return 16 * (ry * ry + rx * rx) <= epsilon2
    cross = dx * ry - dy * rx
    # A larger one is too far, since epsilon2 * length2 / 16 <= 2^45, and its square might not fit.
    if abs(cross) > 1 << 23:
        return False
    return 16 * cross * cross <= epsilon2 * length2


@kernel("b1(i8, i8, i8)", inline="always")
def is_at_most(d: int, k: int, m: int) -> bool:
    """Whether d <= sqrt(k) + sqrt(m); 0 <= k, m <= 2^29."""
    if d <= 0:
        return True
    if d >= 1 << 16:
        return False
    rest = d * d - k - m
    return rest <= 0 or rest * rest <= 4 * k * m


@kernel("b1(i8, i8, i8)", inline="always")
def is_farther(d: int, k: int, m: int) -> bool:
    """Whether d + sqrt(k) > sqrt(m); 0 <= k, m <= 2^29, |d| <= 2^17."""
    if d >= 0:
        rest = m - d * d - k
        return rest < 0 or rest * rest < 4 * d * d * k
    rest = k - d * d - m
    return rest > 0 and rest * rest > 4 * d * d * m


@kernel("b1(u1[:,::1], i8, i8, i8, i8, i8)")
def stays_near(solid: NDArray[np.uint8], ay: int, ax: int, by: int, bx: int, epsilon2: int) -> bool:
    """Whether every point of the segment from a to b is at most epsilon away from the centre of a ``solid`` cell.

    Exact. Counted from a in steps of 1 / (4 length), a centre covers the segment from M - sqrt(K) to M + sqrt(K),
    where M = 4 * dot product and K = 16 * (epsilon^2 * length^2 - cross product^2). The walk keeps the end
    M + sqrt(K) of what is covered, and looks for a centre that covers this end and reaches farther.

    Bits: the segment is at most 2^10 cells along either axis, so length2 <= 2^21, K <= 2^8 * 2^21 = 2^29. All
    centres that cover the end are within epsilon + 1 <= 5 cells of it, so the M of two of them differ by at most
    4 * 2 * 5 * 2^10.5 < 2^16; K * K * 4 <= 2^60.
    """
    height, width = solid.shape
    dy, dx = by - ay, bx - ax
    length2 = dy * dy + dx * dx
    epsilon = np.sqrt(epsilon2 / 16.0)
    window = int(epsilon + 0.5 + 1e-6)
    step_y, step_x = (1 if dy >= 0 else -1), (1 if dx >= 0 else -1)
    end, end_k = 0, 0
    while not is_at_most(4 * length2 - end, end_k, 0):
        # A float only says around which cell to look; the margin of the window is far above its rounding.
        share = (end + np.sqrt(float(end_k))) / (4.0 * length2)
        y, x = int(np.rint(ay + share * dy)), int(np.rint(ax + share * dx))
        found = False
        for i in range(window, -window - 1, -1):
            cy = y + i * step_y
            if cy < 0 or cy >= height:
                continue
            for j in range(window, -window - 1, -1):
                cx = x + j * step_x
                if cx < 0 or cx >= width or solid[cy, cx] == 0:
                    continue
                ry, rx = cy - ay, cx - ax
                cross = dx * ry - dy * rx
                k = epsilon2 * length2 - 16 * cross * cross
                middle = 4 * (dy * ry + dx * rx)
                if k >= 0 and is_at_most(middle - end, k, end_k) and is_farther(middle - end, k, end_k):
                    end, end_k = middle, k
                    found = True
                    break
            if found:
                break
        if not found:
            return False
    return True


@kernel("i8(i4[::1], i8, i8, i8)", inline="always")
def find(neighbour: NDArray[np.int32], start: int, degree: int, v: int) -> int:
    """Slot of neighbour v, or, if it is none, the slot where it belongs as -1 - slot."""
    for slot in range(start, start + degree):
        if neighbour[slot] >= v:
            return slot if neighbour[slot] == v else -1 - slot
    return -1 - start - degree


@kernel("void(i4[::1], i4[::1], i8[::1], i4[::1], i8, i8)", inline="always")
def cut(
    neighbour: NDArray[np.int32],
    edge: NDArray[np.int32],
    start: NDArray[np.int64],
    degree: NDArray[np.int32],
    v: int,
    w: int,
) -> None:
    """Take w out of v's neighbours."""
    slot = find(neighbour, start[v], degree[v], w)
    for s in range(slot, start[v] + degree[v] - 1):
        neighbour[s], edge[s] = neighbour[s + 1], edge[s + 1]
    degree[v] -= 1


@kernel("void(i4[::1], i4[::1], i8[::1], i4[::1], i8, i8, i8)", inline="always")
def tie(
    neighbour: NDArray[np.int32],
    edge: NDArray[np.int32],
    start: NDArray[np.int64],
    degree: NDArray[np.int32],
    v: int,
    w: int,
    e: int,
) -> None:
    """Put w among v's neighbours, by edge e; there is room, since v has just lost one."""
    slot = -1 - find(neighbour, start[v], degree[v], w)
    for s in range(start[v] + degree[v], slot, -1):
        neighbour[s], edge[s] = neighbour[s - 1], edge[s - 1]
    neighbour[slot], edge[slot] = w, e
    degree[v] += 1


@kernel("Tuple((i8[::1], i4[::1]))(i4[:,::1], i8[:,::1], i8[:,::1])")
def link_cells(
    vertex_of: NDArray[np.int32], points: NDArray[np.int64], offsets: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Find each vertex's neighbours: those at one of the ``offsets`` (dy, dx), which are in row-major order.

    ``vertex_of`` (height, width) holds the vertex at each cell, -1 for none. Returns the first slot of each
    vertex, (n + 1,), and the neighbours, (slots,).
    """
    height, width = vertex_of.shape
    n = len(points)
    start = np.zeros(n + 1, np.int64)
    neighbour = np.empty(0, np.int32)
    for filling in range(2):
        slot = 0
        for v in range(n):
            for k in range(len(offsets)):
                y, x = points[v, 0] + offsets[k, 0], points[v, 1] + offsets[k, 1]
                if 0 <= y < height and 0 <= x < width and vertex_of[y, x] >= 0:
                    if filling:
                        neighbour[slot] = vertex_of[y, x]
                    slot += 1
            start[v + 1] = slot
        if not filling:
            neighbour = np.empty(slot, np.int32)
    return start, neighbour


@kernel("i8[:,::1](i8[:,::1], i8[::1], i4[::1], u1[:,::1], i8, i8)")
def shorten(
    points: NDArray[np.int64],
    start: NDArray[np.int64],
    neighbour: NDArray[np.int32],
    solid: NDArray[np.uint8],
    epsilon2: int,
    reading: int,
) -> NDArray[np.int64]:
    """Replace pairs of edges (v1, v2), (v2, v3) by (v1, v3) until no pair is left that allows it.

    Vertices take turns in row-major order, again and again; of a vertex's pairs of neighbours, in the order of
    (v1, v3), the first is taken that allows it. ``neighbour`` is used up. Returns the edges, (m, 2) vertices.

    A vertex never gets more neighbours than it had, so that the slots of the start suffice: v1 and v3 lose v2
    before they get each other.
    """
    n = len(points)
    degree = np.empty(n, np.int32)
    edge = np.empty(len(neighbour), np.int32)
    edges = 0
    for v in range(n):
        degree[v] = start[v + 1] - start[v]
        for slot in range(start[v], start[v + 1]):
            w = neighbour[slot]
            if w > v:
                edge[slot] = edges
                edges += 1
            else:
                edge[slot] = edge[find(neighbour, start[w], start[w + 1] - start[w], v)]
    # The removed points that an edge stands for: a chain from first[edge] by following to last[edge].
    first = np.full(edges, -1, np.int32)
    last = np.full(edges, -1, np.int32)
    following = np.full(n, -1, np.int32)
    # Whether a vertex has got an edge since its pairs were tried. Nothing else makes a refused pair legal: what
    # an edge stands for only grows.
    waiting = np.ones(n, np.uint8)

    changed = True
    while changed:
        changed = False
        for v in range(n):
            if not waiting[v]:
                continue
            waiting[v] = 0
            again = True
            while again:
                again = False
                for p in range(start[v], start[v] + degree[v] - 1):
                    for q in range(p + 1, start[v] + degree[v]):
                        a, b = neighbour[p], neighbour[q]
                        ay, ax, by, bx = points[a, 0], points[a, 1], points[b, 0], points[b, 1]
                        if not is_near(points[v, 0], points[v, 1], ay, ax, by, bx, epsilon2):
                            continue
                        e, f = edge[p], edge[q]
                        if reading == MENDED:
                            legal = abs(by - ay) <= LONGEST_EDGE_CELLS and abs(bx - ax) <= LONGEST_EDGE_CELLS
                            for part in range(2):
                                u = first[e] if part == 0 else first[f]
                                while legal and u >= 0:
                                    legal = is_near(points[u, 0], points[u, 1], ay, ax, by, bx, epsilon2)
                                    u = following[u]
                            if not legal or not stays_near(solid, ay, ax, by, bx, epsilon2):
                                continue
                        if reading == READING_B:
                            for slot in range(start[v], start[v] + degree[v]):
                                cut(neighbour, edge, start, degree, neighbour[slot], v)
                            degree[v] = 0
                        else:
                            for c in (a, b):
                                cut(neighbour, edge, start, degree, c, v)
                                cut(neighbour, edge, start, degree, v, c)
                        # All that e and f stood for, and v if it is gone, hangs on one edge now.
                        if first[f] >= 0:
                            if first[e] < 0:
                                first[e] = first[f]
                            else:
                                following[last[e]] = first[f]
                            last[e] = last[f]
                        if degree[v] == 0:
                            following[v] = first[e]
                            if first[e] < 0:
                                last[e] = v
                            first[e] = v
                        slot = find(neighbour, start[a], degree[a], b)
                        if slot < 0:
                            tie(neighbour, edge, start, degree, a, b, e)
                            tie(neighbour, edge, start, degree, b, a, e)
                            waiting[a] = waiting[b] = 1
                        elif first[e] >= 0:
                            g = edge[slot]
                            following[last[e]] = first[g]
                            if first[g] < 0:
                                last[g] = last[e]
                            first[g] = first[e]
                        changed = True
                        again = degree[v] > 1
                        break
                    else:
                        continue
                    break

    count = 0
    for v in range(n):
        count += degree[v]
    found = np.empty((count // 2, 2), np.int64)
    count = 0
    for v in range(n):
        for slot in range(start[v], start[v] + degree[v]):
            if neighbour[slot] > v:
                found[count, 0], found[count, 1] = v, neighbour[slot]
                count += 1
    return found
