"""The loops over points of walls give what plain sums over all pairs of points give."""

from __future__ import annotations

import math

import numpy as np
import pytest
from buildings import make_pair

from fleetmap.align.evidence import DEEP_M, INSIDE_M, LEAST_SEGMENT_M, LINES_APART_M, MATCHED, NEAR_M
from fleetmap.align.match_kernels import ALIKE, count_lines, nearest, normal_equations, one_way
from fleetmap.align.walls import CELL_M, Walls, loose, walls_of
from fleetmap.model.lattice import UNKNOWN
from fleetmap.vectorize import vectorize


def both(seed: int = 3) -> tuple[Walls, Walls, np.ndarray]:
    """The walls of a generated pair, and about where the second lies in the first."""
    pair = make_pair("same", seed)
    assert pair.T_a_b is not None
    pose = np.array([pair.T_a_b.x_m + 0.05, pair.T_a_b.y_m - 0.03, pair.T_a_b.yaw_rad + 0.01])
    return walls_of(vectorize(pair.a)), walls_of(vectorize(pair.b)), pose


def placed(walls: Walls, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points and normals where a pose puts them."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    turn = np.array([[c, -s], [s, c]])
    return walls.points_xy @ turn.T + pose[:2], walls.normals_xy @ turn.T


def all_nearest(a: Walls, points: np.ndarray, normals: np.ndarray, radius_m: float) -> list[int]:
    """By a look at every point: the row of ``a.index.table``, -1 if none is near enough and alike."""
    table = a.index.table
    found = []
    for point, normal in zip(points, normals, strict=True):
        away = np.hypot(*(table[:, :2] - point).T)
        away[table[:, 2:4] @ normal <= ALIKE] = np.inf
        k = int(np.argmin(away))
        found.append(k if away[k] < radius_m else -1)
    return found


@pytest.mark.parametrize("radius_m", [0.05, 0.2, 0.8])
def test_the_nearest_point_is_that_of_all_points(radius_m: float) -> None:
    a, b, pose = both()
    points, normals = placed(b, pose)
    points = np.vstack([points, points + 50.0])  # far beyond all cells, too
    normals = np.vstack([normals, normals])
    table = a.index.table
    for point, normal, k in zip(points, normals, all_nearest(a, points, normals, radius_m), strict=True):
        found = nearest(*a.index, *point, *normal, radius_m)
        assert (found < 0) == (k < 0)
        if k >= 0:  # of two that are as near either may be found
            assert math.dist(table[found, :2], point) == pytest.approx(math.dist(table[k, :2], point))


def test_the_normal_equations_are_the_plain_sums() -> None:
    a, b, pose = both()
    middle = b.points_xy.mean(axis=0)
    poses = np.stack([pose, pose + np.array([0.3, 0.1, 0.2])])
    found = normal_equations(*a.index, b.table, poses, middle, 0.4, 0.05)
    for row, one in zip(found, poses, strict=True):
        points, normals = placed(b, one)
        which = np.array(all_nearest(a, points, normals, 0.4))
        good = which >= 0
        wall, weight = a.index.table[which[good]], b.lengths_m[good]
        arm = points[good] - (placed(Walls(middle[None], *[np.zeros((1, 2))] * 6), one)[0])  # type: ignore[arg-type]
        off = ((wall[:, :2] - points[good]) * wall[:, 2:4]).sum(axis=1)
        weight = weight / (1 + (off / 0.05) ** 2)
        slopes = np.column_stack([wall[:, 2], wall[:, 3], wall[:, 3] * arm[:, 0] - wall[:, 2] * arm[:, 1]])
        matrix, right = (weight[:, None] * slopes).T @ slopes, slopes.T @ (weight * off)
        expected = [*matrix[np.triu_indices(3)], *right, b.lengths_m[good].sum(), *(b.lengths_m[good] @ points[good])]
        assert row == pytest.approx(expected, rel=1e-6, abs=1e-6)


def test_what_speaks_for_a_pose_and_against_it_is_the_plain_sum() -> None:
    a, b, pose = both()
    for one in (pose, pose + np.array([1.0, 0.5, 0.7])):
        matched = np.zeros(len(b.table), bool)
        limits = np.array([*a.corner_xy, CELL_M, NEAR_M, DEEP_M, INSIDE_M])
        found = one_way(*a.index, b.table, one, a.clearance_m, a.states_yx, limits, matched)
        points, normals = placed(b, one)
        which = np.array(all_nearest(a, points, normals, NEAR_M))
        assert (matched == (which >= 0)).all()
        length = np.where(matched, b.lengths_m, 0.0)
        wall = a.index.table[which]
        off = ((wall[:, :2] - points) * wall[:, 2:4]).sum(axis=1)

        def there(table: np.ndarray, at: np.ndarray, outside: float) -> np.ndarray:
            column, row = np.floor((at - a.corner_xy) / CELL_M).astype(int).T
            inside = (column >= 0) & (row >= 0) & (column < table.shape[1]) & (row < table.shape[0])
            return np.where(inside, table[np.where(inside, row, 0), np.where(inside, column, 0)], outside)

        deep = there(a.clearance_m, points, 0.0) > np.float32(DEEP_M)
        known = there(a.states_yx, points + INSIDE_M * normals, UNKNOWN) != UNKNOWN
        expected = [
            length.sum(),
            b.lasting_m[deep & ~matched].sum(),
            length.sum() + b.lasting_m[known & ~matched].sum(),
            (length * off**2).sum(),
            *[(length * normals[:, i] * normals[:, j]).sum() for i, j in ((0, 0), (0, 1), (1, 1))],
            *(length @ points),
            *[(length * points[:, i] * points[:, j]).sum() for i, j in ((0, 0), (0, 1), (1, 1))],
        ]
        assert found == pytest.approx(expected, rel=1e-6, abs=1e-6)


def test_lines_are_counted_once_each() -> None:
    def walls(*segments: tuple[float, float, float, float]) -> Walls:
        points, normals, lengths, edge = [], [], [], []
        for number, (x0, y0, x1, y1) in enumerate(segments):
            length = math.dist((x0, y0), (x1, y1))
            for k in range(5):
                points.append((x0 + (x1 - x0) * (k + 0.5) / 5, y0 + (y1 - y0) * (k + 0.5) / 5))
                normals.append(((y0 - y1) / length, (x1 - x0) / length))
                lengths.append(length / 5)
                edge.append(number)
        return Walls(*map(np.array, (points, normals, lengths, lengths, edge)), np.zeros((1, 1), np.uint8), np.zeros(2))

    def lines(these: Walls, matched: np.ndarray | None = None) -> int:
        mask = np.ones(len(these.table), bool) if matched is None else matched
        return int(count_lines(these.table, these.segments, mask, MATCHED, LEAST_SEGMENT_M, LINES_APART_M))

    # Two pieces of one wall, a parallel one, its back, one across, and a crumb.
    pieces = [(0, 0, 2, 0), (3, 0.05, 5, 0.05), (0, 1, 2, 1), (2, 0, 0, 0), (6, 0, 6, 2), (7, 0, 7.1, 0.1)]
    assert [lines(walls(*pieces[: k + 1])) for k in range(6)] == [1, 1, 2, 3, 4, 4]
    half = np.arange(5) < 2
    assert lines(walls(pieces[0]), half) == 0
    assert lines(walls(pieces[0]), ~half) == 1


def test_what_stands_free_and_is_small_is_loose() -> None:
    def box(y: int, x: int, size: int) -> list[tuple[int, int, int, int]]:
        corners = [(y, x), (y, x + size), (y + size, x + size), (y + size, x), (y, x)]
        return [(*one, *other) for one, other in zip(corners[:-1], corners[1:], strict=True)]

    edges = np.array([*box(0, 0, 200), *box(50, 50, 10), *box(100, 50, 30)], np.int32)
    assert loose(edges, 0.05).tolist() == [False] * 4 + [True] * 4 + [False] * 4
    assert loose(edges[:0], 0.05).tolist() == []
