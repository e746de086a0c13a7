"""``MergedMap``: what all replicas of a component say together, as an arrangement on the fleet lattice."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.checks import as_number
from fleetmap.model.errors import MapFormatError
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN
from fleetmap.model.pose import Pose2

FLEET_UM = 5_000
"""One step of the fleet lattice: 5 mm."""

GRID_UM = 500
"""Cells of drawn grids are whole multiples of 0.5 mm."""

MAX_CELL_UM = 1_000_000_000
"""Largest cell of a drawn grid (1 km): products in the painting then fit 64 bits."""

ORIGIN_UM = 1_024_000_000
"""Origins of merged maps lie on whole multiples of 1024 m: 204800 steps, and whole cells of most resolutions."""

MAX_ORIGIN_UM = ORIGIN_UM << 15
"""Farthest origin along one axis (33554 km): beyond all that poses and vector maps can name."""

MAX_FLEET_COORDINATE = 1 << 21
"""No |coordinate| of a merged map is larger, in lattice steps from its origin (10.5 km)."""

Y0, X0, Y1, X1, LEFT, RIGHT, OBSTACLE, THICKNESS = range(8)
"""Columns of ``MergedMap.edges``."""


@dataclass(frozen=True, eq=False)
class MergedMap:
    """An arrangement: edges that meet only at vertices, each with the states of its two sides.

    Parameters
    ----------
    edges : (n, 8) int32 rows (y0, x0, y1, x1, left, right, obstacle, thickness) in steps of the fleet
        lattice (``FLEET_UM``) from its origin, ascending, (y0, x0) < (y1, x1). ``left`` and ``right`` are
        FREE, OCCUPIED or UNKNOWN, seen from (y0, x0); ``obstacle`` is 1 for a wall. Equal sides are allowed
        on a wall that was seen from both sides. ``thickness``, also in lattice steps, is how deep the wall is
        known to be on its sides that are not free.
    resolution_um : the cell size of the finest source, for ``to_grid``'s default
    tolerance : how far a source obstacle may be from the merged one that stands for it, in lattice steps
    origin_um : (x, y) micrometres, where the lattice begins in the component's frame; multiples of ``ORIGIN_UM``.
        All that is in metres (``segments_xy``, ``bounds_m``, ``to_grid``) has it in already.
    left_out : (frame, reason) of each source that the fold left out, ascending; neither in the bytes nor in files
    """

    edges: NDArray[np.int32]
    resolution_um: int = 50_000
    tolerance: int = 0
    origin_um: tuple[int, int] = (0, 0)
    left_out: tuple[tuple[tuple[str, int, str], str], ...] = ()
    digest: str = field(init=False)

    def __post_init__(self) -> None:
        given = np.asarray(self.edges)
        if given.ndim != 2 or given.shape[1] != 8 or given.dtype.kind not in "iu":
            reason = f"expected (n, 8) integers; found {given.shape} {given.dtype}"
            raise MapFormatError(path="<array>", field="edges", reason=reason)
        rows = np.ascontiguousarray(given, np.int32)
        if not np.array_equal(rows, given):
            raise MapFormatError(path="<array>", field="edges", reason="expected numbers that fit int32")
        if any(v % ORIGIN_UM or abs(v) > MAX_ORIGIN_UM for v in self.origin_um):
            reason = f"expected multiples of {ORIGIN_UM} um up to {MAX_ORIGIN_UM}; found {self.origin_um}"
            raise MapFormatError(path="<array>", field="origin_um", reason=reason)
        object.__setattr__(self, "edges", rows)
        object.__setattr__(self, "digest", hashlib.sha256(self.to_bytes()).hexdigest()[:16])

    def __len__(self) -> int:
        return len(self.edges)

    def to_bytes(self) -> bytes:
        """The canonical bytes that law 0 speaks of: header and edges, little-endian int32.

        The origin is in the header if it isn't (0, 0): two numbers more, so that no bytes mean two maps.
        """
        origin = [v // ORIGIN_UM for v in self.origin_um] if any(self.origin_um) else []
        header = np.array([self.resolution_um, self.tolerance, len(self.edges), *origin], "<i4")
        return header.tobytes() + self.edges.astype("<i4").tobytes()

    @property
    def obstacle(self) -> NDArray[np.bool_]:
        """(n,) which edges are walls."""
        return np.equal(self.edges[:, OBSTACLE], 1)

    @property
    def frontier(self) -> NDArray[np.bool_]:
        """(n,) which edges have free space on one side and unknown on the other, and are no wall."""
        left, right = self.edges[:, LEFT], self.edges[:, RIGHT]
        states = np.minimum(left, right), np.maximum(left, right)
        return np.equal(states[0], FREE) & np.equal(states[1], UNKNOWN) & ~self.obstacle

    @property
    def segments_xy(self) -> NDArray[np.float64]:
        """(n, 2, 2) metres: endpoints (x, y) of the edges in the component's frame."""
        points = self.edges[:, [X0, Y0, X1, Y1]].reshape(-1, 2, 2).astype(np.float64)
        points += np.array(self.origin_um) // FLEET_UM
        return points * (FLEET_UM / 1e6)

    def bounds_m(self) -> tuple[float, float, float, float]:
        """(x_min, y_min, x_max, y_max) in metres; all 0 for an empty map."""
        if len(self) == 0:
            return (0.0, 0.0, 0.0, 0.0)
        points = self.segments_xy.reshape(-1, 2)
        low, high = points.min(axis=0), points.max(axis=0)
        return (float(low[0]), float(low[1]), float(high[0]), float(high[1]))

    def to_grid(self, resolution_m: float | None = None) -> OccupancyGrid:
        """The map as cells, for a costmap: blocked, free and unknown as the merging laws define them.

        Cell corners lie on whole multiples of ``resolution_m`` (default: the finest source's) in the component's
        frame, wherever the map's own origin lies, so that grids of two revisions can be compared cell by cell.

        Raises
        ------
        MapFormatError : the resolution is none of the multiples of 0.5 mm from 5 mm to 1 km, or the grid is too large
        """
        from fleetmap.model.raster import merged_states

        if resolution_m is None:
            asked = self.resolution_um / GRID_UM
        else:
            asked = (as_number(resolution_m) or 0.0) * 1e6 / GRID_UM
            least, most = FLEET_UM // GRID_UM, MAX_CELL_UM // GRID_UM
            if not least <= round(asked) <= most or abs(asked / round(asked) - 1) > 1e-6:  # float32 has seven digits
                reason = (
                    f"expected {FLEET_UM / 1e6} to {MAX_CELL_UM / 1e6:.0f} m, a whole multiple of {GRID_UM / 1e6} m; "
                    f"found {resolution_m!r}"
                )
                raise MapFormatError(path="<merged map>", field="resolution_m", reason=reason)
        # Units in which both a step of the lattice and a cell are whole numbers.
        unit_um = FLEET_UM if round(asked) * GRID_UM % FLEET_UM == 0 else GRID_UM
        step = max(round(asked) * GRID_UM, FLEET_UM) // unit_um
        # The origin in whole cells, and what is left of it in units, which is added to the edges.
        (cells_x, left_x), (cells_y, left_y) = (divmod(v // unit_um, step) for v in self.origin_um)
        edges = self.edges.copy()
        edges[:, [Y0, X0, Y1, X1, THICKNESS]] *= FLEET_UM // unit_um
        edges += np.array([left_y, left_x, left_y, left_x, 0, 0, 0, 0], np.int32)
        states, (low_y, low_x) = merged_states(edges, step)
        cell_m = step * unit_um / 1e6
        origin = Pose2((cells_x + low_x) * cell_m, (cells_y + low_y) * cell_m)
        return OccupancyGrid.from_states(states, cell_m, origin)


__all__ = ["FLEET_UM", "FREE", "OCCUPIED", "UNKNOWN", "MergedMap"]
