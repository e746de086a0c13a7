"""Grid to vector map: one epoch's vectorizer, whose edges stick as long as they hold."""

from __future__ import annotations

import math
import operator

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.checks import check_number, check_type
from fleetmap.model.delta import MapDelta, apply
from fleetmap.model.errors import ConfigError
from fleetmap.model.graded import warn_of_lost_values, warn_of_thresholds
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import EPSILON_CELLS, Lattice
from fleetmap.model.vectormap import VectorMap
from fleetmap.vectorize.arcs import Arcs
from fleetmap.vectorize.fresh import trace_grid
from fleetmap.vectorize.phase import SIXTEENTHS, lattice_of, place_on_lattice
from fleetmap.vectorize.specks import SPECK_CELLS, check_specks
from fleetmap.vectorize.store import Store
from fleetmap.vectorize.update import Changes, refresh_states, update_arcs

MIN_EPSILON_CELLS, MAX_EPSILON_CELLS = 0.5, 64.0
EXACT_EPSILON2 = 63
"""In sixteenths squared: just below half a cell, so that no edge comes to lie on, or passes over, a cell's centre."""

PROFILES = ("share", "full", "exact")

MAX_STORED_CELLS = 1 << 26
"""What all grids of one epoch may span, with all that lies between them, before a new one is asked for: some 500 MB. A
grid that has half as many cells by itself may span more."""


