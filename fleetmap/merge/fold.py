"""The fold: from all sources to the merged map, in six steps, by integers only.

A pure function: no float, clock, hash order or randomness decides anything, so equal sources give equal bytes
on every peer and every machine. Steps 3 and 4 could take any directed cycles: see ``place`` for why that makes
snapping and rounding safe.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import chain

import numpy as np

from fleetmap.merge.arrange import affordable, arrange
from fleetmap.merge.faces import side_states
from fleetmap.merge.origin import MAX_REACH, Box, choose_origin, too_far
from fleetmap.merge.place import Placed, place
from fleetmap.merge.protocol import Frame, Source
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
        another robot sends must not stop the merge

    Returns
    -------
    MergedMap : its ``tolerance`` bounds what laws 3 to 5 allow: how far a wall may have moved; its ``left_out`` says
        which sources were left out, and why
    """
    # 1. Onto the fleet lattice, free space to the left; sorted by content, each content once.
    found = canonical(sources)
    placed = affordable(found.placed)
    left_out = found.left_out_but(placed)
    if sum(len(p.ends) for p in placed) == 0:
        return MergedMap(np.zeros((0, 8), np.int32), left_out=left_out)
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
        origin_um=(found.origin[1] * FLEET_UM, found.origin[0] * FLEET_UM),
        left_out=left_out,
    )


def tolerance(cells: list[int]) -> int:
    """The bound of laws 3 to 5, in lattice steps, for sources of these cell sizes.

    A wall may go if a second sight of it stays, after both were snapped, rounded and simplified. And nothing
    else moves farther than half of this, so that from both sides together they can't close a wider gap.
    """
    return 2 * (ROUNDING_STEPS + min(cells) // 2) + (SNAP_CELLS + SECOND_SIGHT_CELLS) * max(cells)


@dataclass(frozen=True, slots=True, eq=False)
class Canonical:
    """The sources as the fold takes them.

    Parameters
    ----------
    placed : on the lattice, each content once, in the order of their content (laws 1 and 2)
    frames : whose they are
    origin : (y, x) lattice steps from (0, 0), where their coordinates begin
    left_out : (frame, reason) of those that can't be placed
    """

    placed: list[Placed]
    frames: list[list[Frame]]
    origin: tuple[int, int]
    left_out: list[tuple[Frame, str]]

    def left_out_but(self, kept: list[Placed]) -> tuple[tuple[Frame, str], ...]:
        """All that is left out if of ``placed`` only some are kept, ascending."""
        reason = "edges: they cross so many others that no real map can be the cause"
        those = {id(placed) for placed in kept}
        frames = chain(*(f for placed, f in zip(self.placed, self.frames, strict=True) if id(placed) not in those))
        return tuple(sorted({*self.left_out, *((frame, reason) for frame in frames)}))


def canonical(sources: Iterable[Source]) -> Canonical:
    """Place the sources and choose the origin of the lattice."""
    each: list[tuple[Frame, Placed, Box | None]] = []
    left_out = []
    for source in sources:
        try:
            placed = place(source)
        except MapFormatError as error:
            left_out.append((source.frame, f"{error.field}: {error.reason}"))
        else:
            each.append((source.frame, placed, placed.box()))
    origin = choose_origin((frame, box) for frame, _, box in each if box is not None)
    by_content: dict[bytes, tuple[Placed, list[Frame]]] = {}
    for frame, placed, box in each:
        if box is not None and box.reach(origin) > MAX_REACH:
            left_out.append((frame, too_far(box, origin)))
        else:
            placed = placed.seen_from(origin)
            by_content.setdefault(placed.content(), (placed, []))[1].append(frame)
    order = sorted(by_content)
    return Canonical([by_content[k][0] for k in order], [by_content[k][1] for k in order], origin, left_out)
