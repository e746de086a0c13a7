"""Step 2: each candidate moved to where the walls fit best: points of b to the lines of a, several candidates at once.

Gauss-Newton on the distances along the normals of a (point to line, Censi 2008), with Cauchy's weights, over matches
that face alike; the radius in which a match is looked for shrinks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetmap.align.candidates import Candidate
from fleetmap.align.walls import DIRECTION_M, Floats, Walls

STAGES = ((0.6, 5, 400), (0.3, 5, 800), (0.2, 4, 3000))
"""(radius of a match in metres, steps, points of b at most)."""
ALIKE = 0.9
"""Least cosine between two walls' normals that may be one wall."""
SOFT_M = 0.05
"""Distances beyond count less and less."""
DAMPING = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """(h, 3) rows (x, y, yaw): p_a = R(yaw) p_b + (x, y)."""

    rows: Floats

    def apply(self, points_xy: Floats) -> Floats:
        """(n, 2) points of b in a: (h, n, 2)."""
        return self.turn(points_xy) + self.rows[:, None, :2]

    def turn(self, vectors_xy: Floats) -> Floats:
        """(n, 2) directions of b in a: (h, n, 2)."""
        c, s = np.cos(self.rows[:, 2])[:, None], np.sin(self.rows[:, 2])[:, None]
        x, y = vectors_xy[:, 0], vectors_xy[:, 1]
        return np.stack([c * x - s * y, s * x + c * y], axis=-1)


def matches(
    a: Walls, points_xy: Floats, normals_xy: Floats, radius_m: float
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """For each point (..., 2) the wall point of a that is nearest and faces alike, and whether it is near enough."""
    asked = np.concatenate([points_xy, DIRECTION_M * normals_xy], axis=-1)
    # What faces 25 degrees away is 0.44 m farther: it isn't looked for beyond that.
    reach = float(np.hypot(radius_m, DIRECTION_M * np.sqrt(2 - 2 * ALIKE)))
    _, which = a.tree.query(asked.reshape(-1, 4), distance_upper_bound=reach)
    which = which.reshape(points_xy.shape[:-1])
    found = which < len(a.points_xy)
    which = np.where(found, which, 0)
    near = np.hypot(*np.moveaxis(points_xy - a.points_xy[which], -1, 0)) < radius_m
    alike = (normals_xy * a.normals_xy[which]).sum(axis=-1) > ALIKE
    return which, found & near & alike


def refine(a: Walls, b: Walls, candidates: list[Candidate]) -> Poses:
    """Where each of them ends."""
    poses = Poses(np.array([(c.x_m, c.y_m, c.yaw_rad) for c in candidates], np.float64).reshape(-1, 3))
    for radius_m, steps, most in STAGES:
        picked = slice(None, None, max(1, len(b.points_xy) // most))
        points, normals, lengths = b.points_xy[picked], b.normals_xy[picked], b.lengths_m[picked]
        for _ in range(steps):
            poses = step(a, points, normals, lengths, poses, radius_m)
    return poses


def information(a: Walls, b: Walls, pose: Poses) -> tuple[Floats, Floats]:
    """What the common walls tell of (x, y, yaw) about their middle: (3, 3), in metres of wall; and that middle."""
    placed, facing = pose.apply(b.points_xy)[0], pose.turn(b.normals_xy)[0]
    which, good = matches(a, placed, facing, STAGES[-1][0])
    normal, weight = a.normals_xy[which], np.where(good, b.lengths_m, 0.0)
    middle = weight @ placed / max(float(weight.sum()), 1e-9)
    arm = placed - middle
    jacobian = slopes(normal, arm)
    return np.einsum("n,ni,nj->ij", weight, jacobian, jacobian) + DAMPING * np.eye(3), middle


def step(a: Walls, points: Floats, normals: Floats, lengths: Floats, poses: Poses, radius_m: float) -> Poses:
    """One step of Gauss-Newton for all poses."""
    placed, facing = poses.apply(points), poses.turn(normals)
    which, good = matches(a, placed, facing, radius_m)
    normal = a.normals_xy[which]
    # About the middle of what is matched: a turn then hardly moves it, and the system is well conditioned.
    weight = np.where(good, lengths, 0.0)
    total = np.maximum(weight.sum(axis=1), 1e-9)
    middle = (weight[..., None] * placed).sum(axis=1) / total[:, None]
    arm = placed - middle[:, None]
    off = ((a.points_xy[which] - placed) * normal).sum(axis=-1)
    weight = weight / (1 + (off / SOFT_M) ** 2)
    jacobian = slopes(normal, arm)
    information = np.einsum("hn,hni,hnj->hij", weight, jacobian, jacobian) + DAMPING * np.eye(3)
    gradient = np.einsum("hn,hni,hn->hi", weight, jacobian, off)
    dx, dy, turn = np.linalg.solve(information, gradient[..., None])[..., 0].T
    c, s = np.cos(turn), np.sin(turn)
    away = poses.rows[:, :2] - middle
    shifted = np.stack([c * away[:, 0] - s * away[:, 1], s * away[:, 0] + c * away[:, 1]], axis=-1) + middle
    moved = shifted + np.stack([dx, dy], axis=-1)
    return Poses(np.column_stack([moved, poses.rows[:, 2] + turn]))


def slopes(normal: Floats, arm: Floats) -> Floats:
    """(..., 3): how fast a point at ``arm`` moves along a normal with x, y and a turn about the middle."""
    nx, ny = normal[..., 0], normal[..., 1]
    found: Floats = np.stack([nx, ny, ny * arm[..., 0] - nx * arm[..., 1]], axis=-1)
    return found
