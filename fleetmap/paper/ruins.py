"""Unstructured terrain of the experiments: walls and blocks at small angles to the axes, bent and overlapping.

The simulator's own unstructured world is a cave whose outline runs in all directions alike. On a lattice more than
half of such an outline's cracks are corners, however good the mapper is; a terrain of mostly small angles
leaves the raggedness to the mapper, as in the mazes and offices.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.sims.worlds import CELL_M

PIECES_PER_M2 = 0.055
BLOCK_M = (0.6, 2.4)
WALL_LENGTH_M, WALL_WIDTH_M = (2.0, 8.0), (0.3, 0.6)
BORDER_M = 0.8

SLOPE = 0.03
"""Mean slope (rms) of a wall against its axis, per axis: about 1.7 degrees, seldom more than 5."""

BEND_M = 2.5
"""Over about this length a wall changes its direction."""

PASSAGE_M = 0.45
"""Half of the narrowest passage that is left open: what is narrower becomes solid."""


def make_ruins(size_m: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    """(height, width) bool, closed by an outer wall; all that is open is within reach of a robot.

    Upright pieces are dropped at random, then the whole terrain is bent by a smooth field of shifts.
    """
    from scipy import ndimage

    side = round(size_m / CELL_M)
    solid = np.zeros((side, side), bool)
    for _ in range(int(PIECES_PER_M2 * size_m**2)):
        drop_piece(solid, rng)
    border = round(BORDER_M / CELL_M)
    solid[:border] = solid[-border:] = True
    solid[:, :border] = solid[:, -border:] = True

    rows, columns = np.mgrid[:side, :side]
    source = [rows + smooth_shift(side, rng), columns + smooth_shift(side, rng)]
    bent: NDArray[np.bool_] = (
        ndimage.map_coordinates(solid.astype(np.uint8), source, order=0, mode="constant", cval=1) > 0
    )
    bent[:2] = bent[-2:] = True
    bent[:, :2] = bent[:, -2:] = True

    wide = ndimage.distance_transform_edt(~bent) * CELL_M > PASSAGE_M
    labels, found = ndimage.label(wide)
    if found == 0:
        return bent
    largest = 1 + int(np.argmax(np.bincount(labels.ravel())[1:]))
    # Squares, not discs, about the largest space: they leave corners as they are.
    far: NDArray[np.bool_] = ndimage.distance_transform_cdt(labels != largest, metric="chessboard") * CELL_M > PASSAGE_M
    return bent | far


def drop_piece(solid: NDArray[np.bool_], rng: np.random.Generator) -> None:
    """A block or a piece of wall, anywhere."""
    if rng.random() < 0.5:
        sides_m = rng.uniform(*BLOCK_M), rng.uniform(*BLOCK_M)
    else:
        sides_m = rng.uniform(*WALL_LENGTH_M), rng.uniform(*WALL_WIDTH_M)
        if rng.random() < 0.5:
            sides_m = sides_m[::-1]
    height, width = (round(side / CELL_M) for side in sides_m)
    row, column = (int(place) for place in rng.integers(0, solid.shape[0], 2))
    top, left = max(row - height // 2, 0), max(column - width // 2, 0)
    solid[top : row + height // 2, left : column + width // 2] = True


def smooth_shift(side: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """(side, side) shifts in cells, smooth over ``BEND_M``, with gradients of ``SLOPE`` (root of mean square)."""
    from scipy import ndimage

    shift = ndimage.gaussian_filter(rng.normal(size=(side, side)), BEND_M / CELL_M, mode="reflect", truncate=3.0)
    down, across = np.gradient(shift)
    steep: NDArray[np.float64] = SLOPE * shift / np.sqrt((down**2 + across**2).mean())
    return steep
