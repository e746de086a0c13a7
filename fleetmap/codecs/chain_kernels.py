"""Numba kernels of ``codecs.fields``: edges as walks, and back.

Every edge is walked with the lesser label, so that free space lies to the left and the walks run around it. A vertex is
a key: (y + 2^20) 2^22 + x + 2^20.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.band_kernels import canonical_rows
from fleetmap.model.kernel import kernel
from fleetmap.model.row_kernels import FAR, GOOD, KEY_BITS, LIMIT, THERE
from fleetmap.model.sort_kernels import lower_bound, order_of

DY, DX, CLASS, STARTS, THICKNESS = range(5)
"""Columns of ``DeltaFields.edges``."""


@kernel("i8(i8, i8)")
def vertex_key(y: int, x: int) -> int:
    """A vertex as one number, ascending like (y, x)."""
    return (y + LIMIT) << KEY_BITS | (x + LIMIT)


@kernel("i8(i8)")
def class_of(label: int) -> int:
    """Of a label of either direction: 0 free and occupied, 1 free and unknown, 2 occupied and unknown."""
    return label // 3 + label % 3 - 1


@kernel("Tuple((i8[::1], i8[::1], i8[::1]))(i4[:,::1])")
def endpoints(edges: NDArray[np.int32]) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Take the vertices of some edges, (n, 5), ascending, each once.

    Returns their keys; how many more edges leave each than arrive, as walked; the first edge that leaves it, or -1.
    """
    n = len(edges)
    keys = np.empty(2 * n, np.int64)
    for i in range(n):
        keys[2 * i] = vertex_key(int(edges[i, 0]), int(edges[i, 1]))
        keys[2 * i + 1] = vertex_key(int(edges[i, 2]), int(edges[i, 3]))
    order = order_of(keys)
    vertices, surplus, leaving = np.empty(2 * n, np.int64), np.zeros(2 * n, np.int64), np.full(2 * n, -1)
    count = 0
    for at in order:
        if count == 0 or keys[at] != vertices[count - 1]:
            vertices[count] = keys[at]
            count += 1
        label = int(edges[at // 2, 4])
        forwards = label // 3 < label % 3
        if forwards == (at % 2 == 0):
            surplus[count - 1] += 1
            if leaving[count - 1] < 0:  # equal keys keep their order
                leaving[count - 1] = at // 2
        else:
            surplus[count - 1] -= 1
    return vertices[:count], surplus[:count], leaving[:count]


@kernel("Tuple((i8[::1], i8[:,::1], i8[:,::1], i8))(i4[:,::1], i4[:,::1], u1[::1])")
def find_walks(
    removed: NDArray[np.int32], added: NDArray[np.int32], thickness: NDArray[np.uint8]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], int]:
    """Cover each added edge, (n, 5), by one walk; returns the fields of ``DeltaFields`` from known_roots on.

    A walk goes on as long as an unused edge leaves its last vertex, if it can by one of the same label. Walks start
    where more edges leave than arrive, then wherever unused edges remain, endpoints of removed edges first and
    each group in ascending order: the same edges give the same walks.
    """
    n = len(added)
    start, end, label = np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n, np.int64)
    for i in range(n):
        a = vertex_key(int(added[i, 0]), int(added[i, 1]))
        b = vertex_key(int(added[i, 2]), int(added[i, 3]))
        side = int(added[i, 4])
        label[i] = class_of(side)
        start[i], end[i] = (a, b) if side // 3 < side % 3 else (b, a)
    # The edges that leave a vertex stand together, by label and then by their end.
    order = order_of(start)
    for i in range(1, n):
        j, e = i, order[i]
        while (
            j > 0
            and start[order[j - 1]] == start[e]
            and (label[order[j - 1]] > label[e] or (label[order[j - 1]] == label[e] and end[order[j - 1]] > end[e]))
        ):
            order[j] = order[j - 1]
            j -= 1
        order[j] = e
    vertices, first = np.empty(n, np.int64), np.empty(n + 1, np.int64)
    count = 0
    for i in range(n):
        if i == 0 or start[order[i]] != vertices[count - 1]:
            vertices[count] = start[order[i]]
            first[count] = i
            count += 1
    first[count] = n
    known, _, _ = endpoints(removed)
    surplus, left, rank = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count, np.int64)
    for v in range(count):
        surplus[v] = left[v] = first[v + 1] - first[v]
        at = lower_bound(known, 0, len(known), vertices[v])
        rank[v] = at if at < len(known) and known[at] == vertices[v] else -1
    leads = np.empty(n, np.int64)
    for i in range(n):
        at = lower_bound(vertices, 0, count, end[i])
        leads[i] = at if at < count and vertices[at] == end[i] else -1
        if leads[i] >= 0:
            surplus[leads[i]] -= 1

    used = np.zeros(n, np.uint8)
    walked, roots, begins = np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n + 1, np.int64)
    walks = at = 0
    for stage in range(4):
        tails, of_removed = stage < 2, stage % 2 == 0
        for root in range(count):
            if (rank[root] >= 0) != of_removed or (tails and surplus[root] <= 0):
                continue
            while left[root] > 0:
                roots[walks] = root
                begins[walks] = at
                walks += 1
                v, same = root, -1
                while v >= 0 and left[v] > 0:
                    pick = -1
                    for k in range(first[v], first[v + 1]):
                        if used[k] == 0 and label[order[k]] == same:
                            pick = k
                            break
                        if used[k] == 0 and pick < 0:
                            pick = k
                    used[pick] = 1
                    left[v] -= 1
                    walked[at] = order[pick]
                    same = label[order[pick]]
                    v = leads[order[pick]]
                    at += 1
                if tails:
                    surplus[root] -= 1
                    if surplus[root] <= 0:
                        break
    begins[walks] = n

    keys = np.empty(walks, np.int64)
    n_known = 0
    for w in range(walks):
        unknown = rank[roots[w]] < 0
        keys[w] = vertices[roots[w]] + (1 << 2 * KEY_BITS if unknown else 0)
        n_known += 0 if unknown else 1
    known_roots, absolute = np.empty(n_known, np.int64), np.empty((walks - n_known, 2), np.int64)
    edges = np.empty((n, 5), np.int64)
    y = int(removed[0, 0]) if len(removed) else 0
    x = int(removed[0, 1]) if len(removed) else 0
    at = thick_frontiers = 0
    for nth, w in enumerate(order_of(keys)):
        key = vertices[roots[w]]
        if nth < n_known:
            known_roots[nth] = rank[roots[w]]
        else:
            to_y, to_x = (key >> KEY_BITS) - LIMIT, (key & ((1 << KEY_BITS) - 1)) - LIMIT
            absolute[nth - n_known, 0], absolute[nth - n_known, 1] = to_y - y, to_x - x
            y, x = to_y, to_x
        for k in range(begins[w], begins[w + 1]):
            e = walked[k]
            back = start[e] > end[e]
            edges[at, DY] = int(added[e, 2]) - int(added[e, 0])
            edges[at, DX] = int(added[e, 3]) - int(added[e, 1])
            if back:
                edges[at, DY], edges[at, DX] = -edges[at, DY], -edges[at, DX]
            edges[at, CLASS] = label[e]
            edges[at, STARTS] = 1 if k == begins[w] else 0
            edges[at, THICKNESS] = thickness[e]
            if label[e] == 1 and thickness[e] > 0:
                thick_frontiers = 1
            at += 1
    return known_roots, absolute, edges, thick_frontiers


