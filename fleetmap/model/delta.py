"""What changed between two vector maps: edges removed and added, and thickness that was corrected.

Both functions cost time in proportion to what changed: bands that two maps share are neither compared nor copied.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.bands import REASONS, Bands
from fleetmap.model.vectormap import VectorMap

_MASK = (1 << 64) - 1


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
    from fleetmap.model.band_kernels import diff_rows

    if old.lattice is not new.lattice and old.lattice != new.lattice:
        raise ValueError(f"the maps lie on different lattices: {old.lattice} and {new.lattice}")
    return MapDelta(*diff_rows(*old.bands.differing(new.bands)))


def apply(base: VectorMap, delta: MapDelta) -> VectorMap:
    """``base`` with the delta applied; bands without a changed edge are shared.

    Raises
    ------
    ValueError : a removed or rethickened edge is not in the base, an added one is already there, or the delta's
        edges are not in canonical order
    """
    from fleetmap.model.band_kernels import apply_rows
    from fleetmap.model.row_kernels import GOOD

    removed, added, added_thickness, rethickened, rethickened_to = plain_arrays(delta)
    bands = base.bands
    numbers = bands.touched(removed, added, rethickened)
    found, rows, ends, change = apply_rows(
        bands.gather(bands.places(numbers)),
        removed,
        added,
        added_thickness,
        rethickened,
        rethickened_to,
        numbers,
    )
    if found != GOOD:
        raise ValueError(REASONS[found])
    return VectorMap.of_bands(
        base.lattice,
        bands.replaced(numbers.tolist(), rows, ends.tolist()),
        epsilon_cells=base.epsilon_cells,
        profile=base.profile,
        digest=(base.digest + int(change)) & _MASK,
    )


def find_rows(haystack: NDArray[np.int32], needles: NDArray[np.int32]) -> NDArray[np.int64]:
    """(k,) place of each needle, (k, 5), among the haystack's canonical rows, (n, 5); -1 where it is missing."""
    rows = np.zeros((len(haystack), 6), np.int32)
    rows[:, :5] = haystack
    return Bands.of(rows).find(plain_edges(needles))


def plain_arrays(
    delta: MapDelta,
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.uint8], NDArray[np.int32], NDArray[np.uint8]]:
    """The five arrays of a delta as kernels take them.

    Raises
    ------
    ValueError : there are not as many thicknesses as edges
    """
    added_thickness, rethickened_to = (
        np.array(delta.added_thickness, np.uint8),
        np.array(delta.rethickened_to, np.uint8),
    )
    if added_thickness.shape != (len(delta.added),) or rethickened_to.shape != (len(delta.rethickened),):
        raise ValueError("the delta has not as many thicknesses as edges")
    removed, added, rethickened = plain_edges(delta.removed), plain_edges(delta.added), plain_edges(delta.rethickened)
    return removed, added, added_thickness, rethickened, rethickened_to


def plain_edges(edges: NDArray[np.int32]) -> NDArray[np.int32]:
    """(n, 5) a copy that a kernel takes: contiguous and writeable."""
    return np.array(edges, np.int32, order="C").reshape(-1, 5)


__all__ = ["MapDelta", "apply", "diff", "find_rows"]
