"""The fold: from all sources to the merged map, in six steps, by integers only.

A pure function: no float, clock, hash order or randomness decides anything, so equal sources give equal bytes
on every peer and every machine. Steps 3 and 4 could take any directed cycles: see ``place`` for why that makes
snapping and rounding safe.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fleetmap.merge.afford import TOO_MUCH, Candidate, choose, weighed
from fleetmap.merge.arrange import arrange
from fleetmap.merge.faces import side_states
from fleetmap.merge.origin import MAX_REACH, choose_origin, too_far
from fleetmap.merge.place import Placed
from fleetmap.merge.protocol import Source
from fleetmap.merge.select import select
from fleetmap.merge.simplify import simplify
from fleetmap.merge.snap import snap
from fleetmap.model.frame import Frame
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
    # 1. Onto the fleet lattice, free space to the left; sorted by content, each content once. What would hold up all
    # others is left out (``afford``).
    found = canonical(sources)
    placed, left_out = found.placed, found.left_out
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
    left_out : (frame, reason) of those that can't be placed, or that there is no room for, ascending
    """

    placed: list[Placed]
    frames: list[list[Frame]]
    origin: tuple[int, int]
    left_out: tuple[tuple[Frame, str], ...]


def canonical(sources: Iterable[Source]) -> Canonical:
    """Place the sources that there is room for, and choose the origin of the lattice."""
    candidates, left_out = weighed(sources)
    origin = choose_origin((c.source.frame, c.weight.box) for c in candidates if c.weight.box is not None)
    by_content: dict[bytes, Candidate] = {}
    for candidate in candidates:
        box, frame = candidate.weight.box, candidate.source.frame
        if box is not None and box.reach(origin) > MAX_REACH:
            left_out.append((frame, too_far(box, origin)))
        elif (known := by_content.setdefault(candidate.weight.content, candidate)) is not candidate:
            known.frames.append(frame)
    taken = choose(list(by_content.values())).taken
    for candidate in taken:
        del by_content[candidate.weight.content]
    left_out += [(frame, TOO_MUCH) for candidate in by_content.values() for frame in candidate.frames]
    each = [(candidate.place().seen_from(origin), candidate.frames) for candidate in taken]
    each.sort(key=lambda pair: pair[0].content())
    return Canonical([p for p, _ in each], [f for _, f in each], origin, tuple(sorted(set(left_out))))
