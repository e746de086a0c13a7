"""Worlds for simulated fleets: what a world is, who makes one, and where a fleet starts in it."""

from __future__ import annotations

import importlib
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.errors import ConfigError
from fleetmap.model.lattice import FREE
from fleetmap.model.pose import Pose2

CELL_M = 0.05
"""Cell size of generated worlds."""

START_GAP_M = 0.8
"""Least distance between the start poses of two robots."""

START_CLEARANCE_M = 0.15
"""Room that a start pose leaves around the robot, beyond its radius."""


@dataclass(frozen=True, eq=False)
class World:
    """The truth that robots move in.

    Parameters
    ----------
    solid : (height, width) bool, row 0 lowest; everything outside of it is solid too
    resolution_m : metres a cell
    origin : pose of the lower left corner of cell (0, 0) in the world frame
    name : for reports
    """

    solid: NDArray[np.bool_]
    resolution_m: float = CELL_M
    origin: Pose2 = Pose2()
    name: str = "world"

    def to_cells(self, pose: Pose2) -> tuple[float, float, float]:
        """(x, y, yaw) of a world pose in cells from the grid's lower left corner, radians from its x axis."""
        local = self.origin.inverse() @ pose
        return local.x_m / self.resolution_m, local.y_m / self.resolution_m, local.yaw_rad

    def centres_xy(self, cells_yx: NDArray[np.int64]) -> NDArray[np.float64]:
        """(n, 2) metres in the world frame: centres of the cells (n, 2)."""
        return self.origin.apply((cells_yx[:, ::-1] + 0.5) * self.resolution_m)

    def standable(self, radius_m: float) -> NDArray[np.bool_]:
        """(height, width) where a disc about the cell's centre touches nothing solid."""
        from fleetmap.sims.space_kernels import clearance2

        radius = radius_m / self.resolution_m
        # One cell of solid around, since what lies outside of the grid is solid.
        padded = np.pad(self.solid, 1, constant_values=True)
        return np.ascontiguousarray(clearance2(padded, math.ceil(radius) + 1)[1:-1, 1:-1] >= 4 * radius**2)

    def reachable(self, starts: list[Pose2], *, radius_m: float) -> NDArray[np.bool_]:
        """(height, width) cells where a robot's centre can get to from any of the starts."""
        from scipy import ndimage

        labels, _ = ndimage.label(self.standable(radius_m))
        wanted = {int(labels[self._cell(start)]) for start in starts} - {0}
        return np.isin(labels, sorted(wanted))

    def _cell(self, pose: Pose2) -> tuple[int, int]:
        x, y, _ = self.to_cells(pose)
        row, column = math.floor(y), math.floor(x)
        if not (0 <= row < self.solid.shape[0] and 0 <= column < self.solid.shape[1]):
            raise ConfigError(option="start", value=(pose.x_m, pose.y_m), reason="lies outside of the world")
        return row, column


class Generator(Protocol):
    """Makes the solid mask of a world: (height, width) bool, closed by an outer wall."""

    def __call__(self, size_m: float, rng: np.random.Generator) -> NDArray[np.bool_]:
        """Square of ``size_m`` metres with cells of ``CELL_M``; the same for the same generator state."""


GENERATORS = {
    "maze": "fleetmap.sims.world_maze",
    "office": "fleetmap.sims.world_office",
    "unstructured": "fleetmap.sims.world_unstructured",
}
"""The paper's three terrains: name -> module with a function ``generate`` (a ``Generator``)."""


def make_world(name: str, *, size_m: float = 40.0, seed: int = 0) -> World:
    """A generated world, or the map of a map_server yaml file with unknown cells solid.

    Raises
    ------
    ConfigError : neither a generator nor a yaml file, or a size below 5 or above 400 m
    MapFormatError : the map can't be read
    """
    if name in GENERATORS:
        if not 5.0 <= size_m <= 400.0:
            raise ConfigError(option="size", value=size_m, reason="expected 5 to 400 m")
        generate: Generator = importlib.import_module(GENERATORS[name]).generate
        return World(generate(size_m, np.random.default_rng(seed)), name=f"{name} {size_m:g} m, seed {seed}")
    if not name.endswith((".yaml", ".yml")):
        raise ConfigError(
            option="world", value=name, reason=f"expected {', '.join(GENERATORS)} or the .yaml file of a map"
        )
    from fleetmap.model.graded import warn_of_thresholds
    from fleetmap.model.map_server import load_map

    grid = load_map(Path(name))
    warn_of_thresholds(grid)
    solid, origin = grid.states_yx() != FREE, grid.origin
    if not (solid[[0, -1]].all() and solid[:, [0, -1]].all()):
        # Free up to the image's edge: a lidar must see the wall that robots would run into there.
        solid = np.pad(solid, 1, constant_values=True)
        origin = origin @ Pose2(-grid.resolution_m, -grid.resolution_m, 0.0)
    return World(solid, grid.resolution_m, origin, name)


def choose_starts(
    world: World, count: int, *, radius_m: float, rng: np.random.Generator, together: bool = True
) -> list[Pose2]:
    """Start poses near each other, as a fleet is unloaded in one place, in the largest space for the robot.

    Or anywhere in it, if not ``together``. Yaws are random. Raises ``ConfigError`` if there is no room for ``count``
    robots.
    """
    from scipy import ndimage

    from fleetmap.sims.space_kernels import FAR, cost_field

    labels, found = ndimage.label(world.standable(radius_m + START_CLEARANCE_M))
    if found == 0:
        raise ConfigError(option="world", value=world.name, reason=f"no room for a robot of radius {radius_m} m")
    largest = 1 + int(np.argmax(np.bincount(labels.ravel())[1:]))
    room = np.argwhere(labels == largest)
    first = room[rng.integers(len(room))]
    cost = cost_field((labels == largest).astype(np.uint8), int(first[0]), int(first[1]))
    order = room[np.argsort(cost[room[:, 0], room[:, 1]], kind="stable")] if together else rng.permutation(room)
    gap = START_GAP_M / world.resolution_m
    chosen: list[NDArray[np.int64]] = []
    for cell in order:
        if cost[cell[0], cell[1]] < FAR and all(np.hypot(*(cell - other)) >= gap for other in chosen):
            chosen.append(cell)
            if len(chosen) == count:
                break
    if len(chosen) < count:
        raise ConfigError(option="robots", value=count, reason=f"the world has room for {len(chosen)} of them")
    centres = world.centres_xy(np.array(chosen))
    yaws = rng.uniform(-math.pi, math.pi, count)
    return [Pose2(float(x), float(y), float(yaw)) for (x, y), yaw in zip(centres, yaws, strict=True)]
