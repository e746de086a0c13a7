"""Numba kernels of the verifier about faces: edges that meet badly, what is around each face, cells in faces.

Bits: |coordinate| <= 2^20 cells or 2^25 units, so that differences are at most 2^26, cross products 2^53.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.kernel import kernel
from fleetmap.vectorize.verify_near_kernels import look_up, make_index, side

BLOCK_ROWS = 16
"""Edges are looked up by blocks of so many rows when one asks what lies west of a vertex."""


@kernel("b1(i8, i8, i8, i8, i8, i8)")
def is_inside(ay: int, ax: int, by: int, bx: int, py: int, px: int) -> bool:
    """Whether p, on the line through a and b, lies between them and is neither."""
    in_box = min(ay, by) <= py <= max(ay, by) and min(ax, bx) <= px <= max(ax, bx)
    return in_box and not (py == ay and px == ax) and not (py == by and px == bx)


@kernel("i8[:,::1](i8[:,::1])")
def find_bad_meetings(edges: NDArray[np.int64]) -> NDArray[np.int64]:
    """Find pairs of edges, y0 <= y1, that share more than an end, (m, 2) indices i < j, ascending by j; exact."""
    n = len(edges)
    frame, first, items = make_index(edges, 0)
    seen = np.full(n, -1, np.int64)
    found = np.empty(n, np.int64)
    pairs = np.empty((16, 2), np.int64)
    count = 0
    for j in range(n):
        py, px, qy, qx = edges[j]
        for k in range(look_up(frame, first, items, py, px, qy, qx, j, seen, found)):
            i = found[k]
            if i >= j:
                continue
            ay, ax, by, bx = edges[i]
            if by < py or qy < ay or max(ax, bx) < min(px, qx) or max(px, qx) < min(ax, bx):
                continue
            a, b = side(py, px, qy, qx, ay, ax), side(py, px, qy, qx, by, bx)
            p, q = side(ay, ax, by, bx, py, px), side(ay, ax, by, bx, qy, qx)
            if (
                (a * b < 0 and p * q < 0)
                or (ay == py and ax == px and by == qy and bx == qx)
                or (a == 0 and is_inside(py, px, qy, qx, ay, ax))
                or (b == 0 and is_inside(py, px, qy, qx, by, bx))
                or (p == 0 and is_inside(ay, ax, by, bx, py, px))
                or (q == 0 and is_inside(ay, ax, by, bx, qy, qx))
            ):
                if count == len(pairs):
                    longer = np.empty((2 * count, 2), np.int64)
                    longer[:count] = pairs
                    pairs = longer
                pairs[count, 0], pairs[count, 1] = i, j
                count += 1
    return pairs[:count].copy()


@kernel("i8(i8[::1], i8)")
def root_of(parent: NDArray[np.int64], k: int) -> int:
    """Root of k's set."""
    while parent[k] != k:
        parent[k] = parent[parent[k]]
        k = parent[k]
    return k


@kernel("void(i8[::1], i8, i8)")
def join(parent: NDArray[np.int64], a: int, b: int) -> None:
    """Make one set of two."""
    a, b = root_of(parent, a), root_of(parent, b)
    parent[max(a, b)] = min(a, b)


@kernel("i8(i8[:,::1], i8[::1], i8, i8, i8)")
def first_to_the_west(edges: NDArray[np.int64], block: NDArray[np.int64], low_y: int, y: int, x: int) -> int:
    """The edge of row y's block that one meets first when one goes west from (y, x), just above it; or -1.

    ``block`` holds the first place of each block's edges, and then the edges.
    """
    best = -1
    best_whole, best_rest, best_dy, best_dx = 0, 0, 1, 0
    b = (y - low_y) // BLOCK_ROWS
    for k in range(block[b], block[b + 1]):
        e = block[k]
        y0, x0, y1, x1 = edges[e]
        if y0 > y or y1 <= y:
            continue
        dy, dx = y1 - y0, x1 - x0
        west = (x - x0) * dy - (y - y0) * dx  # the way to the edge is west / dy
        if west <= 0:
            continue
        whole, rest = west // dy, west % dy
        nearer = best < 0 or whole < best_whole
        if not nearer and whole == best_whole:
            # The fractions differ by rest / dy, and where two start at one vertex the slopes decide.
            difference = rest * best_dy - best_rest * dy
            nearer = difference < 0 or (difference == 0 and dx * best_dy > best_dx * dy)
        if nearer:
            best, best_whole, best_rest, best_dy, best_dx = e, whole, rest, dy, dx
    return best


