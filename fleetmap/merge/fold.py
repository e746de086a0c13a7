"""The fold: from all sources to the merged map, by integers only.

A pure function: no float, clock, hash order or randomness decides anything, so equal sources give equal bytes
on every peer and every machine (laws 0 to 2 in docs/decisions/merging.md).
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from fleetmap.merge.arrange import arrange
from fleetmap.merge.faces import side_states
from fleetmap.merge.place import Placed, place
from fleetmap.merge.protocol import Source
from fleetmap.merge.select import select
from fleetmap.merge.simplify import simplify
from fleetmap.merge.snap import snap
from fleetmap.model.errors import MapFormatError
from fleetmap.model.mergedmap import MergedMap

SNAP_CELLS = 1
"""How far snapping may move a vertex or an edge, in cells (see ``pair_cell``)."""

SECOND_SIGHT_CELLS = 3
"""How far two sights of one wall may lie apart: two maps may each be off by epsilon = sqrt(2) cells."""

ROUNDING_STEPS = 2
"""Placing a point and routing an edge move it by at most half a lattice step along each axis, each."""


def fold(sources: Iterable[Source]) -> MergedMap:
    """Merge the maps of one component of frames.

    Parameters
    ----------
    sources : in any order, any of them any number of times. One that can't be placed is left out, for what
        another robot sends must not stop the merge: ``place.refusal`` says which and why.

    Returns
    -------
    MergedMap : its ``tolerance`` bounds what laws 3 to 5 allow: how far a wall may have moved
    """
    placed = canonical(sources)
    if sum(len(p.ends) for p in placed) == 0:
        return MergedMap(np.zeros((0, 8), np.int32))
    arrangement = arrange(snap(placed, reach_cells=SNAP_CELLS))
    left, right = side_states(arrangement)
    rows = select(arrangement, left, right, reach_cells=SECOND_SIGHT_CELLS)
    finest = min(p.cell for p in placed)
    rows = simplify(rows, slack=finest // 2, depth_slack=finest)
    return MergedMap(
        rows.astype(np.int32),
        resolution_um=min(p.resolution_um for p in placed),
        tolerance=tolerance([p.cell for p in placed]),
    )


def tolerance(cells: list[int]) -> int:
    """The bound of laws 3 to 5, in lattice steps, for sources of these cell sizes.

    A wall may go if a second sight of it stays, after both were snapped, rounded and simplified. And nothing
    else moves farther than half of this, so that from both sides together they can't close a wider gap.
    """
    return 2 * (ROUNDING_STEPS + min(cells) // 2) + (SNAP_CELLS + SECOND_SIGHT_CELLS) * max(cells)


def canonical(sources: Iterable[Source]) -> list[Placed]:
    """Place the sources, each content once, in the order of their content (laws 1 and 2)."""
    by_content: dict[bytes, Placed] = {}
    for source in sources:
        try:
            placed = place(source)
        except MapFormatError:
            continue
        by_content[placed.content()] = placed
    return [by_content[key] for key in sorted(by_content)]
