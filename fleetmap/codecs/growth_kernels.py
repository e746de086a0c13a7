"""Numba kernels of payload mode 1: the added edges, walk by walk, and those with a new thickness.

One procedure writes and reads: what is read goes into the arrays that hold, when writing, what is to be written; their
lengths bound it. A context's number comes from classes with a known largest value only, whatever the bytes say.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.codecs import mode1_layout as at
from fleetmap.codecs.chain_kernels import CLASS, DX, DY, STARTS, THICKNESS, class_of, endpoints
from fleetmap.codecs.contexts import UNARY
from fleetmap.codecs.range_kernels import (
    FAR,
    GOOD,
    MODE,
    NO_TARGET,
    NOT_THERE,
    READ,
    STATUS,
    THICK,
    TOO_MANY,
    amount,
    even,
    length_of,
    signed,
    spend,
    told,
)
from fleetmap.codecs.step_kernels import FIELDS, ONE, QUADRANT, code_step, in_frame, look_back
from fleetmap.model.kernel import kernel
from fleetmap.model.row_kernels import KEY_BITS, LIMIT

MAX_TARGETS = 32
"""Most places where walks are expected to end; they are looked through for each step."""


@kernel("i8(i8[::1], i8[::1], u1[::1], i8, i8)")
def _thickness(
    coder: NDArray[np.int64], memory: NDArray[np.int64], data: NDArray[np.uint8], context: int, value: int
) -> int:
    """A thickness: five decisions for 0 to 30, then what it is more than 31."""
    small, node = min(value, 31), 1
    for k in range(4, -1, -1):
        node = 2 * node + told(coder, memory, data, context + node, small >> k & 1)
    if node < 63:
        return node - 32
    value = 31 + amount(coder, memory, data, at.VALUE, at.LOWER, -1, value - 31)
    if value > 255:
        coder[STATUS] = THICK if coder[STATUS] == GOOD else coder[STATUS]
        return 0
    return value


@kernel("i8(i8[::1], i8[::1], u1[::1], i8[::1], i8[::1], i8[::1])")
def _known_roots(
    coder: NDArray[np.int64],
    memory: NDArray[np.int64],
    data: NDArray[np.uint8],
    surplus: NDArray[np.int64],
    known: NDArray[np.int64],
    counts: NDArray[np.int64],
) -> int:
    """How many walks start at each endpoint of removed edges; returns how many in all."""
    n = nth = 0
    for v in range(len(surplus)):
        starts = 0
        while coder[MODE] != READ and nth < counts[0] and known[nth] == v:
            starts, nth = starts + 1, nth + 1
        sign = 0 if surplus[v] < 0 else 1 if surplus[v] == 0 else 2
        starts = amount(coder, memory, data, at.WALKS + UNARY * sign, at.LOWER, -1, starts)
        spend(coder, 1 + starts, n + starts)
        if coder[STATUS] != GOOD:
            return 0
        for _ in range(starts):
            known[n] = v
            n += 1
    return n


@kernel("i8(i8[::1], i8[::1], u1[::1], i8[:,::1], i8, i8, i8, i8)")
def _absolute_roots(
    coder: NDArray[np.int64],
    memory: NDArray[np.int64],
    data: NDArray[np.uint8],
    roots: NDArray[np.int64],
    count: int,
    known: int,
    y: int,
    x: int,
) -> int:
    """Places of roots, ascending, row by row in a box whose lower left corner is told from (y, x); their count."""
    count = amount(coder, memory, data, at.ROOTS, at.LOWER, -1, count)
    spend(coder, count, known + count)
    if coder[STATUS] == GOOD and count > len(roots):
        coder[STATUS] = TOO_MANY
    if coder[STATUS] != GOOD or count == 0:
        return 0
    low_y, low_x, width = np.int64(0), np.int64(0), np.int64(0)
    if coder[MODE] != READ:
        low_y, low_x = roots[0, 0], roots[:count, 1].min()
        width = roots[:count, 1].max() - low_x
    y += signed(coder, memory, data, at.LEAST, at.LOWER, low_y - y)
    low_x = x + signed(coder, memory, data, at.LEAST, at.LOWER, low_x - x)
    bits = length_of(amount(coder, memory, data, at.WIDTH, at.LOWER, -1, width))
    for i in range(count):
        y += amount(coder, memory, data, at.ROW, at.LOWER, -1, roots[i, 0] - y)
        x = np.int64(0)
        for k in range(bits - 1, -1, -1):
            x = 2 * x + even(coder, data, (roots[i, 1] - low_x) >> k & 1)
        x += low_x
        if coder[STATUS] == GOOD and max(abs(y), abs(x)) > LIMIT:
            coder[STATUS] = FAR
        if coder[STATUS] != GOOD:
            return 0
        roots[i, 0], roots[i, 1] = y, x
    return count


@kernel("i8(i8, i8, i8)")
def _kind_of_way(dy: int, dx: int, quadrant: int) -> int:
    """Of the way to a target: 0 along an axis, 4 slanting, else by its quadrant: 1 across, 2 ahead, 3 back."""
    off = min(abs(dy), abs(dx))
    if off == 0 or off > 2:
        return 4 if off else 0
    turn = (in_frame(dy, dx)[0] - quadrant) & 3
    return 1 if turn & 1 else 2 if turn == 0 else 3


@kernel(
    "i8(i8[::1], i8[::1], u1[::1], i8[:,::1], i8[::1], i8, i8, i8, i8, i8, i8, i8, i8, i8)",
    inline="always",
)
def _code_target(
    coder: NDArray[np.int64],
    memory: NDArray[np.int64],
    data: NDArray[np.uint8],
    targets: NDArray[np.int64],
    near: NDArray[np.int64],
    count: int,
    own: int,
    y: int,
    x: int,
    quadrant: int,
    i: int,
    label: int,
    to_y: int,
    to_x: int,
) -> int:
    """Which of the first ``count`` targets the i-th edge of a walk leads to, and ends; -1: to none, as it mostly is.

    ``near`` is scratch; ``own`` is the place among them of the walk's root, or -1; (y, x) where the edge starts,
    (to_y, to_x) where it ends if the walk does, else (y, x).
    """
    nearest = wanted = -1
    for t in range(count):
        near[t] = (abs(targets[t, 0] - y) + abs(targets[t, 1] - x)) << 6 | t
        if near[t] < 64:
            continue  # it is here
        if nearest < 0 or near[t] < near[nearest]:
            nearest = t
        if wanted < 0 and targets[t, 0] == to_y and targets[t, 1] == to_x:
            wanted = t
    if nearest < 0:
        return -1
    way_y, way_x = targets[nearest, 0] - y, targets[nearest, 1] - x
    far = min(length_of(max(abs(way_y), abs(way_x))), 11)
    context = (5 * far + _kind_of_way(way_y, way_x, quadrant)) * 5 + (min(i, 4) if nearest == own else 0)
    if not told(coder, memory, data, at.HITS + 3 * context + label, int(wanted >= 0)):
        return -1
    rank = 0
    for t in range(count):
        rank += 1 if wanted >= 0 and near[t] < near[wanted] else 0
    if count > 1:
        rank = amount(coder, memory, data, at.TARGET, at.LOWER, -1, rank)
    if rank >= count:
        coder[STATUS] = NO_TARGET if coder[STATUS] == GOOD else coder[STATUS]
        return -1
    return np.sort(near[:count])[rank] & 63


@kernel("void(i8[::1], i8[::1], u1[::1], i8[:,::1], i8, i8, i8, i8)")
def _walk_thickness(
    coder: NDArray[np.int64],
    memory: NDArray[np.int64],
    data: NDArray[np.uint8],
    edges: NDArray[np.int64],
    first: int,
    end: int,
    thickness: int,
    thick_frontiers: int,
) -> None:
    """Thickness of the edges of a walk, now that its shape is known: islands have that of their size.

    ``thickness`` is that of the edge to which the walk looks back, or -1.
    """
    y = x = low_y = low_x = high_y = high_x = area = np.int64(0)
    for k in range(first, end):
        area += x * (y + edges[k, DY]) - y * (x + edges[k, DX])
        y, x = y + edges[k, DY], x + edges[k, DX]
        low_y, high_y, low_x, high_x = min(low_y, y), max(high_y, y), min(low_x, x), max(high_x, x)
    island = 1 if y == 0 and x == 0 and area <= 0 else 0
    size = min(min(high_y - low_y, high_x - low_x), 7)
    has_one = beside = 0
    for k in range(first, end):
        if edges[k, CLASS] == 1 and not thick_frontiers:
            edges[k, THICKNESS] = 0
            beside = 0
            continue
        same = 0
        if thickness >= 0:
            context = at.SAME + 2 * (beside if has_one else 2) + island
            same = told(coder, memory, data, context, int(edges[k, THICKNESS] == thickness))
        if not same:
            shape = 2 + size if island else min(edges[k, CLASS], 1)
            thickness = _thickness(coder, memory, data, at.THICKNESS + 32 * shape, edges[k, THICKNESS])
        edges[k, THICKNESS] = thickness
        has_one = beside = 1


@kernel(
    "void(i8[::1], i8[::1], u1[::1], i4[:,::1], i8[::1], i8[::1], i8[:,::1], i8[:,::1], i8[::1], i8)",
)
def code_walks(
    coder: NDArray[np.int64],
    memory: NDArray[np.int64],
    data: NDArray[np.uint8],
    removed: NDArray[np.int32],
    removed_thickness: NDArray[np.int64],
    known: NDArray[np.int64],
    roots: NDArray[np.int64],
    edges: NDArray[np.int64],
    counts: NDArray[np.int64],
    thick_frontiers: int,
) -> None:
    """Roots, and from each of them edges: ``counts`` holds how many known roots, absolute ones and edges there are."""
    vertices, surplus, leaving = endpoints(removed)
    mask = (1 << KEY_BITS) - 1
    n_known = _known_roots(coder, memory, data, surplus, known, counts)
    low_y = int(removed[0, 0]) if len(removed) else 0
    low_x = int(removed[0, 1]) if len(removed) else 0
    n_roots = _absolute_roots(coder, memory, data, roots, counts[1], n_known, low_y, low_x)
    # Where more edges arrived than left, walks are expected to end.
    targets, count = np.empty((MAX_TARGETS + 1, 2), np.int64), 0
    for v in range(len(vertices)):
        for _ in range(-surplus[v]):
            if count < MAX_TARGETS:
                targets[count, 0], targets[count, 1] = (vertices[v] >> KEY_BITS) - LIMIT, (vertices[v] & mask) - LIMIT
                count += 1
    state, near = np.empty(FIELDS, np.int64), np.empty(MAX_TARGETS + 1, np.int64)
    triangle = was_triangle = np.int64(0)
    n = 0
    for walk in range(n_known + n_roots):
        # Before its first step a walk looks back to the removed edge that left its root.
        dy = dx = np.int64(0)
        before, run, thickness, may_close = 6, 0, -1, 1
        if walk < n_known:
            v = known[walk]
            root_y, root_x = (vertices[v] >> KEY_BITS) - LIMIT, (vertices[v] & mask) - LIMIT
            e = leaving[v]
            if e >= 0:
                label = int(removed[e, 4])
                way = 1 if label // 3 < label % 3 else -1
                dy = way * (int(removed[e, 2]) - int(removed[e, 0]))
                dx = way * (int(removed[e, 3]) - int(removed[e, 1]))
                before = 3 + class_of(label)
                if before != 4:
                    thickness = removed_thickness[e]
            may_close = 1 if surplus[v] <= 0 else 0
        else:
            root_y, root_x = roots[walk - n_known, 0], roots[walk - n_known, 1]
        look_back(state, dy, dx)
        first = n
        triangle = 0
        if may_close:
            targets[count, 0], targets[count, 1] = root_y, root_x
            count += 1
            third = first + 3
            if coder[MODE] != READ and third <= counts[2] and (third == counts[2] or edges[third, STARTS]):
                triangle = 0 if edges[first + 1, STARTS] or edges[first + 2, STARTS] else 1
                triangle &= 0 if edges[first:third, DY].sum() or edges[first:third, DX].sum() else 1
            triangle = told(coder, memory, data, at.TRIANGLE + was_triangle, triangle)
            was_triangle = triangle
        y, x = root_y, root_x
        ends = 0
        while not ends:
            i = n - first
            spend(coder, 1, n + 1)
            if coder[STATUS] == GOOD and n >= len(edges):
                coder[STATUS] = TOO_MANY
            if coder[STATUS] == GOOD and max(abs(y), abs(x)) > LIMIT:
                coder[STATUS] = FAR
            if coder[STATUS] != GOOD:
                return
            edge = edges[n]
            last = 1 if coder[MODE] != READ and (n + 1 >= counts[2] or edges[n + 1, STARTS]) else 0
            context = 2 * ((before * 4 + min(run, 3)) * 6 + min(length_of(state[ONE]), 5))
            if triangle:
                context = 2 * (7 * 4 * 6 + 7 * i + before)
            label = told(coder, memory, data, at.CLASS + context, 1 if edge[CLASS] > 0 else 0)
            if label:
                label += told(coder, memory, data, at.CLASS + context + 1, 1 if edge[CLASS] > 1 else 0)
            own = count - 1 if may_close else -1
            if triangle:
                hit = own if i == 2 else -1
            else:
                to_y, to_x = (y + edge[DY], x + edge[DX]) if last else (y, x)
                hit = _code_target(
                    coder, memory, data, targets, near, count, own, y, x, state[QUADRANT], i, label, to_y, to_x
                )
            if hit >= 0:
                dy, dx = targets[hit, 0] - y, targets[hit, 1] - x
                for t in range(hit, count - 1):
                    targets[t] = targets[t + 1]
                count -= 1 if hit == own else 1 + may_close  # the own root goes with its walk
                ends = 1
            else:
                follows = before == 3 + label
                group = 3 + i if triangle else 5 + label if follows else label
                expected = state[ONE] if follows else 0
                dy, dx = code_step(coder, memory, data, at.STEP, group, state, expected, edge[DY], edge[DX])
                if not triangle:
                    context = at.ENDS + 2 * may_close + (1 if count > may_close else 0)
                    ends = told(coder, memory, data, context, last)
                    count -= ends * may_close
            edge[STARTS] = 1 if i == 0 else 0
            edge[CLASS], edge[DY], edge[DX] = label, dy, dx
            run = run + 1 if label == before else 0
            y, x, before = y + dy, x + dx, label
            n += 1
        _walk_thickness(coder, memory, data, edges, first, n, thickness, thick_frontiers)
    counts[0], counts[1], counts[2] = n_known, n_roots, n


@kernel("void(i8[::1], i8[::1], u1[::1], i8[:,::1], i8[::1], i8, i8)")
def code_rethickened(
    coder: NDArray[np.int64],
    memory: NDArray[np.int64],
    data: NDArray[np.uint8],
    rethickened: NDArray[np.int64],
    counts: NDArray[np.int64],
    place: int,
    base_edges: int,
) -> None:
    """Edges with a new thickness, ``counts[3]`` of them; the first one by its way from ``place``."""
    count = amount(coder, memory, data, at.RETHICKENED, at.LOWER, -1, counts[3])
    spend(coder, count, count)
    for i in range(count):
        if coder[STATUS] != GOOD:
            return
        if i == 0:
            place += signed(coder, memory, data, at.FIRST_GAP, at.LOWER, rethickened[0, 0] - place)
        else:
            place += 1 + amount(coder, memory, data, at.GAP, at.LOWER, -1, rethickened[i, 0] - place - 1)
        if place < 0 or place >= base_edges:
            coder[STATUS] = NOT_THERE
            return
        rethickened[i, 0] = place
        rethickened[i, 1] = _thickness(coder, memory, data, at.THICKNESS_TO, rethickened[i, 1])
    counts[3] = count
