"""The survey's kernels against slow twins: beams counted cell by cell, cells in sight, and the tour."""

import math

import numpy as np
import pytest

from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN
from fleetmap.paper.survey import decide
from fleetmap.paper.survey_kernels import count_beams, look_around
from fleetmap.paper.tour import one_a_square
from fleetmap.paper.tour_kernels import nearest_first

RNG_SEEDS = range(4)


def bresenham(start, end):
    """Cells (i, j) of the line, the textbook way."""
    (i, j), cells = start, []
    rows, columns = abs(end[0] - i), abs(end[1] - j)
    step_i, step_j = int(math.copysign(1, end[0] - i)), int(math.copysign(1, end[1] - j))
    error = columns - rows
    while True:
        cells.append((i, j))
        if (i, j) == end:
            return cells
        twice = 2 * error
        if twice > -rows:
            error -= rows
            j += step_j
        if twice < columns:
            error += columns
            i += step_i


@pytest.mark.parametrize("seed", RNG_SEEDS)
def test_each_beam_counts_a_pass_in_its_cells_and_a_hit_where_it_ended(seed):
    rng = np.random.default_rng(seed)
    shape, reach = (30, 40), 12.0
    x, y, yaw = rng.uniform(5, 25), rng.uniform(5, 25), rng.uniform(-3, 3)
    ranges = np.where(rng.random(24) < 0.3, reach, rng.uniform(0.1, 20.0, 24))
    passes, hits = np.zeros(shape, np.int32), np.zeros(shape, np.int32)
    count_beams(passes, hits, x, y, yaw, ranges, reach)

    slow_passes, slow_hits = np.zeros(shape, np.int32), np.zeros(shape, np.int32)
    for k, length in enumerate(ranges):
        angle, cut = yaw + 2 * math.pi * k / 24, min(length, reach)
        end = math.floor(y + cut * math.sin(angle)), math.floor(x + cut * math.cos(angle))
        for i, j in bresenham((math.floor(y), math.floor(x)), end):
            if 0 <= i < shape[0] and 0 <= j < shape[1]:
                slow_passes[i, j] += 1
        if length < reach and 0 <= end[0] < shape[0] and 0 <= end[1] < shape[1]:
            slow_passes[end] += 1
            slow_hits[end] += 1
    assert (passes == slow_passes).all()
    assert (hits == slow_hits).all()


def test_a_cell_is_known_after_three_passes_and_occupied_above_a_tenth_of_hits():
    passes = np.array([[0, 2, 3, 10, 10, 40]], np.int32)
    hits = np.array([[0, 2, 0, 1, 2, 4]], np.int32)
    assert decide(passes, hits).tolist() == [[UNKNOWN, UNKNOWN, FREE, FREE, OCCUPIED, FREE]]


@pytest.mark.parametrize("seed", RNG_SEEDS)
def test_what_is_in_sight_is_open_within_reach_and_not_behind_a_wall(seed):
    rng = np.random.default_rng(seed)
    solid = rng.random((40, 40)) < 0.08
    solid[20, 20] = False
    seen = np.zeros_like(solid)
    look_around(solid, seen, 20.5, 20.5, 2880, 15.0)
    assert not (seen & solid).any()
    for i, j in np.argwhere(~solid):
        far = math.hypot(i - 20, j - 20)
        # Lines to several points of the cell, so that no beam has to slip through between two corners.
        ends = [(i + a, j + b) for a in (0.2, 0.5, 0.8) for b in (0.2, 0.5, 0.8)]
        cells = np.floor(np.concatenate([np.linspace((20.5, 20.5), end, 400) for end in ends])).astype(int)
        if not solid[cells[:, 0], cells[:, 1]].any() and far < 13:
            assert seen[i, j]
        if far > 16.5:
            assert not seen[i, j]
    closed = np.ones((9, 9), bool)
    closed[3:6, 3:6] = False
    seen = np.zeros_like(closed)
    look_around(closed, seen, 4.5, 4.5, 2880, 100.0)
    assert (seen == ~closed).all()


@pytest.mark.parametrize("seed", RNG_SEEDS)
def test_a_tour_passes_every_target_that_it_can_reach_by_steps_between_neighbours(seed):
    from scipy import ndimage

    rng = np.random.default_rng(seed)
    passable = rng.random((30, 36)) < 0.8
    labels, _ = ndimage.label(passable)
    largest = labels == 1 + np.argmax(np.bincount(labels.ravel())[1:])
    targets = one_a_square(passable, 6)
    row, column = np.argwhere(largest)[0].tolist()
    walk = nearest_first(passable, targets, row, column)
    assert walk[0].tolist() == [row, column]
    assert np.abs(np.diff(walk, axis=0)).max(initial=1) == 1
    assert passable[walk[:, 0], walk[:, 1]].all()
    for (i, j), (y, x) in zip(walk[:-1], walk[1:], strict=True):
        assert passable[i, x]
        assert passable[y, j]
    passed = np.zeros_like(passable)
    passed[walk[:, 0], walk[:, 1]] = True
    assert passed[targets & largest].all()


def test_each_square_has_one_target_next_to_its_middle():
    passable = np.ones((12, 18), bool)
    passable[2, 2] = False
    targets = one_a_square(passable, 6)
    assert targets.sum() == 6
    assert targets.reshape(2, 6, 3, 6).sum(axis=(1, 3)).tolist() == [[1, 1, 1], [1, 1, 1]]
    assert targets[8, 8]
    assert targets[2, 3]