class Vectorizer:
    """Turns the successive grids of one map frame into vector maps on one lattice.

    The first grid fixes the lattice. Later ones may have another size and origin, also by a fraction of a cell,
    but not another resolution or yaw. An edge of the last map stays as long as it is certified against the new
    grid, whether or not cells near it changed: so sensor noise moves few edges, and the same grid gives the
    same map. The cost of an update is in proportion to the part of the map that changed.

    Parameters
    ----------
    profile : ``share``, the boundary of free space, with a thickness behind obstacles; ``full``, all boundaries
        between the three states; ``exact``, as ``full`` and lossless: epsilon is just below half a cell, and no
        speck is dropped
    epsilon_cells : error bound, 0.5 to 64 cells; sqrt(2) by default
    specks : free and unknown specks of at most so many cells are dropped, 12 by default; 0 keeps all
    free_below, occupied_above : per cent, instead of those of the grids; see ``OccupancyGrid``

    Raises
    ------
    ConfigError : a parameter is out of its range, or given for the profile ``exact``, which has its own

    Notes
    -----
    Warns once with ``MapWarning`` if a grid with values between 0 and 100 has hardly any cell that counts as free or as
    occupied, and if the profile ``exact``, which keeps states alone, is given such values.
    """

    def __init__(
        self,
        *,
        profile: str = "share",
        epsilon_cells: float | None = None,
        specks: int | None = None,
        free_below: float | None = None,
        occupied_above: float | None = None,
    ) -> None:
        if profile not in PROFILES:
            raise ConfigError(option="profile", value=profile, reason=f"expected {', '.join(PROFILES)}")
        if profile == "exact":
            for option, value in (("epsilon_cells", epsilon_cells), ("specks", specks)):
                if value is not None:
                    raise ConfigError(option=option, value=value, reason="the profile exact has its own")
            specks = 0
            self.epsilon2 = EXACT_EPSILON2
            self.epsilon_cells = math.sqrt(EXACT_EPSILON2) / SIXTEENTHS
        else:
            specks = SPECK_CELLS if specks is None else specks
            self.epsilon_cells = check_number(
                "epsilon_cells",
                EPSILON_CELLS if epsilon_cells is None else epsilon_cells,
                expected=f"{MIN_EPSILON_CELLS} to {MAX_EPSILON_CELLS} cells",
                fits=lambda cells: MIN_EPSILON_CELLS <= cells <= MAX_EPSILON_CELLS,
            )
            # Squared, in sixteenths; sqrt(2) gives exactly 2 cells squared, and nothing is rounded up.
            self.epsilon2 = math.floor(self.epsilon_cells**2 * SIXTEENTHS**2 + 1e-6)
        self.profile = profile
        self.specks = check_specks(specks)
        for option, value in (("free_below", free_below), ("occupied_above", occupied_above)):
            if value is not None:
                check_number(option, value, expected="per cent, between 0 and 100", fits=lambda v: 0 < v < 100)
        self.free_below, self.occupied_above = free_below, occupied_above
        self._told = False
        self.warned = False
        """Whether a grid was found whose thresholds don't suit it, and told: a warning comes once."""
        self.lattice: Lattice | None = None
        self.dropped_specks = 0
        """Specks that the last update filled where it looked, and their cells:"""
        self.dropped_cells = 0
        self.splits = 0
        """Edges that the last update split so that edges meet only at vertices."""
        self.edges_before_splits = 0
        """Edges of the first map before any was split."""
        self.redone = 0
        """Edges that the last update gave up though they held, since all around them took too many vertices."""
        self._map: VectorMap | None = None
        self._extent = (0, 0, 0, 0)
        self._phase_yx = (0, 0)
        self._limits = (0, 0)
        self._store: Store | None = None
        self._fresh: Arcs | None = None
        """The arcs of the first map, until they are stored for the second."""

    def update(self, grid: OccupancyGrid, changed_window: tuple[int, int, int, int] | None = None) -> VectorMap:
        """Vectorize the next grid of this epoch.

        Parameters
        ----------
        grid : with the resolution and yaw of the first one
        changed_window : rows and columns (row0, column0, row1, column1) of the grid, half open, outside of which no
            cell has changed since the last update; None: any may have. Where the grid begins and ends may change in
            any case.

        Returns
        -------
        VectorMap : certified: every point of the grid's boundary is within epsilon of an edge of its label, every
            point of an edge within epsilon of that boundary, and edges meet only at vertices. It shares what did not
            change with the last one.

        Raises
        ------
        ConfigError : another resolution or yaw, or a phase that this epsilon is too small for: a new epoch (a
            new ``Vectorizer``) is needed; or a window that isn't one
        """
        check_type("grid", grid, OccupancyGrid, hint="OccupancyGrid(cells_yx, resolution_m) makes one of an array")
        grid = grid.with_thresholds(free_below=self.free_below, occupied_above=self.occupied_above)
        lattice = self.lattice or lattice_of(grid)
        shift_yx, phase_yx = place_on_lattice(grid, lattice)
        if phase_yx[0] ** 2 + phase_yx[1] ** 2 > self.epsilon2:
            raise ConfigError(
                option="epsilon_cells",
                value=self.epsilon_cells,
                reason=f"the grid is ({phase_yx[1]}, {phase_yx[0]}) / 16 cells off the lattice: start a new epoch",
            )
        extent = (*shift_yx, shift_yx[0] + grid.height, shift_yx[1] + grid.width)
        if changed_window is not None:
            changed_window = _checked_window(changed_window, grid)
            if grid.limits != self._limits:  # other thresholds change cells everywhere
                changed_window = None
        if not self.warned:
            self.warned = warn_of_thresholds(grid)
        if self.profile == "exact" and not self._told:
            self._told = warn_of_lost_values(grid, "the profile exact")
        if self._map is None:
            self._begin(grid, lattice, shift_yx, phase_yx)
        else:
            self._go_on(grid, shift_yx, phase_yx, extent, changed_window)
        self.lattice, self._extent, self._phase_yx, self._limits = lattice, extent, phase_yx, grid.limits
        assert self._map is not None
        return self._map

    def _begin(
        self, grid: OccupancyGrid, lattice: Lattice, shift_yx: tuple[int, int], phase_yx: tuple[int, int]
    ) -> None:
        store = Store(shift_yx, (shift_yx[0] + grid.height, shift_yx[1] + grid.width), self.epsilon_cells)
        arcs, (self.dropped_specks, self.dropped_cells) = trace_grid(
            grid, store, shift_yx, self.specks, self.profile == "share"
        )
        self.splits, self.edges_before_splits = arcs.build(
            store.cracks, store.low_yx, phase_yx, self.epsilon2, self.epsilon2
        )
        edges, _, _, arc_of = arcs.edges()
        rows = np.column_stack([edges[:-1, :4], arcs.labels[arc_of]])
        self._map = VectorMap(lattice, rows, arcs.thickness[arc_of], self.epsilon_cells, self.profile)
        self._store, self._fresh = store, arcs

    def _go_on(
        self,
        grid: OccupancyGrid,
        shift_yx: tuple[int, int],
        phase_yx: tuple[int, int],
        extent: tuple[int, int, int, int],
        changed_window: tuple[int, int, int, int] | None,
    ) -> None:
        store = self._store
        assert store is not None
        assert self._map is not None
        if self._fresh is not None:
            arcs = self._fresh
            store.remember(arcs, np.repeat(arcs.thickness, np.diff(arcs.offsets)))
            self._fresh = None
        between = store.cells_to_cover(extent[:2], extent[2:])
        if between > max(MAX_STORED_CELLS, 2 * grid.height * grid.width):
            raise ConfigError(
                option="origin",
                value=grid.origin,
                reason=f"so far from the grids before that all between them takes {between} cells: start a new epoch",
            )
        store.cover(extent[:2], extent[2:])
        old = self._extent
        window = (min(old[0], extent[0]), min(old[1], extent[1]), max(old[2], extent[2]), max(old[3], extent[3]))
        if changed_window is not None and old == extent:
            row0, column0, row1, column1 = changed_window
            window = (shift_yx[0] + row0, shift_yx[1] + column0, shift_yx[0] + row1, shift_yx[1] + column1)
        dirty, (self.dropped_specks, self.dropped_cells) = refresh_states(grid, store, shift_yx, window, self.specks)
        self.splits = self.redone = 0
        moved = phase_yx != self._phase_yx
        if moved:
            dirty = None
        elif dirty is None:
            return
        changes = update_arcs(store, dirty, phase_yx, moved, self.epsilon2, self.profile == "share")
        self.splits, self.redone = changes.splits, changes.redone
        delta = _delta(changes)
        if len(delta):
            self._map = apply(self._map, delta)


