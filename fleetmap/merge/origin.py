"""Where the fleet lattice begins, so that maps far from the fleet's origin have small numbers, too.

A pure function of where the sources lie, which every peer computes by itself from what it holds: nothing is agreed.
The origin is (0, 0) if every map lies near it. Otherwise it is the place of the map of the smallest frame, rounded to
1024 m, unless another map's place leaves out fewer robots: a map that somebody puts far away under a small name moves
nobody else out. (Who writes under as many names as the robots that it wants to push out still can.)
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.frame import Frame
from fleetmap.model.lattice import MAX_COORDINATE
from fleetmap.model.mergedmap import FLEET_UM, ORIGIN_UM

ORIGIN_STEPS = ORIGIN_UM // FLEET_UM
"""Origins are multiples of these, in lattice steps (1024 m)."""

MAX_EXTENT = MAX_COORDINATE
"""A map, and with it a component, may extend so many lattice steps along each axis (5243 m)."""

MAX_REACH = MAX_EXTENT + ORIGIN_STEPS // 2
"""Farthest from the origin that the fold takes a map (5755 m): all maps that lie within ``MAX_EXTENT`` of one another
fit around the place of each of them, however that is rounded."""


class Box(NamedTuple):
    """Least and largest coordinates of a map in the component's frame: lattice steps from (0, 0)."""

    y0: int
    x0: int
    y1: int
    x1: int

    @classmethod
    def of(cls, points_yx: NDArray[np.int64]) -> Box:
        """The box around (n, 2) points, at least one."""
        (y0, x0), (y1, x1) = points_yx.min(axis=0).tolist(), points_yx.max(axis=0).tolist()
        return cls(y0, x0, y1, x1)

    @property
    def extent(self) -> int:
        """The longer side."""
        return max(self.y1 - self.y0, self.x1 - self.x0)

    def __or__(self, other: Box) -> Box:
        """The box around both."""
        return Box(min(self.y0, other.y0), min(self.x0, other.x0), max(self.y1, other.y1), max(self.x1, other.x1))

    def place(self) -> tuple[int, int]:
        """(y, x) of the middle, rounded to whole ``ORIGIN_STEPS``."""
        return _nearest(self.y0 + self.y1), _nearest(self.x0 + self.x1)

    def reach(self, origin: tuple[int, int]) -> int:
        """The largest |coordinate| from an origin (y, x)."""
        y, x = origin
        return max(y - self.y0, self.y1 - y, x - self.x0, self.x1 - x)


def choose_origin(boxes: Iterable[tuple[Frame, Box]]) -> tuple[int, int]:
    """(y, x) lattice steps: around which origin most robots, then most maps, lie within ``MAX_REACH``.

    Of several (0, 0) comes first, then the place of the map of the smallest frame. Order and repetition of the boxes
    don't matter.
    """
    each = sorted(set(boxes))
    if not each:
        return 0, 0
    table = np.array([box for _, box in each])
    _, robots = np.unique([robot for (robot, _, _), _ in each], return_inverse=True)
    best, most = (0, 0), (0, 0)
    for y, x in dict.fromkeys([(0, 0), *(box.place() for _, box in each)]):
        fits = (np.abs(table - [y, x, y, x]) <= MAX_REACH).all(axis=1)
        if fits.all():
            return y, x
        count = len(np.unique(robots[fits])), int(fits.sum())
        if count > most:
            best, most = (y, x), count
    return best


def too_far(box: Box, origin: tuple[int, int]) -> str:
    """Why a map is left out that doesn't fit around the origin (y, x)."""
    y, x = origin
    return (
        f"edges: up to {in_metres(box.reach(origin))} along an axis from ({in_metres(x)}, {in_metres(y)}), where the "
        f"other maps of the component are; at most {in_metres(MAX_REACH)}"
    )


def in_metres(steps: int) -> str:
    """Lattice steps in words."""
    return f"{steps * FLEET_UM / 1e6:.0f} m"


def _nearest(doubled: int) -> int:
    """The multiple of ``ORIGIN_STEPS`` nearest to half of ``doubled``, rounded half up."""
    return (doubled + ORIGIN_STEPS) // (2 * ORIGIN_STEPS) * ORIGIN_STEPS