@kernel("Tuple((i8, i4[:,::1]))(i4[:,::1], i8[::1], i8[:,::1], i8[:,::1])")
def lay_edges(
    removed: NDArray[np.int32], known_roots: NDArray[np.int64], absolute: NDArray[np.int64], edges: NDArray[np.int64]
) -> tuple[int, NDArray[np.int32]]:
    """What ``find_walks`` took apart: (GOOD, the added rows, (n, 6), in canonical order).

    The caller has checked that there is a root for each walk, that the first edge starts one, that known roots are
    ranks of endpoints of removed edges, and that no step is longer than 2^35.
    """
    known, _, _ = endpoints(removed)
    rows, thickness = np.empty((len(edges), 5), np.int64), np.empty(len(edges), np.int64)
    y = x = walks = 0
    root_y = int(removed[0, 0]) if len(removed) else 0
    root_x = int(removed[0, 1]) if len(removed) else 0
    for i in range(len(edges)):
        if edges[i, STARTS]:
            if walks < len(known_roots):
                key = known[known_roots[walks]]
                y, x = (key >> KEY_BITS) - LIMIT, (key & ((1 << KEY_BITS) - 1)) - LIMIT
            else:
                root_y += absolute[walks - len(known_roots), 0]
                root_x += absolute[walks - len(known_roots), 1]
                y, x = root_y, root_x
            walks += 1
        to_y, to_x = y + edges[i, DY], x + edges[i, DX]
        if max(abs(y), abs(x), abs(to_y), abs(to_x)) > LIMIT:
            return FAR, np.empty((0, 6), np.int32)
        rows[i, 0], rows[i, 1], rows[i, 2], rows[i, 3] = y, x, to_y, to_x
        rows[i, 4] = 1 if edges[i, CLASS] == 0 else 2 if edges[i, CLASS] == 1 else 5
        thickness[i] = edges[i, THICKNESS]
        y, x = to_y, to_x
    found, result = canonical_rows(rows, thickness)
    if found == GOOD and len(result) < len(edges):
        return THERE, result
    return found, result
