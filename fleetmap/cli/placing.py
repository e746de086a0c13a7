"""Where several maps lie in one frame: every pair is aligned, the best pairs place them, and all others check that."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import combinations

import numpy as np

from fleetmap.align.align import align_walls
from fleetmap.align.protocol import Alignment
from fleetmap.align.walls import walls_of
from fleetmap.model.pose import Pose2
from fleetmap.model.vectormap import VectorMap

APART_M, APART_RAD = 0.3, math.radians(3.0)
"""Two ways around a loop of pairs that differ by more contradict each other. Real maps are bent: one of two that have
little in common is turned by more than a degree, though it lies within centimetres."""

Pair = tuple[int, int]
"""(a, b), a < b: the places of two maps in the list."""


def align_all(maps: Sequence[VectorMap], on_pair: Callable[[int, int], object]) -> dict[Pair, Alignment]:
    """Where each map lies in each one before it.

    Parameters
    ----------
    on_pair : told how many pairs of how many are done, before each
    """
    walls = [walls_of(vector_map) for vector_map in maps]
    pairs = list(combinations(range(len(maps)), 2))
    found = {}
    for done, (a, b) in enumerate(pairs):
        on_pair(done, len(pairs))
        found[a, b] = align_walls(walls[a], walls[b])
    return found


def place(count: int, found: Mapping[Pair, Alignment]) -> list[Pose2 | None]:
    """T_first_map of each map by a maximum spanning tree from the first one; None for those that it doesn't reach.

    The weight of a committed pair is how much wall it explains. Of equal ones the first counts.
    """
    poses: list[Pose2 | None] = [Pose2(), *[None] * (count - 1)]
    committed = _committed(found)
    weights = {pair: alignment.evidence.explained_m if alignment.evidence else 0.0 for pair, alignment in found.items()}
    heaviest_first = sorted(committed, key=lambda pair: (-weights[pair], pair))
    while True:
        # Exactly one of both is placed: the other one will be.
        edge = next((p for p in heaviest_first if (poses[p[0]] is None) != (poses[p[1]] is None)), None)
        if edge is None:
            return poses
        T_first_a, T_first_b = poses[edge[0]], poses[edge[1]]
        if T_first_a is not None:
            poses[edge[1]] = T_first_a @ committed[edge]
        elif T_first_b is not None:
            poses[edge[0]] = T_first_b @ committed[edge].inverse()


def differences(poses: Sequence[Pose2 | None], found: Mapping[Pair, Alignment]) -> dict[Pair, tuple[float, float]]:
    """How far each committed pair of placed maps lies from where the poses put it: metres and radians.

    Metres in the middle of the walls that both have: elsewhere an error of the rotation counts as one of the place.
    """
    result = {}
    for (a, b), T_a_b in _committed(found).items():
        T_first_a, T_first_b = poses[a], poses[b]
        if T_first_a is None or T_first_b is None:
            continue
        placed, middle_xy = T_first_a.inverse() @ T_first_b, np.array(found[a, b].middle_xy)
        off_xy = placed.apply(T_a_b.inverse().apply(middle_xy)) - middle_xy
        off_rad = abs(math.remainder(placed.yaw_rad - T_a_b.yaw_rad, math.tau))
        result[a, b] = float(np.hypot(*off_xy)), off_rad
    return result


def contradictions(off: Mapping[Pair, tuple[float, float]]) -> list[Pair]:
    """The pairs that lie too far from where the poses put them."""
    return [pair for pair, (off_m, off_rad) in off.items() if off_m > APART_M or off_rad > APART_RAD]


def _committed(found: Mapping[Pair, Alignment]) -> dict[Pair, Pose2]:
    return {
        pair: alignment.T_a_b
        for pair, alignment in found.items()
        if alignment.outcome == "committed" and alignment.T_a_b is not None
    }
