"""What changed between two vector maps: edges removed and added, and thickness that was corrected."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.lattice import MAX_COORDINATE
from fleetmap.model.vectormap import VectorMap


@dataclass(frozen=True, eq=False, slots=True)
class MapDelta:
    """The edges by which one map differs from another on the same lattice.

    Parameters
    ----------
    removed : (k, 5) int32 edges of the base that are gone, in canonical order
    added : (m, 5) int32 edges that the base lacks, in canonical order
    added_thickness : (m,) uint8 their thickness, quarters of a cell
    rethickened : (r, 5) int32 edges that stay and whose thickness changed, in canonical order
    rethickened_to : (r,) uint8 their new thickness
    """

    removed: NDArray[np.int32]
    added: NDArray[np.int32]
    added_thickness: NDArray[np.uint8]
    rethickened: NDArray[np.int32]
    rethickened_to: NDArray[np.uint8]

    def __len__(self) -> int:
        """Number of edges that the delta speaks of; 0 if nothing changed."""
        return len(self.removed) + len(self.added) + len(self.rethickened)


def diff(old: VectorMap, new: VectorMap) -> MapDelta:
    """The delta that makes ``new`` of ``old``; both lie on the same lattice.

    Raises
    ------
    ValueError : the lattices differ, so that edges can't be compared
    """
    if old.lattice != new.lattice:
        raise ValueError(f"the maps lie on different lattices: {old.lattice} and {new.lattice}")
    place = find_rows(new.edges, old.edges)
    stays = place >= 0
    is_new = np.ones(len(new), bool)
    is_new[place[stays]] = False
    thickness = new.thickness[place[stays]]
    changed = thickness != old.thickness[stays]
    return MapDelta(
        old.edges[~stays],
        new.edges[is_new],
        new.thickness[is_new],
        old.edges[stays][changed],
        thickness[changed],
    )


def apply(base: VectorMap, delta: MapDelta) -> VectorMap:
    """``base`` with the delta applied.

    Raises
    ------
    ValueError : a removed or rethickened edge is not in the base, or an added one is already there
    """
    removed = find_rows(base.edges, delta.removed)
    rethickened = find_rows(base.edges, delta.rethickened)
    if (removed < 0).any() or (rethickened < 0).any():
        raise ValueError("the delta speaks of an edge that the base does not have")
    thickness = base.thickness.copy()
    thickness[rethickened] = delta.rethickened_to
    keep = np.ones(len(base), bool)
    keep[removed] = False
    result = VectorMap(
        base.lattice,
        np.concatenate([base.edges[keep], delta.added]),
        np.concatenate([thickness[keep], delta.added_thickness]),
        base.epsilon_cells,
        base.profile,
    )
    if len(result) != int(keep.sum()) + len(delta.added):
        raise ValueError("the delta adds an edge twice, or one that the base has")
    return result


def find_rows(haystack: NDArray[np.int32], needles: NDArray[np.int32]) -> NDArray[np.int64]:
    """(k,) place of each needle, (k, 5), among the haystack's canonical rows, (n, 5); -1 where it is missing."""
    if len(haystack) == 0 or len(needles) == 0:
        return np.full(len(needles), -1, np.int64)
    # A row has more than 64 bits. Its two halves are replaced by their ranks, and the pair of ranks fits.
    head, tail = _halves(haystack)
    heads, tails = np.unique(head), np.unique(tail)
    keys = np.searchsorted(heads, head) * len(tails) + np.searchsorted(tails, tail)
    head, tail = _halves(needles)
    head_rank = np.minimum(np.searchsorted(heads, head), len(heads) - 1)
    tail_rank = np.minimum(np.searchsorted(tails, tail), len(tails) - 1)
    key = head_rank * len(tails) + tail_rank
    place = np.minimum(np.searchsorted(keys, key), len(keys) - 1)
    found = (heads[head_rank] == head) & (tails[tail_rank] == tail) & (keys[place] == key)
    return np.where(found, place, -1).astype(np.int64)


def _halves(rows: NDArray[np.int32]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(n,) keys of (y0, x0) and of (y1, x1, label), each ascending like the columns behind it."""
    bias, bits = MAX_COORDINATE, 22
    y0, x0, y1, x1, label = rows.astype(np.int64).T
    return ((y0 + bias) << bits) | (x0 + bias), ((((y1 + bias) << bits) | (x1 + bias)) << 4) | label


__all__ = ["MapDelta", "apply", "diff", "find_rows"]
