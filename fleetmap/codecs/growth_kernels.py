"""Numba kernels of payload mode 1: the added edges, walk by walk, and those with a new thickness.

One procedure writes and reads: what is read goes into the arrays that hold, when writing, what is to be written; their
lengths bound it. A context's number comes from classes with a known largest value only, whatever the bytes say.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fleetmap.codecs import mode1_layout as at
from fleetmap.codecs.chain_kernels import CLASS, DX, DY, STARTS, THICKNESS, class_of, endpoints
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
    bit,
    length_of,
    number,
    signed,
    spend,
)
from fleetmap.model.row_kernels import KEY_BITS, LIMIT

MAX_TARGETS = 64
"""Most places where a walk is expected to end; they are searched for each step."""


@njit("i8(i8[::1], i8[::1], u1[::1], i8, i8)", cache=True, nogil=True)
def _thickness(
    coder: NDArray[np.int64], probabilities: NDArray[np.int64], data: NDArray[np.uint8], context: int, value: int
) -> int:
    """A thickness: four decisions for 0 to 14, then what it is more than 15."""
    small, node = min(value, 15), 1
    for k in range(3, -1, -1):
        node = 2 * node + bit(coder, probabilities, data, context + node, small >> k & 1)
    if node < 31:
        return node - 16
    value = 15 + number(coder, probabilities, data, at.VALUE, value - 15)
    if value > 255:
        coder[STATUS] = THICK if coder[STATUS] == GOOD else coder[STATUS]
        return 0
    return value


@njit("i8(i8[::1], i8[::1], i8, i8, i8, i8)", cache=True, nogil=True)
def _nearness(ys: NDArray[np.int64], xs: NDArray[np.int64], count: int, which: int, y: int, x: int) -> int:
    """How many targets are nearer to a point than one of them is, in the order (|dy| + |dx|, y, x)."""
    own, nearer = abs(ys[which] - y) + abs(xs[which] - x), 0
    for i in range(count):
        other = abs(ys[i] - y) + abs(xs[i] - x)
        if other != own:
            nearer += 1 if other < own else 0
        elif ys[i] != ys[which]:
            nearer += 1 if ys[i] < ys[which] else 0
        elif xs[i] != xs[which]:
            nearer += 1 if xs[i] < xs[which] else 0
        else:
            nearer += 1 if i < which else 0
    return nearer


@njit("void(i8[::1], i8[::1], u1[::1], i4[:,::1], i8[::1], i8[:,::1], i8[:,::1], i8[::1], i8)", cache=True, nogil=True)
def code_walks(
    coder: NDArray[np.int64],
    probabilities: NDArray[np.int64],
    data: NDArray[np.uint8],
    removed: NDArray[np.int32],
    known: NDArray[np.int64],
    absolute: NDArray[np.int64],
    edges: NDArray[np.int64],
    counts: NDArray[np.int64],
    thick_frontiers: int,
) -> None:
    """Roots, and from each of them edges: ``counts`` holds how many known roots, absolute ones and edges there are."""
    vertices, surplus, leaving = endpoints(removed)
    mask = (1 << KEY_BITS) - 1
    # Roots at endpoints of removed edges; where more edges arrived than left, walks are expected to end.
    target_y, target_x = np.empty(MAX_TARGETS, np.int64), np.empty(MAX_TARGETS, np.int64)
    n_known = nth = targets = 0
    for v in range(len(vertices)):
        starts = 0
        while coder[MODE] != READ and nth < counts[0] and known[nth] == v:
            starts, nth = starts + 1, nth + 1
        sign = 0 if surplus[v] < 0 else 1 if surplus[v] == 0 else 2
        starts = number(coder, probabilities, data, at.WALKS + at.WIDTH * sign, starts)
        spend(coder, 1 + starts, n_known + starts)
        if coder[STATUS] != GOOD:
            return
        for _ in range(starts):
            known[n_known] = v
            n_known += 1
        for _ in range(-surplus[v]):
            if targets < MAX_TARGETS:
                target_y[targets], target_x[targets] = (vertices[v] >> KEY_BITS) - LIMIT, (vertices[v] & mask) - LIMIT
                targets += 1
    n_absolute = number(coder, probabilities, data, at.ROOTS, counts[1])
    spend(coder, n_absolute, n_known + n_absolute)
    if coder[STATUS] != GOOD:
        return
    for i in range(n_absolute):
        for k in range(2):
            absolute[i, k] = signed(coder, probabilities, data, at.ROOT, -1, absolute[i, k])
    root_y = int(removed[0, 0]) if len(removed) else 0
    root_x = int(removed[0, 1]) if len(removed) else 0
    n = 0
    thickness = 4
    for walk in range(n_known + n_absolute):
        # Before its first step a walk looks back to the removed edge that left its root.
        y = x = dy = dx = 0
        before = 6
        if walk < n_known:
            v = known[walk]
            y, x = (vertices[v] >> KEY_BITS) - LIMIT, (vertices[v] & mask) - LIMIT
            e = leaving[v]
            if e >= 0:
                label = int(removed[e, 4])
                way = 1 if label // 3 < label % 3 else -1
                dy = way * (int(removed[e, 2]) - int(removed[e, 0]))
                dx = way * (int(removed[e, 3]) - int(removed[e, 1]))
                before = 3 + class_of(label)
        else:
            root_y += absolute[walk - n_known, 0]
            root_x += absolute[walk - n_known, 1]
            y, x = root_y, root_x
        ends = 0
        while not ends:
            spend(coder, 1, n + 1)
            if coder[STATUS] == GOOD and n >= len(edges):
                coder[STATUS] = TOO_MANY
            if coder[STATUS] == GOOD and max(abs(y), abs(x)) > LIMIT:
                coder[STATUS] = FAR
            if coder[STATUS] != GOOD:
                return
            edge = edges[n]
            writing = coder[MODE] != READ
            last = 1 if writing and (n + 1 >= counts[2] or edges[n + 1, STARTS]) else 0
            context = at.CLASS + 2 * (3 * before + min(length_of(max(abs(dy), abs(dx))) // 2, 2))
            label = bit(coder, probabilities, data, context, 1 if edge[CLASS] > 0 else 0)
            if label:
                label += bit(coder, probabilities, data, context + 1, 1 if edge[CLASS] > 1 else 0)
            hit, far = -1, 1 << 30
            for i in range(targets):
                far = min(far, max(abs(target_y[i] - y), abs(target_x[i] - x)))
                if last and hit < 0 and target_y[i] - y == edge[DY] and target_x[i] - x == edge[DX]:
                    hit = i
            closes = 0
            if targets:
                closes = bit(coder, probabilities, data, at.HITS + 3 * min(length_of(far), 8) + label, int(hit >= 0))
            if closes:
                near = _nearness(target_y, target_x, targets, hit, y, x) if hit >= 0 else 0
                near = number(coder, probabilities, data, at.TARGET, near)
                if near >= targets:
                    coder[STATUS] = NO_TARGET if coder[STATUS] == GOOD else coder[STATUS]
                    return
                hit = 0
                while _nearness(target_y, target_x, targets, hit, y, x) != near:
                    hit += 1
                dy, dx = target_y[hit] - y, target_x[hit] - x
                targets -= 1
                for i in range(hit, targets):
                    target_y[i], target_x[i] = target_y[i + 1], target_x[i + 1]
                ends = 1
            else:
                kin = 1 if before == label else 2 if before == 3 + label else 3 if before < 3 else 4
                kin = 5 * label + (0 if before == 6 else kin)
                u = 1 + (1 if dy > 0 else -1 if dy < 0 else 0)
                v = 1 + (1 if dx > 0 else -1 if dx < 0 else 0)
                sign = at.SIGN_Y + 9 * kin + 3 * u + v
                dy = signed(coder, probabilities, data, at.STEP_Y + at.WIDTH * kin, sign, edge[DY])
                sign = at.SIGN_X + 27 * kin + 9 * u + 3 * v + 1 + (1 if dy > 0 else -1 if dy < 0 else 0)
                step = at.STEP_X + at.WIDTH * (7 * label + min(length_of(abs(dy)), 6))
                dx = signed(coder, probabilities, data, step, sign, edge[DX])
                ends = bit(coder, probabilities, data, at.ENDS + (1 if targets else 0), last)
            if label != 1 or thick_frontiers:
                size = min(length_of(max(abs(dy), abs(dx))) // 2, 2)
                context = 12 * (1 if label else 0) + 4 * size + min(thickness, 7) // 2
                thickness = _thickness(coder, probabilities, data, at.THICKNESS + 16 * context, edge[THICKNESS])
                edge[THICKNESS] = thickness
            else:
                edge[THICKNESS] = 0
            edge[STARTS] = 0 if before < 3 else 1
            edge[CLASS], edge[DY], edge[DX] = label, dy, dx
            y, x, before = y + dy, x + dx, label
            n += 1
    counts[0], counts[1], counts[2] = n_known, n_absolute, n


@njit("void(i8[::1], i8[::1], u1[::1], i8[:,::1], i8[::1], i8, i8)", cache=True, nogil=True)
def code_rethickened(
    coder: NDArray[np.int64],
    probabilities: NDArray[np.int64],
    data: NDArray[np.uint8],
    rethickened: NDArray[np.int64],
    counts: NDArray[np.int64],
    place: int,
    base_edges: int,
) -> None:
    """Edges with a new thickness, ``counts[3]`` of them; the first one by its way from ``place``."""
    count = number(coder, probabilities, data, at.RETHICKENED, counts[3])
    spend(coder, count, count)
    for i in range(count):
        if coder[STATUS] != GOOD:
            return
        if i == 0:
            place += signed(coder, probabilities, data, at.FIRST_GAP, -1, rethickened[0, 0] - place)
        else:
            place += 1 + number(coder, probabilities, data, at.GAP, rethickened[i, 0] - place - 1)
        if place < 0 or place >= base_edges:
            coder[STATUS] = NOT_THERE
            return
        rethickened[i, 0] = place
        rethickened[i, 1] = _thickness(coder, probabilities, data, at.THICKNESS_TO, rethickened[i, 1])
    counts[3] = count
