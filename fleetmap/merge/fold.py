"""The fold: from all sources to the merged map, in six steps, by integers only.

A pure function: no float, clock, hash order or randomness decides anything, so equal sources give equal bytes
on every peer and every machine. Steps 3 and 4 could take any directed cycles: see ``place`` for why that makes
snapping and rounding safe.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from fleetmap.merge.arrange import affordable, arrange
from fleetmap.merge.faces import side_states
from fleetmap.merge.place import Placed, place
from fleetmap.merge.protocol import Source
from fleetmap.merge.select import select
from fleetmap.merge.simplify import simplify
from fleetmap.merge.snap import snap
from fleetmap.model.errors import MapFormatError
from fleetmap.model.mergedmap import FLEET_UM, MergedMap

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
    # 1. Onto the fleet lattice, free space to the left; sorted by content, each content once.
    placed = affordable(canonical(sources))
    if sum(len(p.ends) for p in placed) == 0:
        return MergedMap(np.zeros((0, 8), np.int32))
    cells = [p.cell for p in placed]

    # 2. Draw the maps of different robots together where they tell of the same wall.
    snapped = snap(placed, reach_cells=SNAP_CELLS)

    # 3. One arrangement: pieces that meet only at vertices, equal where edges overlap.
    arrangement = arrange(snapped)

    # 4. On which sides of each piece is free space of any source?
    left, right = side_states(arrangement)

    # 5. The boundaries of the united free space, and the walls that nothing explains.
    rows = select(arrangement, left, right, reach_cells=SECOND_SIGHT_CELLS)

    # 6. As few edges as half a cell allows, in canonical order.
    rows = simplify(rows, slack=min(cells) // 2, depth_slack=min(cells))
    return MergedMap(
        rows.astype(np.int32),
        # At least one lattice step, whatever a robot claims: to_grid's default must be a possible one.
        resolution_um=max(FLEET_UM, min(p.resolution_um for p in placed)),
        tolerance=tolerance(cells),
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
