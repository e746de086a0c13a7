"""What a planner is: a map, two points and a radius in; a path that keeps the radius out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.mergedmap import MergedMap


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """A path for the centre of a disc.

    Parameters
    ----------
    points_xy : (n, 2) metres in the frame of the request, n >= 2; first the start, last the goal
    length_m : metres
    clearance_m : least distance from the path to an obstacle edge of the map; at least the radius plus margin
        that was asked for, infinite on a map without obstacles
    map_error_m : how far a true obstacle may be from its edge: the certified epsilon plus the merge tolerance.
        Whoever can't afford that asks for a ``margin_m`` of the same size.
    """

    points_xy: NDArray[np.float64]
    length_m: float
    clearance_m: float
    map_error_m: float


class Planner(Protocol):
    """A path on a merged map."""

    def __call__(
        self, merged: MergedMap, start_xy: tuple[float, float], goal_xy: tuple[float, float], *, clearance_m: float
    ) -> Path:
        """Plan for a disc that must stay ``clearance_m`` away from every obstacle edge.

        Points are metres in the component's frame. The goal is never moved.

        Raises
        ------
        NoPath : ``status`` is ``outside``, ``start_blocked``, ``goal_blocked`` or ``unreachable``
        """
        ...
