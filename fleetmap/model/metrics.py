"""How alike two maps are: the paper's metrics, where it leaves them loose as ``docs`` and ``compare`` state them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.checks import check_type
from fleetmap.model.errors import MapFormatError
from fleetmap.model.graded import warn_of_thresholds
from fleetmap.model.grid import MAX_CELLS, OccupancyGrid
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN

CLIP_CELLS = math.hypot(20, 20)
"""Distance in cells from which a cell counts as wholly missed: r of the paper."""

SLACK_CELLS = 1 / 32
"""An offset below this is a rounded origin in a YAML file, and no reason for one more row of cells."""


@dataclass(frozen=True, slots=True)
class Metrics:
    """Per cent, 100 = alike. See ``compare``."""

    MS: float
    CC: float
    PC: float
    OPDF: float
    UPDF: float
    OPDF_reverse: float
    UPDF_reverse: float


def compare(a: OccupancyGrid, b: OccupancyGrid) -> Metrics:
    """Compare two maps of one frame over the union of their extents, the rest of which is unknown.

    Cells are those of ``b``'s lattice; where ``a`` has another resolution, phase or yaw, each of them takes
    the cell of ``a`` that its centre lies in.

    - MS: share of cells in the same of the three states.
    - CC: Pearson's correlation of the values free 0, unknown 0.5, occupied 1; PC: of the occupied mask.
      Where one map has a single value everywhere, correlation is undefined: 100 if the maps agree in every
      cell (for PC: in the mask), else 0. Anticorrelated maps have a negative one.
    - OPDF: 100 (1 - mean(min(d, r)) / r), d = L1 distance in cells from each occupied cell of ``a`` to the
      nearest one of ``b``, r = hypot(20, 20). UPDF: the same for free (unoccupied) cells. It forgives what
      ``a`` lacks; ``OPDF_reverse`` and ``UPDF_reverse``, from ``b`` to ``a``, do not. A class without
      cells against one with cells is 0, in both directions; against none, 100.

    Raises
    ------
    MapFormatError : the union has more than ``MAX_CELLS`` cells
    ConfigError : one of them is no ``OccupancyGrid``
    """
    for option, grid in (("a", a), ("b", b)):
        check_type(option, grid, OccupancyGrid, hint="of a MergedMap .to_grid() makes one, of a VectorMap rasterize()")
        warn_of_thresholds(grid)
    states_a, states_b = on_common_lattice(a, b)
    pairs = np.bincount((3 * states_a + states_b).ravel(), minlength=9).reshape(3, 3)
    is_occupied = np.array([0.0, 1.0, 0.0])  # by state: FREE, OCCUPIED, UNKNOWN
    value = np.array([0.0, 1.0, 0.5])
    occupied_a, occupied_b = states_a == OCCUPIED, states_b == OCCUPIED
    free_a, free_b = states_a == FREE, states_b == FREE
    return Metrics(
        MS=100 * float(np.trace(pairs)) / states_a.size,
        CC=_correlation(pairs, value),
        PC=_correlation(pairs, is_occupied),
        OPDF=_distance_score(occupied_a, occupied_b),
        UPDF=_distance_score(free_a, free_b),
        OPDF_reverse=_distance_score(occupied_b, occupied_a),
        UPDF_reverse=_distance_score(free_b, free_a),
    )


def on_common_lattice(a: OccupancyGrid, b: OccupancyGrid) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """States of both maps, each (height, width) uint8, over the union of their extents on ``b``'s lattice.

    Raises
    ------
    MapFormatError : the union has more than ``MAX_CELLS`` cells
    """
    T_b_a = b.origin.inverse() @ a.origin
    size_m = np.array([a.width, a.height]) * a.resolution_m
    with np.errstate(over="ignore", invalid="ignore"):  # too far apart is found below
        corners = T_b_a.apply(size_m * [[0, 0], [1, 0], [0, 1], [1, 1]]) / b.resolution_m
        low = np.minimum(np.floor(corners.min(axis=0) + SLACK_CELLS), 0)
        high = np.maximum(np.ceil(corners.max(axis=0) - SLACK_CELLS), [b.width, b.height])
        cells = float(np.prod(high - low))
    if not cells <= MAX_CELLS:
        reason = f"together they span {cells:.3g} cells of {b.resolution_m} m; at most {MAX_CELLS}"
        raise MapFormatError(path="<two grids>", field="extent", reason=reason)
    x0, y0 = int(low[0]), int(low[1])
    width, height = int(high[0]) - x0, int(high[1]) - y0

    states_b = np.full((height, width), UNKNOWN, np.uint8)
    states_b[-y0 : b.height - y0, -x0 : b.width - x0] = b.states_yx()

    states_a = np.full((height, width), UNKNOWN, np.uint8)
    source = a.states_yx()
    T_a_b = T_b_a.inverse()
    centres_xy = np.empty((width, 2))
    centres_xy[:, 0] = (np.arange(width) + x0 + 0.5) * b.resolution_m
    for row in range(height):
        centres_xy[:, 1] = (row + y0 + 0.5) * b.resolution_m
        j, i = np.floor(T_a_b.apply(centres_xy) / a.resolution_m).astype(np.int64).T
        inside = (i >= 0) & (i < a.height) & (j >= 0) & (j < a.width)
        states_a[row, inside] = source[i[inside], j[inside]]
    return states_a, states_b


def _correlation(pairs: NDArray[np.int64], value: NDArray[np.float64]) -> float:
    """Pearson's coefficient, per cent, of two maps whose states occur together ``pairs[a, b]`` times."""
    n = pairs.sum()
    counts_a, counts_b = pairs.sum(axis=1), pairs.sum(axis=0)
    mean_a, mean_b = counts_a @ value / n, counts_b @ value / n
    variance = (counts_a @ (value - mean_a) ** 2) * (counts_b @ (value - mean_b) ** 2)
    if variance == 0 or _one_value(counts_a, value) or _one_value(counts_b, value):
        differ = value[:, None] != value[None, :]
        return 0.0 if pairs[differ].any() else 100.0
    coefficient = float((value - mean_a) @ pairs @ (value - mean_b)) / math.sqrt(variance)
    return 100 * min(1.0, max(-1.0, coefficient))  # rounding


def _one_value(counts: NDArray[np.int64], value: NDArray[np.float64]) -> bool:
    """Whether all cells have one value; asked of the counts, since a mean rounds."""
    return len(np.unique(value[counts > 0])) == 1


def _distance_score(from_yx: NDArray[np.bool_], to_yx: NDArray[np.bool_]) -> float:
    from scipy.ndimage import distance_transform_cdt

    if not from_yx.any() or not to_yx.any():
        return 0.0 if from_yx.any() or to_yx.any() else 100.0
    distance = distance_transform_cdt(~to_yx, metric="taxicab")[from_yx]
    return float(100 * (1 - np.minimum(distance, CLIP_CELLS).mean() / CLIP_CELLS))
