"""Where known free space ends: frontiers as pieces that one robot can go and look at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.lattice import FREE
from fleetmap.sims.view import View

LEAST_CELLS = 10
"""A frontier of fewer cells (0.5 m, a robot with its margin) shows nothing that a robot could enter."""

LEAST_UNKNOWN_CELLS = 60
"""Unknown pockets below this area (0.15 m2) are holes in the map, not places to explore."""

PIECE_CELLS = 40
"""Long frontiers are cut at the lines of a grid of this pitch (2 m), so that robots can share them."""

LEAST_PIECE_CELLS = 5
"""Slivers that the cut leaves are seen from the piece beside them."""

PEEK_CELLS = 10
"""A frontier that can't be entered is looked at from a reachable cell at most this far (0.5 m) away."""


@dataclass(frozen=True, slots=True)
class Frontier:
    """A piece of frontier: the cell to go to, what it costs, and how many cells of frontier it has."""

    goal_yx: tuple[int, int]
    middle_yx: tuple[int, int]
    cost: int
    size: int


def find_frontiers(view: View, costs: NDArray[np.int32]) -> list[Frontier]:
    """The pieces that can be reached, or looked into, from where ``costs`` begin."""
    from scipy import ndimage

    from fleetmap.sims.space_kernels import FAR, frontier_cells, viewpoint

    cells = frontier_cells(view.states_yx, LEAST_UNKNOWN_CELLS)
    if not len(cells):
        return []
    mask = np.zeros(view.states_yx.shape, bool)
    mask[cells[:, 0], cells[:, 1]] = True
    labels, _ = ndimage.label(mask, structure=np.ones((3, 3)))
    label = labels[cells[:, 0], cells[:, 1]]
    large = np.bincount(label)[label] >= LEAST_CELLS
    cells, label = cells[large], label[large]
    pieces = np.column_stack([label, cells // PIECE_CELLS])
    _, piece = np.unique(pieces, axis=0, return_inverse=True)
    order = np.argsort(piece.ravel(), kind="stable")
    starts = np.flatnonzero(np.diff(piece.ravel()[order])) + 1
    open_cells = (view.states_yx == FREE).astype(np.uint8)
    found = []
    for members in np.split(cells[order], starts) if len(order) else []:
        if len(members) < LEAST_PIECE_CELLS:
            continue
        off = ((members - members.mean(axis=0)) ** 2).sum(axis=1)
        middle = members[np.argmin(off)]
        member_costs = costs[members[:, 0], members[:, 1]]
        goal = members[np.argmin(np.where(member_costs < FAR, off, np.inf))]
        if costs[goal[0], goal[1]] >= FAR:
            goal = viewpoint(costs, open_cells, int(middle[0]), int(middle[1]), PEEK_CELLS)
            if goal[0] < 0:
                continue
        goal_yx = (int(goal[0]), int(goal[1]))
        found.append(Frontier(goal_yx, (int(middle[0]), int(middle[1])), int(costs[goal_yx]), len(members)))
    return found
