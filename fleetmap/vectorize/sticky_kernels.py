"""A numba kernel that finds which edges of the last map still hold against a new boundary."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fleetmap.vectorize.simplify_kernels import is_near

# At most so many places of the boundary are considered for one old vertex (a thin wall has two sides).
PLACES = 4


@njit(
    "void(i8[:,::1], u1[::1], i8[::1], i8[::1], i8[:,::1], u1[::1], i8[:,::1], u1[::1], u1[::1], u1[::1],"
    " i8[::1], i8[::1], i8, i8, i8, i8[:,::1], i8[::1], i8[::1])",
    cache=True,
    nogil=True,
)
def keep_edges(
    old_at: NDArray[np.int64],
    old_labels: NDArray[np.uint8],
    old_following: NDArray[np.int64],
    old_preceding: NDArray[np.int64],
    old_points: NDArray[np.int64],
    old_bends: NDArray[np.uint8],
    points: NDArray[np.int64],
    labels: NDArray[np.uint8],
    turns: NDArray[np.uint8],
    bends: NDArray[np.uint8],
    following: NDArray[np.int64],
    preceding: NDArray[np.int64],
    fy: int,
    fx: int,
    epsilon2: int,
    at: NDArray[np.int64],
    old_edge: NDArray[np.int64],
    ends: NDArray[np.int64],
) -> None:
    """Find the runs of the new boundary on which old edges hold their certificate.

    Old vertex i lies at ``old_at[i]`` and stood for a point at ``old_points[i]``; the edge that leaves it has
    ``old_labels[i]`` and leads to ``old_following[i]``. Where it is kept from point a to point b:
    ``old_edge[a]`` = i, ``ends[a]`` = b, and ``at`` is set at both. Elsewhere ``old_edge`` stays -1. ``bends``
    are the directions in which the walk enters and leaves a point: with the point, they name one passage of it.

    1. Each old vertex gets its places: a stretch of boundary within epsilon of it gives one place. That is the
       passage that it stood for, if it is still there; else, for a vertex where the label changed, the nearest
       point where it does; else the nearest point (the first of equals).
    2. An old edge holds between two places if the boundary between has its label and its certificate holds.
    3. Edges are taken in order, those first whose ends stand for what they stood for; one that would overlap
       another's run, or put a vertex in two places, is not.
    """
    size = len(points)
    count = len(old_at)
    if size == 0 or count == 0:
        return
    low_y, low_x = points[:, 0].min(), points[:, 1].min()
    height, width = points[:, 0].max() - low_y + 1, points[:, 1].max() - low_x + 1
    first_at = np.full((height, width), -1, np.int32)  # a point of the boundary on each lattice point
    next_at = np.full(size, -1, np.int32)  # and the further ones there
    for m in range(size - 1, -1, -1):
        y, x = points[m, 0] - low_y, points[m, 1] - low_x
        next_at[m] = first_at[y, x]
        first_at[y, x] = m
    reach = int(np.sqrt(float(epsilon2))) // 16 + 1

    same_place = np.full(count, -1, np.int64)  # the passage that the vertex stood for
    places_in = np.full((count, PLACES), -1, np.int64)  # where an edge that ends in the vertex may end
    places_out = np.full((count, PLACES), -1, np.int64)  # where an edge that leaves it may start
    for i in range(count):
        wy, wx = old_at[i, 0], old_at[i, 1]
        label_in, label_out = old_labels[old_preceding[i]], old_labels[i]
        found = 0
        for y in range(max(wy - reach - low_y, 0), min(wy + reach - low_y + 1, height)):
            for x in range(max(wx - reach - low_x, 0), min(wx + reach - low_x + 1, width)):
                start = first_at[y, x]
                while start >= 0:
                    ry, rx = 16 * (points[start, 0] - wy) + fy, 16 * (points[start, 1] - wx) + fx
                    p = preceding[start]
                    py, px = 16 * (points[p, 0] - wy) + fy, 16 * (points[p, 1] - wx) + fx
                    # Only from the start of a stretch, or from the first point of a loop: it may lie within
                    # epsilon altogether.
                    is_start = py * py + px * px > epsilon2
                    if ry * ry + rx * rx <= epsilon2 and (is_start or p >= start):
                        near_in, near_out, near_change = 1 << 60, 1 << 60, 1 << 60
                        m_in, m_out, m_change, m_same = -1, -1, -1, -1
                        m = start
                        distance2 = ry * ry + rx * rx
                        while distance2 <= epsilon2:
                            enters, leaves = labels[preceding[m]] == label_in, labels[m] == label_out
                            if (
                                enters
                                and leaves
                                and bends[m] == old_bends[i]
                                and (points[m, 0] == old_points[i, 0] and points[m, 1] == old_points[i, 1])
                            ):
                                m_same = m
                            if label_in == label_out and (enters or leaves):
                                enters = leaves = True
                            if enters and distance2 < near_in:
                                near_in, m_in = distance2, m
                            if leaves and distance2 < near_out:
                                near_out, m_out = distance2, m
                            if enters and leaves and label_in != label_out and distance2 < near_change:
                                near_change, m_change = distance2, m
                            m = following[m]
                            ry, rx = 16 * (points[m, 0] - wy) + fy, 16 * (points[m, 1] - wx) + fx
                            distance2 = ry * ry + rx * rx
                            if m == start:
                                is_start = True
                                break
                        if is_start:
                            if m_same >= 0:
                                same_place[i] = m_in = m_out = m_same
                            elif m_change >= 0:
                                m_in = m_out = m_change
                            if found < PLACES:
                                places_in[i, found] = m_in
                                places_out[i, found] = m_out
                                found += 1
                    start = next_at[start]

    taken = np.zeros(size, np.uint8)  # steps of the boundary that a kept edge owns
    vertex_on = np.full(size, -1, np.int64)  # the old vertex that stands for a point
    place_of = np.full(count, -1, np.int64)  # the point that an old vertex stands for
    for only_same in (True, False):
        for i in range(count):
            j = old_following[i]
            ay, ax, by, bx = 16 * old_at[i, 0], 16 * old_at[i, 1], 16 * old_at[j, 0], 16 * old_at[j, 1]
            for k in range(PLACES):
                a = same_place[i] if only_same else places_out[i, k]
                if a < 0 or old_edge[a] >= 0 or (vertex_on[a] >= 0 and vertex_on[a] != i):
                    continue
                if place_of[i] >= 0 and place_of[i] != a:
                    continue
                m = a
                kept = False
                # Walk while the certificate can still hold, until a place of the other end.
                while not taken[m] and labels[m] == old_labels[i]:
                    m = following[m]
                    if m == a:
                        break
                    is_end = m == same_place[j]
                    for n in range(PLACES):
                        is_end = is_end or (not only_same and places_in[j, n] == m)
                    if is_end and (vertex_on[m] < 0 or vertex_on[m] == j) and (place_of[j] < 0 or place_of[j] == m):
                        kept = True
                        break
                    if turns[m] and not is_near(
                        16 * points[m, 0] + fy, 16 * points[m, 1] + fx, ay, ax, by, bx, epsilon2
                    ):
                        break
                if kept:
                    old_edge[a] = i
                    ends[a] = m
                    place_of[i], place_of[j] = a, m
                    vertex_on[a], vertex_on[m] = i, j
                    at[a, 0], at[a, 1] = old_at[i, 0], old_at[i, 1]
                    at[m, 0], at[m, 1] = old_at[j, 0], old_at[j, 1]
                    while a != m:
                        taken[a] = 1
                        a = following[a]
                if kept or only_same:
                    break
