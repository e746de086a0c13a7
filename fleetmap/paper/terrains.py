"""The paper's nine terrains: maze, office and unstructured, of 10, 40 and 80 m, each with a seed of its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetmap.paper.ruins import make_ruins
from fleetmap.sims.worlds import World, make_world

SIZES_M = (10, 40, 80)

MORE_WALL = 1
"""Cells that walls of mazes and offices grow by on each side, to 0.25 m: a sensor then can't map both faces of one
as a single skin."""

SEEDS = {
    ("maze", 10): 3,
    ("office", 10): 1,
    ("unstructured", 10): 3,
    ("maze", 40): 1,
    ("office", 40): 1,
    ("unstructured", 40): 1,
    ("maze", 80): 1,
    ("office", 80): 1,
    ("unstructured", 80): 1,
}
"""Frozen: another seed is another experiment, whose numbers can't be compared with published ones."""


@dataclass(frozen=True, slots=True)
class Terrain:
    """One of the nine: its kind, the side of its square in metres, and the seed of all that is random about it."""

    kind: str
    size_m: int
    seed: int

    @property
    def name(self) -> str:
        """As in tables: ``maze 10 m``."""
        return f"{self.kind} {self.size_m} m"

    def make(self) -> World:
        """The world that the robot drives in, in cells of 5 cm: 80 m are 1600 x 1600."""
        if self.kind == "unstructured":
            return World(make_ruins(self.size_m, np.random.default_rng((self.seed, self.size_m))), name=self.name)
        return World(thicken(make_world(self.kind, size_m=self.size_m, seed=self.seed).solid), name=self.name)


def choose_terrains(sizes_m: tuple[int, ...] = SIZES_M) -> tuple[Terrain, ...]:
    """The terrains of these sizes, smallest first."""
    return tuple(Terrain(kind, size, seed) for (kind, size), seed in SEEDS.items() if size in sizes_m)


def thicken(solid: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Let solid cells grow by ``MORE_WALL`` cells in all eight directions."""
    from scipy import ndimage

    grown: NDArray[np.bool_] = ndimage.binary_dilation(solid, np.ones((3, 3), bool), iterations=MORE_WALL)
    return grown
