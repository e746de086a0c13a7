"""An independent check of a merged map: an arrangement that keeps the laws of merging.

Shares no code with the fold. It may use floats and shapely, for it decides nothing: a diagnostic and an oracle
for the tests.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from fleetmap.merge.protocol import Source
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import OCCUPIED
from fleetmap.model.mergedmap import FLEET_UM, GRID_UM, LEFT, RIGHT, THICKNESS, X1, MergedMap
from fleetmap.verify import find_openings

if TYPE_CHECKING:
    from fleetmap.merge.verify_planar import Found


@dataclass(frozen=True, slots=True)
class Violation:
    """One place where a merged map breaks a law.

    Parameters
    ----------
    law : ``canonical``, ``crossing``, ``face``, ``safety`` (3), ``door`` (4), ``accuracy`` (5), ``free`` or ``drawn``
    at_xy_m : where, metres in the component's frame
    reason : what was found and what was expected
    """

    law: str
    at_xy_m: tuple[float, float]
    reason: str


def verify(
    sources: Iterable[Source], merged: MergedMap, *, spacing: int = 5, drawn: OccupancyGrid | None = None
) -> list[Violation]:
    """Check ``merged`` against the ``sources`` that it was folded from.

    Parameters
    ----------
    sources : those that the fold took: what it left out (``MergedMap.left_out``) must not be among them
    spacing : lattice steps between the points at which the laws 3 to 5 are tested along walls
    drawn : a grid that was drawn from the map, to be checked in place of ``merged.to_grid()``

    Returns
    -------
    What is wrong, and where; empty if all is well

    Notes
    -----
    - canonical: rows ascend, none twice, lower end first, states and flags in range; an edge that is no wall
      has free space on exactly one side.
    - crossing: edges meet only at vertices (exact, in integers).
    - face: all edges around a face agree on whether it is free, and what is outside of everything isn't.
    - safety and accuracy: each wall of a source lies within the tolerance of a merged wall, and the reverse.
    - free: farther than the tolerance from every boundary of a source, space is free exactly if a source
      says so.
    - door: free space keeps its clearance to walls, as far as free space reached around it, less half the
      tolerance: a gap that was seen as free and is wider than the tolerance stays open.
    - drawn: in the drawn grid, no 4-connected path of cells that aren't blocked leads from one side of a wall to the
      other but around its ends, or through a gap (see ``fleetmap.verify.drawn``).

    Raises
    ------
    MapFormatError : no ``drawn`` is given, and the map is too large to be drawn
    """
    from fleetmap.merge.verify_laws import check_accuracy, check_space
    from fleetmap.merge.verify_planar import check_canonical, check_crossings, check_faces

    sources = list(sources)
    rows = [tuple(row) for row in merged.edges.tolist()]
    found = [*check_canonical(rows)]
    if not found:
        found += check_crossings(rows)
    if not found:  # faces are only defined in an arrangement
        found += check_faces(rows)
    found += check_accuracy(sources, merged, spacing)
    found += check_space(sources, merged)
    found += _check_drawn(merged, merged.to_grid() if drawn is None else drawn)
    step_m, (x0_m, y0_m) = FLEET_UM * 1e-6, (v * 1e-6 for v in merged.origin_um)
    return [Violation(law, (x0_m + float(x) * step_m, y0_m + float(y) * step_m), reason) for law, y, x, reason in found]


def _check_drawn(merged: MergedMap, drawn: OccupancyGrid) -> Iterator[Found]:
    """Places (law, y, x, reason), in lattice steps, where the drawn grid opens a wall."""
    rows = merged.edges.astype(np.int64)
    # In the unit in which cells are whole numbers, whatever their size.
    fine = FLEET_UM // GRID_UM
    rows[:, [*range(X1 + 1), THICKNESS]] *= fine
    origin_x, origin_y = merged.origin_um
    places = find_openings(
        rows[:, : X1 + 1],
        rows[:, LEFT],
        rows[:, RIGHT],
        np.where(merged.obstacle, rows[:, THICKNESS], -1),
        cell=round(drawn.resolution_m * 1e6 / GRID_UM),
        origin_yx=(
            round((drawn.origin.y_m * 1e6 - origin_y) / GRID_UM),
            round((drawn.origin.x_m * 1e6 - origin_x) / GRID_UM),
        ),
        blocked=drawn.states_yx() == OCCUPIED,
    )
    for y, x in (places / fine).tolist():
        yield "drawn", y, x, "the drawn grid lets a path through the wall"
