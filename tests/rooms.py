"""Closed rooms for the tests: an outline of one or two cells of wall, as one to four robots see it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from fleetmap.merge.protocol import Source
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN
from fleetmap.model.pose import FixedPose, Pose2
from fleetmap.vectorize import vectorize

CELL_M = 0.05
SIDE = 56
"""Cells along a side of each robot's grid, whose middle is the origin of its frame."""

FOUR = ndimage.generate_binary_structure(2, 1)

MARGIN_CELLS = 4
"""Free space within so many cells of the wall may be told to be on either side of it."""

KINDS = ("straight", "stepped", "slanting")


@dataclass
class Room:
    outline: np.ndarray
    """(k, 2) corners (x, y) in cells of the true frame."""
    grids: list[OccupancyGrid]
    poses: list[Pose2]
    """Where each robot believes that its frame lies in the true one."""

    def sources(self, profile="share"):
        return [
            Source((f"r{i}", 1, "0"), FixedPose.from_pose(pose), vectorize(grid, profile=profile))
            for i, (grid, pose) in enumerate(zip(self.grids, self.poses, strict=True))
        ]


def make_room(rng, kind, *, robots=None):
    """A room whose outline is ``straight``, ``stepped`` by one cell now and then, or ``slanting``."""
    outline = _outline(rng, kind)
    reach = rng.choice([0.501, 0.71, 1.0])
    beyond = rng.choice([FREE, UNKNOWN])
    grids, poses = [], []
    for i in range(robots or rng.integers(1, 5)):
        pose = Pose2() if i == 0 else Pose2(*rng.uniform(-0.1, 0.1, 2), rng.uniform(-3.1, 3.1))
        points = pose.apply(_centres(SIDE, SIDE, Pose2(-SIDE / 2 * CELL_M, -SIDE / 2 * CELL_M), CELL_M)) / CELL_M
        states = np.where(_inside(points, outline), FREE, beyond).astype(np.uint8)
        states[_distance(points, outline) <= reach] = OCCUPIED
        grid = OccupancyGrid.from_states(
            states.reshape(SIDE, SIDE), CELL_M, Pose2(-SIDE / 2 * CELL_M, -SIDE / 2 * CELL_M)
        )
        assert is_shut(grid, outline, pose)
        grids.append(grid)
        off = rng.normal(0, 0.2 * CELL_M, 2) if i else (0.0, 0.0)
        poses.append(Pose2(pose.x_m + off[0], pose.y_m + off[1], pose.yaw_rad))
    return Room(outline, grids, poses)


def is_shut(grid, outline, pose=None):
    """Whether no 4-connected path of cells that aren't occupied leads from inside to outside of the outline."""
    pad = int((MARGIN_CELLS + 2) * CELL_M / grid.resolution_m)  # what lies outside of the grid can be entered
    blocked = np.pad(grid.states_yx() == OCCUPIED, pad)
    corner = grid.origin @ Pose2(-pad * grid.resolution_m, -pad * grid.resolution_m)
    points = (pose or Pose2()).apply(_centres(*blocked.shape, corner, grid.resolution_m)) / CELL_M
    clear = (_distance(points, outline) > MARGIN_CELLS).reshape(blocked.shape)
    inside = _inside(points, outline).reshape(clear.shape)
    assert (clear & inside).any()
    assert (clear & ~inside).any()
    regions, _ = ndimage.label(~blocked, FOUR)
    return not set(regions[clear & inside]) & set(regions[clear & ~inside]) - {0}


def take_cells(drawn, rng, *, block):
    """A drawn grid without one blocked cell, or without those in a block of 3 x 3 cells."""
    states = drawn.states_yx().copy()
    rows, columns = np.nonzero(states == OCCUPIED)
    at = rng.integers(len(rows))
    y, x, r = rows[at], columns[at], int(block)
    part = states[max(y - r, 0) : y + r + 1, max(x - r, 0) : x + r + 1]
    part[part == OCCUPIED] = rng.choice([FREE, UNKNOWN])
    return OccupancyGrid.from_states(states, drawn.resolution_m, drawn.origin)


def _outline(rng, kind):
    if kind == "slanting":
        while True:
            angles = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(4, 9)))
            if np.diff(np.append(angles, angles[0] + 2 * np.pi)).max() < 2:
                radius = rng.uniform(12, 19, len(angles))
                return np.column_stack([radius * np.cos(angles), radius * np.sin(angles)])
    width, height = rng.integers(9, 17, 2)
    corners = np.array([[-width, -height], [width, -height], [width, height], [-width, height]], float)
    if kind == "straight":
        return corners
    points, every = [], rng.integers(2, 12)
    for a, b in zip(corners, np.roll(corners, -1, 0), strict=True):
        along = (b - a) / np.abs(b - a).sum()
        out = np.array([along[1], -along[0]])
        for i, at in enumerate(range(0, int(np.abs(b - a).sum()), every)):
            points += [a + along * at + out * (i % 2), a + along * at + out * ((i + 1) % 2)]
    return np.array(points)


def _centres(height, width, origin, resolution_m):
    y, x = np.mgrid[0:height, 0:width]
    return origin.apply(np.column_stack([x.ravel() + 0.5, y.ravel() + 0.5]) * resolution_m)


def _edges(outline):
    return zip(outline, np.roll(outline, -1, 0), strict=True)


def _distance(points, outline):
    distance = np.full(len(points), np.inf)
    for a, b in _edges(outline):
        t = np.clip((points - a) @ (b - a) / max((b - a) @ (b - a), 1e-9), 0, 1)
        distance = np.minimum(distance, np.hypot(*(points - a - t[:, None] * (b - a)).T))
    return distance


def _inside(points, outline):
    inside = np.zeros(len(points), bool)
    x, y = points.T
    for a, b in _edges(outline):
        if a[1] != b[1]:
            inside ^= ((a[1] <= y) != (b[1] <= y)) & (x < a[0] + (y - a[1]) * (b[0] - a[0]) / (b[1] - a[1]))
    return inside
