"""The grid loops against slow twins."""

from __future__ import annotations

import heapq
import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import ndimage

from fleetmap.sims.space_kernels import (
    FAR,
    clearance2,
    cost_field,
    dearest_on_line,
    descend,
    frontier_cells,
    overlay,
    prices,
    viewpoint,
)

prices_yx = arrays(np.uint8, (11, 13), elements=st.sampled_from([0, 0, 1, 1, 1, 4, 12]))


@given(arrays(bool, (12, 15), elements=st.sampled_from([False] * 6 + [True])), st.integers(1, 5))
@settings(max_examples=40, deadline=None)
def test_clearance_is_the_distance_to_the_nearest_blocked_square(blocked, reach: int) -> None:
    found = clearance2(blocked, reach)
    squares = np.argwhere(blocked)
    for i, j in np.ndindex(blocked.shape):
        near = np.abs(squares - (i, j))
        near = near[(near <= reach).all(axis=1)]
        exact = (np.maximum(2 * near - 1, 0) ** 2).sum(axis=1).min(initial=4 * reach * reach + 1)
        assert found[i, j] == exact


def steps(price, i: int, j: int):
    height, width = price.shape
    for di, dj in itertools.product((-1, 0, 1), repeat=2):
        y, x = i + di, j + dj
        if (di or dj) and 0 <= y < height and 0 <= x < width and price[y, x]:
            if di and dj and not (price[i, x] and price[y, j]):
                continue
            yield y, x, (14 if di and dj else 10) * int(price[y, x])


def dijkstra(price, start):
    cost = np.full(price.shape, FAR, np.int64)
    cost[start] = 0
    queue = [(0, start)]
    while queue:
        now, (i, j) = heapq.heappop(queue)
        if now > cost[i, j]:
            continue
        for y, x, step in steps(price, i, j):
            if now + step < cost[y, x]:
                cost[y, x] = now + step
                heapq.heappush(queue, (now + step, (y, x)))
    return cost


@given(prices_yx, st.integers(0, 10), st.integers(0, 12))
@settings(max_examples=80, deadline=None)
def test_costs_are_those_of_dijkstra_and_a_path_pays_exactly_its_cost(price, row: int, column: int) -> None:
    cost = cost_field(price, row, column)
    assert (cost == dijkstra(price, (row, column))).all()
    for i, j in np.argwhere(cost < FAR)[::7]:
        path = descend(cost, price, int(i), int(j))
        assert path[0].tolist() == [row, column]
        assert path[-1].tolist() == [i, j]
        paid = 0
        for (y, x), (v, u) in itertools.pairwise(path.tolist()):
            paid += next(step for a, b, step in steps(price, y, x) if (a, b) == (v, u))
        assert paid == cost[i, j]


@given(prices_yx, st.integers(0, 10), st.integers(0, 12), st.integers(0, 10), st.integers(0, 12))
@settings(max_examples=150, deadline=None)
def test_a_line_pays_the_dearest_of_all_cells_that_it_touches(price, i: int, j: int, k: int, m: int) -> None:
    # Every cell whose closed square the segment between the centres meets in more than its outer corner.
    touched = set()
    count = 4 * 11 * 13
    for step in range(count + 1):
        y, x = i + (k - i) * step / count, j + (m - j) * step / count
        touched.add((int(np.floor(y + 0.5)), int(np.floor(x + 0.5))))
    got = dearest_on_line(price, i, j, k, m)
    sampled = [int(price[c]) for c in touched if c[0] < 11 and c[1] < 13]
    if got < 255:
        assert got >= max(v for c, v in zip(touched, sampled, strict=True) if inside(c, (i, j), (k, m)))
        assert price[i, j]
        assert price[k, m]
    else:
        low, high = np.minimum((i, j), (k, m)), np.maximum((i, j), (k, m))
        assert (price[low[0] : high[0] + 1, low[1] : high[1] + 1] == 0).any()
    assert got == dearest_on_line(price, k, m, i, j)


def inside(cell, a, b) -> bool:
    """Whether the segment between two centres passes the open square of a cell (exact, in doubled integers)."""
    (i, j), (k, m) = a, b
    sides = [
        (2 * m - 2 * j) * (y - 2 * i) - (2 * k - 2 * i) * (x - 2 * j)
        for y, x in itertools.product((2 * cell[0] - 1, 2 * cell[0] + 1), (2 * cell[1] - 1, 2 * cell[1] + 1))
    ]
    return min(sides) < 0 < max(sides) or a == b


@given(arrays(np.uint8, (12, 15), elements=st.sampled_from([0, 0, 1, 2, 2])), st.integers(1, 12))
@settings(max_examples=80, deadline=None)
def test_frontiers_are_free_cells_beside_large_unknown_regions(states, least: int) -> None:
    labels, _ = ndimage.label(states == 2)
    large = (np.bincount(labels.ravel()) >= least)[labels] & (states == 2)
    beside = ndimage.binary_dilation(large) & (states == 0)
    assert frontier_cells(states, least).tolist() == np.argwhere(beside).tolist()


def test_prices_come_from_clearance_and_only_free_cells_have_one() -> None:
    states = np.array([[0, 0, 0, 1, 2]], np.uint8)
    clearance = np.array([[9, 5, 1, 0, 9]], np.int32)
    found = prices(states, clearance, np.array([2, 6], np.int64), np.array([4, 1], np.uint8))
    assert found.tolist() == [[1, 4, 0, 0, 0]]


@pytest.mark.parametrize("turns", [0, 1, 2, 3])
def test_an_overlay_in_a_turned_frame_writes_what_is_known_and_nothing_else(turns: int) -> None:
    rng = np.random.default_rng(turns)
    own = rng.integers(0, 3, (8, 8)).astype(np.uint8)
    states = np.full((8, 8), 7, np.uint8)
    cos, sin = [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)][turns]
    # Turned about the middle, whatever the turn.
    overlay(states, -4, -4, own, -4, -4, cos, sin, 0.0, 0.0)
    expected = own
    for _ in range(turns):
        expected = expected.T[:, ::-1]  # y up: row i, column j goes to row j, column -i
    assert (states[expected != 2] == expected[expected != 2]).all()
    assert (states[expected == 2] == 7).all()


def test_a_viewpoint_is_reachable_and_sees_the_place() -> None:
    open_cells = np.ones((9, 9), np.uint8)
    open_cells[4, :7] = 0
    price = open_cells.copy()
    cost = cost_field(price, 0, 0)
    cost[3:] = FAR  # as if the robot were too wide for the rest
    assert viewpoint(cost, open_cells, 6, 0, 5).tolist() == [-1, -1]
    row, column = viewpoint(cost, open_cells, 6, 8, 5).tolist()
    assert cost[row, column] < FAR
    assert dearest_on_line(open_cells, row, column, 6, 8) == 1
