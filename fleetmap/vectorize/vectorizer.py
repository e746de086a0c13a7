"""Grid to vector map: one epoch's vectorizer, whose edges stick as long as they hold."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from fleetmap.model.errors import ConfigError
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import EPSILON_CELLS, Lattice
from fleetmap.model.vectormap import VectorMap
from fleetmap.vectorize.boundary import trace_boundary
from fleetmap.vectorize.phase import SIXTEENTHS, lattice_of, place_on_lattice
from fleetmap.vectorize.simplify import Chains, simplify
from fleetmap.vectorize.thickness import measure_thickness

SPECK_CELLS = 12
"""Free and unknown specks of at most so many cells are dropped by default: with noise they are most of a map."""

MIN_EPSILON_CELLS, MAX_EPSILON_CELLS = 0.5, 64.0
MAX_SPECK_CELLS = 10_000


class Vectorizer:
    """Turns the successive grids of one map frame into vector maps on one lattice.

    The first grid fixes the lattice. Later ones may have another size and origin, also by a fraction of a cell,
    but not another resolution or yaw. An edge of the last map stays as long as it is certified against the new
    grid, whether or not cells near it changed: so sensor noise moves few edges, and the same grid gives the
    same map.

    Parameters
    ----------
    epsilon_cells : error bound, 0.5 to 64 cells
    specks : free and unknown specks of at most so many cells are dropped; 0 keeps all

    Raises
    ------
    ConfigError : a parameter is out of its range
    """

    def __init__(self, *, epsilon_cells: float = EPSILON_CELLS, specks: int = SPECK_CELLS) -> None:
        if not MIN_EPSILON_CELLS <= epsilon_cells <= MAX_EPSILON_CELLS:
            raise ConfigError(
                option="epsilon_cells",
                value=epsilon_cells,
                reason=f"expected {MIN_EPSILON_CELLS} to {MAX_EPSILON_CELLS} cells",
            )
        if not 0 <= specks <= MAX_SPECK_CELLS:
            raise ConfigError(option="specks", value=specks, reason=f"expected 0 to {MAX_SPECK_CELLS} cells")
        self.epsilon_cells = epsilon_cells
        self.specks = specks
        # Squared, in sixteenths; sqrt(2) gives exactly 2 cells squared, and nothing is rounded up.
        self.epsilon2 = math.floor(epsilon_cells**2 * SIXTEENTHS**2 + 1e-6)
        self.lattice: Lattice | None = None
        self.dropped_specks = 0
        """Specks that the last update dropped, and their cells:"""
        self.dropped_cells = 0
        self._chains: Chains | None = None

    def update(self, grid: OccupancyGrid) -> VectorMap:
        """Vectorize the next grid of this epoch.

        Parameters
        ----------
        grid : with the resolution and yaw of the first one

        Returns
        -------
        VectorMap : certified: every point of the grid's boundary of free space is within epsilon of an edge of
            its label, every point of an edge within epsilon of that boundary, and edges meet only at vertices

        Raises
        ------
        ConfigError : another resolution or yaw, or a phase that this epsilon is too small for: a new epoch (a
            new ``Vectorizer``) is needed
        """
        lattice = self.lattice or lattice_of(grid)
        shift_yx, phase_yx = place_on_lattice(grid, lattice)
        if phase_yx[0] ** 2 + phase_yx[1] ** 2 > self.epsilon2:
            raise ConfigError(
                option="epsilon_cells",
                value=self.epsilon_cells,
                reason=f"the grid is ({phase_yx[1]}, {phase_yx[0]}) / 16 cells off the lattice: start a new epoch",
            )
        boundary = trace_boundary(grid.states_yx(), specks=self.specks, shift_yx=shift_yx, phase_yx=phase_yx)
        chains, edge_of = simplify(boundary, self.epsilon2, self._chains)
        thickness = measure_thickness(boundary, chains, edge_of)
        edges = np.column_stack([chains.at, chains.at[chains.following], chains.labels]).astype(np.int32)

        self.lattice = lattice
        self.dropped_specks, self.dropped_cells = boundary.dropped
        self._chains = replace(chains, thickness=thickness)
        return VectorMap(lattice, edges, thickness.astype(np.uint8), self.epsilon_cells)


def vectorize(grid: OccupancyGrid, *, epsilon_cells: float = EPSILON_CELLS, specks: int = SPECK_CELLS) -> VectorMap:
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
    return Vectorizer(epsilon_cells=epsilon_cells, specks=specks).update(grid)
