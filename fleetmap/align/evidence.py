"""Step 3: what speaks for a pose, and what against it: counted in metres of wall, both ways."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fleetmap.align.refine import Poses, matches
from fleetmap.align.walls import Floats, Walls, rotated
from fleetmap.model.lattice import UNKNOWN
from fleetmap.model.pose import Pose2

NEAR_M = 0.15
"""Two sights of a wall are at most so far apart."""
DEEP_M = 0.25
"""A wall so deep in free space that the other has seen wasn't there."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """Of one pose.

    Parameters
    ----------
    explained_m : wall of either that the other has, too; the mean of both ways
    conflict_m : wall of either in the other's free space; the mean of both ways
    visible_m : wall of either where the other knows what is there; the mean of both ways
    fixed_m : how much of the explained wall holds the pose against a slide in the direction in which it slides best
    rms_m : distances between the explained walls
    """

    explained_m: float
    conflict_m: float
    visible_m: float
    fixed_m: float
    rms_m: float

    @property
    def score_m(self) -> float:
        """What is left of the explained wall for what contradicts it."""
        return self.explained_m - 3.0 * self.conflict_m

    @property
    def share(self) -> float:
        """Explained, of what is explained or contradicted."""
        return self.explained_m / max(self.explained_m + self.conflict_m, 1e-9)


def weigh(a: Walls, b: Walls, T_a_b: Pose2) -> Evidence:
    """What speaks for and against a place of b in a."""
    sides = [one_way(a, b, T_a_b), one_way(b, a, T_a_b.inverse())]
    explained, conflict, visible, squares = (float(np.mean([side[k] for side in sides])) for k in range(4))
    fixed = min(float(np.linalg.eigvalsh(side[4])[0]) for side in sides)
    return Evidence(explained, conflict, visible, fixed, float(np.sqrt(squares / max(explained, 1e-9))))


def one_way(a: Walls, b: Walls, T_a_b: Pose2) -> tuple[float, float, float, float, Floats]:
    """Of the walls of b: explained, conflicting, visible, squares of distances, and the matrix of matched normals."""
    pose = Poses(np.array([[T_a_b.x_m, T_a_b.y_m, T_a_b.yaw_rad]]))
    points, normals = pose.apply(b.points_xy)[0], rotated(T_a_b.yaw_rad, b.normals_xy)
    which, good = matches(a, points, normals, NEAR_M)
    weight = np.where(good, b.lengths_m, 0.0)
    off = ((a.points_xy[which] - points) * a.normals_xy[which]).sum(axis=-1)
    # Just inside of its free side: there a wall's own space was seen.
    deep = a.look_up(a.clearance_m, points, 0.0) > DEEP_M
    known = a.look_up(a.states_yx, points + 0.1 * normals, float(UNKNOWN)) != UNKNOWN
    conflict = float(b.lengths_m[deep & ~good].sum())
    visible = float(b.lengths_m[known | good].sum())
    spread = np.einsum("n,ni,nj->ij", weight, normals, normals)
    return float(weight.sum()), conflict, visible, float((weight * off**2).sum()), spread
