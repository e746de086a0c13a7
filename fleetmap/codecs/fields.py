"""A delta as a few lists of small numbers, and back: what all payload modes share. How a mode writes them is its own.

Removed edges are named by their place in the base's canonical order and added ones as walks. Walks along a closed
boundary start where a removed edge ended, so their roots are small numbers and not coordinates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.bands import NO_EDGES, REASONS
from fleetmap.model.delta import MapDelta, plain_arrays
from fleetmap.model.vectormap import VectorMap


@dataclass(frozen=True, eq=False, slots=True)
class DeltaFields:
    """The numbers of a delta, int64.

    Parameters
    ----------
    removed : (R,) places of the removed edges in the base, ascending
    known_roots : (K,) ranks among the endpoints of the removed edges, ascending; a rank may occur twice
    absolute_roots : (A, 2) steps (dy, dx), each from the root before it, the first from the first removed edge
    edges : (E, 5) for each added edge, in the order in which they are walked: the step (dy, dx); its class, 0 between
        free and occupied, 1 free and unknown, 2 occupied and unknown; 1 if a walk starts with it, at the next root;
        its thickness
    rethickened : (H, 2) place in the base, ascending, and new thickness
    thick_frontiers : whether any edge of class 1 has a thickness
    removed_rows : (R, 5) int32 the removed edges themselves
    """

    removed: NDArray[np.int64]
    known_roots: NDArray[np.int64]
    absolute_roots: NDArray[np.int64]
    edges: NDArray[np.int64]
    rethickened: NDArray[np.int64]
    thick_frontiers: bool
    removed_rows: NDArray[np.int32]


def to_fields(delta: MapDelta, base: VectorMap) -> DeltaFields:
    """The numbers of a delta against ``base``; the same delta always has the same ones.

    Raises
    ------
    ValueError : the delta removes or rethickens edges that the base doesn't have
    """
    from fleetmap.codecs.chain_kernels import find_walks

    removed, added, added_thickness, rethickened_edges, rethickened_to = plain_arrays(delta)
    places = base.bands.find(removed)
    rethickened = np.empty((len(rethickened_to), 2), np.int64)
    if len(rethickened):
        rethickened[:, 0] = base.bands.find(rethickened_edges)
        rethickened[:, 1] = rethickened_to
    if min(places.tolist(), default=0) < 0 or min(rethickened[:, 0].tolist(), default=0) < 0:
        raise ValueError(REASONS[1])
    known_roots, absolute_roots, edges, thick_frontiers = find_walks(removed, added, added_thickness)
    return DeltaFields(places, known_roots, absolute_roots, edges, rethickened, bool(thick_frontiers), removed)


def to_delta(fields: DeltaFields, base: VectorMap) -> MapDelta:
    """The delta whose numbers these are, against the same base.

    Raises
    ------
    ValueError : the numbers don't fit each other or the base
    """
    from fleetmap.codecs.chain_kernels import lay_edges
    from fleetmap.model.row_kernels import GOOD, THERE

    starts, steps = fields.edges[:, 3], fields.edges
    if len(steps) and not starts[0]:
        raise ValueError("a walk has no root")
    if int(starts.sum()) != len(fields.known_roots) + len(fields.absolute_roots):
        raise ValueError("the number of roots is not the number of walks")
    found, rows = lay_edges(fields.removed_rows, fields.known_roots, fields.absolute_roots, steps)
    if found != GOOD:
        raise ValueError("an edge is added twice" if found == THERE else REASONS[found])
    places = fields.rethickened[:, 0]
    rethickened = base.bands.take(places)[:, :5].copy() if len(places) else NO_EDGES
    return MapDelta(
        fields.removed_rows,
        rows[:, :5].copy(),
        rows[:, 5].astype(np.uint8),
        rethickened,
        fields.rethickened[:, 1].astype(np.uint8),
    )
