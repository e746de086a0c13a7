"""Step 2: each candidate moved to where the walls fit best: points of b to the lines of a, all candidates at once.

Gauss-Newton on the distances along the normals of a (point to line, Censi 2008), with Cauchy's weights, over matches
that face alike; the radius in which a match is looked for shrinks.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fleetmap.align.walls import Floats, Walls

ROUGH_CELLS, ROUGH_STEPS, ROUGH_POINTS = 2.0, 6, 150
"""For all candidates: the radius of a match, in cells of the votes, and as below."""
STAGES = ((0.6, 5, 300), (0.3, 5, 800), (0.2, 5, 1 << 30))
"""For those that are left: (radius of a match in metres, steps, points of b at most)."""
SOFT_M = 0.05
"""Distances beyond count less and less."""
DAMPING = 1e-3


def refine(a: Walls, b: Walls, poses: Floats, stages: Sequence[tuple[float, int, int]] = STAGES) -> Floats:
    """Where each pose (h, 3), rows (x, y, yaw) with p_a = R(yaw) p_b + (x, y), ends."""
    for radius_m, steps, most in stages:
        points = np.ascontiguousarray(b.table[:: max(1, len(b.table) // most)])
        for _ in range(steps):
            poses = step(a, points, poses, radius_m)
    return poses


def step(a: Walls, points: Floats, poses: Floats, radius_m: float) -> Floats:
    """One step of Gauss-Newton for all poses."""
    # About the middle of the points: a turn then hardly moves them, and the system is well conditioned.
    middle = points[:, :2].mean(axis=0)
    matrix, right, _ = equations(a, points, poses, middle, radius_m, SOFT_M)
    dx, dy, turn = np.linalg.solve(matrix, right[..., None])[..., 0].T
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    arm = np.column_stack([c * middle[0] - s * middle[1], s * middle[0] + c * middle[1]])
    c, s = np.cos(turn), np.sin(turn)
    turned = np.column_stack([c * arm[:, 0] - s * arm[:, 1], s * arm[:, 0] + c * arm[:, 1]])
    moved = poses[:, :2] + arm - turned + np.column_stack([dx, dy])
    return np.column_stack([moved, poses[:, 2] + turn])


def equations(
    a: Walls, points: Floats, poses: Floats, middle: Floats, radius_m: float, soft_m: float
) -> tuple[Floats, Floats, Floats]:
    """For each pose the matrix (3, 3) and the right side, and of the wall that matches (metres, x, y of its middle)."""
    from fleetmap.align.match_kernels import normal_equations

    sums = normal_equations(*a.index, points, np.ascontiguousarray(poses), middle, radius_m, soft_m)
    matrix = sums[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3) + DAMPING * np.eye(3)
    matched = np.column_stack([sums[:, 9], sums[:, 10:12] / np.maximum(sums[:, 9:10], 1e-9)])
    return matrix, sums[:, 6:9], matched


def information(a: Walls, b: Walls, pose: Floats) -> tuple[Floats, Floats]:
    """What the common walls tell of (x, y, yaw) about their middle: (3, 3), in metres of wall; and that middle in a."""
    radius_m, far_m = STAGES[-1][0], 1e9
    _, _, ((_, *there),) = equations(a, b.table, pose[None], np.zeros(2), radius_m, far_m)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    away = np.array(there) - pose[:2]
    middle = np.array([c * away[0] + s * away[1], c * away[1] - s * away[0]])
    (matrix,), _, _ = equations(a, b.table, pose[None], middle, radius_m, far_m)
    return matrix, np.array(there)