@kernel("i8[::1](i8[:,::1], i8[::1])")
def join_faces(edges: NDArray[np.int64], order: NDArray[np.int64]) -> NDArray[np.int64]:
    """(2 n + 1,) the set that the face left of each half-edge belongs to; the last one is the unbounded face.

    Half-edge 2 e runs along edge e, 2 e + 1 back. ``order``: half-edges by the vertex that they leave, and there
    by direction, counter-clockwise from the west.
    """
    n = len(edges)
    outside = 2 * n
    face = np.arange(2 * n + 1)
    part = np.arange(2 * n)
    for e in range(n):
        join(part, 2 * e, 2 * e + 1)
    # 1. Whoever comes back along a half-edge leaves by the next one clockwise, and keeps the face to the left.
    start = 0
    while start < 2 * n:
        h = order[start]
        y, x = edges[h >> 1, 2 * (h & 1)], edges[h >> 1, 2 * (h & 1) + 1]
        end = start + 1
        while end < 2 * n:
            g = order[end]
            if edges[g >> 1, 2 * (g & 1)] != y or edges[g >> 1, 2 * (g & 1) + 1] != x:
                break
            join(part, g, h)
            end += 1
        for k in range(start, end):
            join(face, order[k] ^ 1, order[k - 1] if k > start else order[end - 1])
        start = end

    # 2. The leftmost vertex of each part, of those the lowest: its first half-edge.
    leftmost = np.full(2 * n, -1, np.int64)
    for h in order:
        r = root_of(part, h)
        if leftmost[r] >= 0:
            e, k = leftmost[r] >> 1, 2 * (leftmost[r] & 1)
            x, best_x = edges[h >> 1, 2 * (h & 1) + 1], edges[e, k + 1]
            if x > best_x or (x == best_x and edges[h >> 1, 2 * (h & 1)] >= edges[e, k]):
                continue
        leftmost[r] = h

    # 3. Around it, the half-edge before the lowest direction has the space to the west.
    low_y, high_y = edges[:, 0].min(), edges[:, 2].max()
    blocks = (high_y - low_y) // BLOCK_ROWS + 1
    size = np.zeros(blocks + 1, np.int64)
    for e in range(n):
        for b in range((edges[e, 0] - low_y) // BLOCK_ROWS, (edges[e, 2] - low_y) // BLOCK_ROWS + 1):
            size[b + 1] += 1
    block = np.empty(blocks + 1 + size.sum(), np.int64)
    block[: blocks + 1] = np.cumsum(size) + blocks + 1
    fill = block[:blocks].copy()
    for e in range(n):
        for b in range((edges[e, 0] - low_y) // BLOCK_ROWS, (edges[e, 2] - low_y) // BLOCK_ROWS + 1):
            block[fill[b]] = e
            fill[b] += 1
    for h in leftmost:
        if h >= 0:
            met = first_to_the_west(edges, block, low_y, edges[h >> 1, 2 * (h & 1)], edges[h >> 1, 2 * (h & 1) + 1])
            join(face, int(h) ^ 1, outside if met < 0 else 2 * met + 1)
    for k in range(2 * n + 1):
        face[k] = root_of(face, k)
    return face


@kernel("i8[::1](i8[:,::1], i8)")
def join_all(links: NDArray[np.int64], size: int) -> NDArray[np.int64]:
    """(size,) the least number that each number is connected to by pairs of numbers, (n, 2)."""
    parent = np.arange(size)
    for k in range(len(links)):
        join(parent, links[k, 0], links[k, 1])
    for k in range(size):
        parent[k] = root_of(parent, k)
    return parent


@kernel("i8[::1](i8[:,::1], i8[::1], i8, i8)")
def match_faces(pairs: NDArray[np.int64], order: NDArray[np.int64], components: int, faces: int) -> NDArray[np.int64]:
    """(components,) a face of its own for as many as possible, else -1; who is earlier in ``order`` goes first.

    ``pairs`` are the (component, face) allowed, by component, and for each one those first that suit it best. A
    component that has a face keeps one when others look for theirs (augmenting paths).
    """
    first = np.zeros(components + 1, np.int64)
    for k in range(len(pairs)):
        first[pairs[k, 0] + 1] += 1
    first[:] = np.cumsum(first)
    matched = np.full(components, -1, np.int64)
    owner = np.full(faces, -1, np.int64)
    asked_by = np.full(faces, -1, np.int64)  # of the component that the search came from
    seen = np.full(faces, -1, np.int64)
    queue = np.empty(components, np.int64)
    for start in order:
        queue[0] = start
        size, head, end = 1, 0, -1
        while head < size and end < 0:
            c = queue[head]
            head += 1
            for k in range(first[c], first[c + 1]):
                f = pairs[k, 1]
                if seen[f] == start:
                    continue
                seen[f] = start
                asked_by[f] = c
                if owner[f] < 0:
                    end = f
                    break
                queue[size] = owner[f]
                size += 1
        while end >= 0:
            c = asked_by[end]
            owner[end] = c
            end, matched[c] = matched[c], end
    return matched