def _checked_window(window: object, grid: OccupancyGrid) -> tuple[int, int, int, int]:
    try:
        row0, column0, row1, column1 = map(operator.index, window)  # type: ignore[call-overload]
        good = 0 <= row0 <= row1 <= grid.height and 0 <= column0 <= column1 <= grid.width
    except (TypeError, ValueError):
        good = False
    if not good:
        reason = f"expected (row0, column0, row1, column1) of a grid of {grid.height} x {grid.width} cells"
        raise ConfigError(option="changed_window", value=window, reason=reason)
    return row0, column0, row1, column1


def _delta(changes: Changes) -> MapDelta:
    removed, added, rethickened = (_canonical(r) for r in (changes.removed, changes.added, changes.rethickened))
    return MapDelta(
        removed[:, :5],
        added[:, :5],
        added[:, 5].astype(np.uint8),
        rethickened[:, :5],
        rethickened[:, 5].astype(np.uint8),
    )


def _canonical(rows: NDArray[np.int64]) -> NDArray[np.int32]:
    """Rows (edge, thickness) in the order of maps."""
    from fleetmap.model.band_kernels import canonical_rows

    _, result = canonical_rows(np.ascontiguousarray(rows[:, :5]), np.ascontiguousarray(rows[:, 5]))
    return result


def vectorize(
    grid: OccupancyGrid,
    *,
    profile: str = "share",
    epsilon_cells: float | None = None,
    specks: int | None = None,
    free_below: float | None = None,
    occupied_above: float | None = None,
) -> VectorMap:
    """Vectorize one grid by itself; see ``Vectorizer``.

    Examples
    --------
    >>> import numpy as np
    >>> from fleetmap.model.grid import OccupancyGrid
    >>> room = np.full((20, 30), 100, np.int8)
    >>> room[2:-2, 2:-2] = 0
    >>> vectorize(OccupancyGrid(room, 0.05)).edges.tolist()
    [[2, 2, 2, 28, 1], [2, 2, 18, 2, 3], [2, 28, 18, 28, 1], [18, 2, 18, 28, 3]]
    """
    vectorizer = Vectorizer(
        profile=profile,
        epsilon_cells=epsilon_cells,
        specks=specks,
        free_below=free_below,
        occupied_above=occupied_above,
    )
    return vectorizer.update(grid)
