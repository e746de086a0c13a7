"""Drawn walls have no holes: against slow twins in rationals, and by flood fill of closed rooms."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rooms import FOUR, is_shut, make_room
from scipy import ndimage
from test_model_raster import arrangement, slow_states

from fleetmap.merge import fold
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN
from fleetmap.model.raster import merged_states
from fleetmap.vectorize import rasterize, vectorize

EPSILON = Fraction(1, 10**6)


def crosses(a, b, edge):
    """Whether the open segments a to b and edge meet, by orientations; both ends of a to b are on no edge."""

    def side(p, q, r):
        return (q[1] - p[1]) * (r[0] - p[0]) - (q[0] - p[0]) * (r[1] - p[1])

    p, q = edge[:2], edge[2:]
    return side(p, q, a) * side(p, q, b) < 0 and side(a, b, p) * side(a, b, q) < 0


def broken_steps(rows, step, low_yx, states):
    """Steps between unblocked neighbours that cross a wall; centres are a little off, as the kernel says."""
    height, width = states.shape
    walls = [row[:4] for row in rows if row[6]]

    def centre(i, j):
        return (low_yx[0] + i + Fraction(1, 2)) * step + EPSILON**2, (low_yx[1] + j + Fraction(1, 2)) * step + EPSILON

    for i in range(height):
        for j in range(width):
            for k, m in ((i + 1, j), (i, j + 1)):
                if k == height or m == width or OCCUPIED in (states[i, j], states[k, m]):
                    continue
                if any(crosses(centre(i, j), centre(k, m), edge) for edge in walls):
                    yield (i, j), (k, m)


def length_inside(edge, low, high):
    """The share of an edge that lies in the open box from ``low`` to ``high``, both (y, x)."""
    first, last = Fraction(0), Fraction(1)
    for axis in range(2):
        start, delta = edge[axis], edge[axis + 2] - edge[axis]
        if delta == 0:
            if not low[axis] < start < high[axis]:
                return Fraction(0)
            continue
        ends = sorted(Fraction(bound - start) / delta for bound in (low[axis], high[axis]))
        first, last = max(first, ends[0]), min(last, ends[1])
    return max(last - first, Fraction(0))


def passed_but_open(rows, step, low_yx, states):
    """Cells that a wall passes through, neither blocked nor the next one on the blocking side."""
    height, width = states.shape

    def blocked(i, j):
        return 0 <= i < height and 0 <= j < width and states[i, j] == OCCUPIED

    for y0, x0, y1, x1, left, right, obstacle, _ in rows:
        if not obstacle:
            continue
        dy, dx = y1 - y0, x1 - x0
        both = (left == FREE) == (right == FREE)
        # The normal that points to the blocking side; an edge is moved there by a trifle.
        ny, nx = (dx, -dy) if left != FREE else (-dx, dy)
        shift = EPSILON / (abs(dy) + abs(dx))
        edge = (y0 + ny * shift, x0 + nx * shift, y1 + ny * shift, x1 + nx * shift)
        other = (y0 - ny * shift, x0 - nx * shift, y1 - ny * shift, x1 - nx * shift)
        along_border = (dy == 0 and y0 % step == 0) or (dx == 0 and x0 % step == 0)
        for i in range(height):
            for j in range(width):
                low = ((low_yx[0] + i) * step, (low_yx[1] + j) * step)
                if length_inside(edge, low, (low[0] + step, low[1] + step)) < Fraction(1, 1000):
                    continue
                sign_y, sign_x = (ny > 0) - (ny < 0), (nx > 0) - (nx < 0)
                if blocked(i, j):
                    continue
                behind = (blocked(i - sign_y, j) if dx else blocked(i, j - sign_x)) if along_border else False
                if not both:
                    along_y, along_x = blocked(i + sign_y, j), blocked(i, j + sign_x)
                    if (abs(ny) >= abs(nx) and along_y) or (abs(nx) >= abs(ny) and along_x):
                        continue
                elif behind or (not along_border and length_inside(other, low, (low[0] + step, low[1] + step)) == 0):
                    continue
                yield i, j


@settings(max_examples=40, deadline=None)
@given(arrangement(), st.booleans())
def test_no_step_between_unblocked_cells_crosses_a_wall(rows, fine):
    step = 3 if fine else 8
    states, low_yx = merged_states(np.array(rows, np.int32).reshape(-1, 8), step)
    assert not list(broken_steps(rows, step, low_yx, states))


@settings(max_examples=40, deadline=None)
@given(arrangement(), st.booleans())
def test_a_wall_blocks_each_cell_that_it_passes_through_or_the_next(rows, fine):
    step = 3 if fine else 8
    states, low_yx = merged_states(np.array(rows, np.int32).reshape(-1, 8), step)
    assert not list(passed_but_open(rows, step, low_yx, states))


@settings(max_examples=40, deadline=None)
@given(arrangement(), st.booleans())
def test_what_is_sealed_holds_a_point_of_a_wall(rows, fine):
    """So that a gap loses sqrt(2) cells on each side at most."""
    step = 3 if fine else 8
    states, low_yx = merged_states(np.array(rows, np.int32).reshape(-1, 8), step)
    sealed = (states == OCCUPIED) & (slow_states(rows, step, low_yx, states.shape) != OCCUPIED)
    for i, j in np.argwhere(sealed).tolist():
        low = ((low_yx[0] + i) * step - EPSILON, (low_yx[1] + j) * step - EPSILON)
        high = (low[0] + step + 2 * EPSILON, low[1] + step + 2 * EPSILON)
        # In two of its walls, or between two that are nearer to each other than a cell.
        near = [
            row for row in rows if row[6] and length_inside(row[:4], [v - step for v in low], [v + step for v in high])
        ]
        assert near
        assert len(near) > 1 or length_inside(near[0][:4], low, high) > 0


def test_a_wall_that_runs_out_like_a_wedge_keeps_all_of_its_rows():
    states = np.full((27, 27), FREE, np.uint8)
    for row, column in enumerate((0, 1, 0, 0, 0, 0, 1)):
        states[10 + row, 12 + column] = OCCUPIED
    grid = OccupancyGrid.from_states(states, 0.05)
    drawn = rasterize(vectorize(grid), like=grid).states_yx()
    assert (drawn == OCCUPIED).any(axis=1).nonzero()[0].tolist()[-7:] == list(range(10, 17))


@pytest.mark.parametrize("length", [5, 20, 33, 100])
@pytest.mark.parametrize("profile", ["share", "full"])
def test_a_wall_before_a_strip_of_unknown_keeps_its_length(length, profile):
    states = np.full((20, length + 20), FREE, np.uint8)
    states[10, 10 : 10 + length] = OCCUPIED
    states[9, 10 : 10 + length] = UNKNOWN
    grid = OccupancyGrid.from_states(states, 0.05)
    drawn = rasterize(vectorize(grid, profile=profile), like=grid).states_yx()
    assert (drawn == OCCUPIED).any(axis=0)[10 : 10 + length].all()


@pytest.mark.parametrize("profile", ["share", "full"])
def test_a_partition_with_a_step_in_every_tenth_column_lets_no_disc_through(profile):
    states = np.full((60, 120), FREE, np.uint8)
    rows = 30 + np.arange(120) // 10 % 2
    states[rows, np.arange(120)] = OCCUPIED
    states[[0, -1]] = states[:, [0, -1]] = OCCUPIED
    grid = OccupancyGrid.from_states(states, 0.05)
    drawn = rasterize(vectorize(grid, profile=profile), like=grid).states_yx()
    rooms, _ = ndimage.label(drawn != OCCUPIED, FOUR)
    assert rooms[15, 60] != rooms[45, 60]


@pytest.mark.parametrize("kind", ["straight", "stepped", "slanting"])
@pytest.mark.parametrize("profile", ["share", "full"])
def test_closed_rooms_stay_closed_at_every_resolution(kind, profile):
    for seed in range(12):
        room = make_room(np.random.default_rng(seed), kind)
        for source, grid in zip(room.sources(profile), room.grids, strict=True):
            drawn = rasterize(source.vector_map, like=grid)
            assert is_shut(drawn, room.outline, source.T_fleet_frame.to_pose()), (seed, source.frame)
        merged = fold(room.sources(profile))
        for resolution_m in (0.025, 0.05, 0.1):
            assert is_shut(merged.to_grid(resolution_m), room.outline), (seed, resolution_m)
