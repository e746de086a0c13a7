"""The boundary of free space as closed walks along the corners of cells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN
from fleetmap.model.vectormap import make_label

APART_CELLS = 3
"""A free speck stays where no other free cell is that near: dropping those that lie apart costs UPDF."""


@dataclass(frozen=True, slots=True, eq=False)
class Boundary:
    """Loops of unit steps on the epoch's lattice, what is to be simplified.

    Parameters
    ----------
    points : (n, 2) int64 lattice points (y, x), loop after loop; each loop is closed by a step to its first
    labels : (n,) uint8 label of the step that leaves each point: 3 * left + right
    turns : (n,) uint8 whether the walk turns there
    offsets : (k + 1,) int64; loop i has the points ``offsets[i]`` to ``offsets[i + 1]``
    following : (n,) int64 next point of the same loop
    phase_yx : the true place of the boundary minus its points, in sixteenths of a cell, each -8 to 7
    wall_cells : (w, 2) int64 occupied cells that lie behind free space; their centres are half a cell on
    wall_owners : (w,) int64 the point whose step each of them lies behind
    dropped : specks that were filled, and their cells
    """

    points: NDArray[np.int64]
    labels: NDArray[np.uint8]
    turns: NDArray[np.uint8]
    offsets: NDArray[np.int64]
    following: NDArray[np.int64]
    phase_yx: tuple[int, int]
    wall_cells: NDArray[np.int64]
    wall_owners: NDArray[np.int64]
    dropped: tuple[int, int]

    def nodes(self) -> NDArray[np.uint8]:
        """(n,) uint8 points where the label changes: they are always vertices."""
        nodes = np.empty(len(self.points), np.uint8)
        nodes[self.following] = self.labels[self.following] != self.labels
        return nodes


def trace_boundary(
    states_yx: NDArray[np.uint8], *, specks: int, shift_yx: tuple[int, int], phase_yx: tuple[int, int]
) -> Boundary:
    """Trace the boundary of free space, and the outlines of obstacles that touch none.

    Free cells are on the left of the walk. Occupied cells that are connected to no free cell would be lost;
    they are outlined with the label occupied | unknown.

    Parameters
    ----------
    states_yx : (height, width) uint8; outside of it all is unknown
    specks : free and unknown components of at most so many cells are filled first, see ``fill_specks``
    shift_yx : lattice point of the lower left corner of cell (0, 0)
    phase_yx : what the corner is off from that point, in sixteenths of a cell
    """
    from fleetmap.vectorize.trace_kernels import assign_walls, fill_specks, trace

    rimmed = np.pad(states_yx, 1, constant_values=UNKNOWN)
    states = rimmed.copy()
    dropped = fill_specks(rimmed, states, specks, APART_CELLS)
    points, right, turns, offsets = trace(states)
    following = _following(offsets)
    wall_cells, wall_owners = assign_walls(states, points, right, following)
    labels = np.array([0, make_label(FREE, OCCUPIED), make_label(FREE, UNKNOWN)], np.uint8)[right]

    hidden = states == OCCUPIED
    hidden[wall_cells[:, 0] + 1, wall_cells[:, 1] + 1] = False
    if hidden.any():
        # For the tracer they are what is free.
        more, _, more_turns, more_offsets = trace(np.where(hidden, FREE, UNKNOWN).astype(np.uint8))
        points, turns = np.concatenate([points, more]), np.concatenate([turns, more_turns])
        labels = np.concatenate([labels, np.full(len(more), make_label(OCCUPIED, UNKNOWN), np.uint8)])
        offsets = np.concatenate([offsets, more_offsets[1:] + offsets[-1]])
        following = _following(offsets)
    shift = np.array(shift_yx, np.int64)
    return Boundary(
        points + shift, labels, turns, offsets, following, phase_yx, wall_cells + shift, wall_owners, dropped
    )


def _following(offsets: NDArray[np.int64]) -> NDArray[np.int64]:
    """For each point the next one of its loop."""
    following = np.arange(1, offsets[-1] + 1)
    following[offsets[1:] - 1] = offsets[:-1]
    return following
