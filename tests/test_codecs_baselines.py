import gzip
import io
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from PIL import Image

from fleetmap.codecs.baselines import HEADER_BYTES, gzip_changed_rectangle, gzip_grid, png_grid
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.pose import Pose2

CELLS = np.random.default_rng(5).choice(np.array([-1, 0, 100], np.int8), (40, 30))


def grid(cells: np.ndarray, *, row: int = 0, column: int = 0, yaw_rad: float = 0.0) -> OccupancyGrid:
    """A grid whose cell (0, 0) lies on cell (row, column) of a lattice that is turned by ``yaw_rad``."""
    place = Pose2(3.0, -1.0, yaw_rad) @ Pose2(column * 0.05, row * 0.05)
    return OccupancyGrid(cells, 0.05, Pose2(place.x_m, place.y_m, yaw_rad))


def message(cells: np.ndarray) -> int:
    return HEADER_BYTES + len(gzip.compress(np.ascontiguousarray(cells).tobytes(), 6, mtime=0))


def test_the_whole_grid_is_one_byte_a_cell_and_a_header() -> None:
    assert gzip_grid(grid(CELLS)) == message(CELLS)
    assert gzip_grid(grid(CELLS), 9) <= gzip_grid(grid(CELLS), 1)


def test_an_unchanged_grid_is_not_sent() -> None:
    assert gzip_changed_rectangle(grid(CELLS), grid(CELLS.copy())) == 0


def test_the_smallest_rectangle_around_all_changes_is_sent() -> None:
    new = CELLS.copy()
    new[[7, 20, 11], [4, 9, 25]] = 50
    assert gzip_changed_rectangle(grid(CELLS), grid(new)) == message(new[7:21, 4:26])


@pytest.mark.parametrize("yaw_rad", [0.0, 0.7, math.pi])
def test_new_cells_count_as_changed_wherever_the_grid_grew(yaw_rad: float) -> None:
    old = grid(CELLS[5:, :28], row=5, yaw_rad=yaw_rad)
    assert gzip_changed_rectangle(old, grid(CELLS, yaw_rad=yaw_rad)) == message(CELLS)
    above = grid(CELLS[:30], yaw_rad=yaw_rad)
    assert gzip_changed_rectangle(above, grid(CELLS, yaw_rad=yaw_rad)) == message(CELLS[30:])
    left = grid(CELLS[:, 3:], column=3, yaw_rad=yaw_rad)
    assert gzip_changed_rectangle(left, grid(CELLS, yaw_rad=yaw_rad)) == message(CELLS[:, :3])


def test_a_grid_that_only_shrank_costs_a_header() -> None:
    assert gzip_changed_rectangle(grid(CELLS), grid(CELLS[2:-1, 1:], row=2, column=1)) == HEADER_BYTES


def test_without_a_common_lattice_the_whole_grid_is_sent() -> None:
    new = grid(CELLS)
    whole = gzip_grid(new)
    assert gzip_changed_rectangle(None, new) == whole
    assert gzip_changed_rectangle(OccupancyGrid(CELLS, 0.1, new.origin), new) == whole
    assert gzip_changed_rectangle(OccupancyGrid(CELLS, 0.05, Pose2(3.02, -1.0)), new) == whole
    assert gzip_changed_rectangle(OccupancyGrid(CELLS, 0.05, Pose2(3.0, -1.0, 0.1)), new) == whole
    assert gzip_changed_rectangle(grid(CELLS, row=1000, column=-1000), new) == whole


def test_a_rounded_origin_is_no_change() -> None:
    rounded = OccupancyGrid(CELLS, 0.05, Pose2(3.0004, -0.9997))
    assert gzip_changed_rectangle(rounded, grid(CELLS)) == 0


SMALL = st.tuples(st.integers(1, 6), st.integers(1, 6)).flatmap(
    lambda shape: arrays(np.int8, shape, elements=st.sampled_from([-1, 0, 100]))
)


@given(SMALL, SMALL, st.integers(-8, 8), st.integers(-8, 8))
def test_the_rectangle_agrees_with_a_cell_by_cell_count(
    old: np.ndarray, new: np.ndarray, row: int, column: int
) -> None:
    known = {(i + row, j + column): value for (i, j), value in np.ndenumerate(old)}
    changed = [cell for cell, value in np.ndenumerate(new) if known.get(cell) != value]
    found = gzip_changed_rectangle(grid(old, row=row, column=column), grid(new))
    if changed:
        (i0, j0), (i1, j1) = np.min(changed, axis=0), np.max(changed, axis=0)
        assert found == message(new[i0 : i1 + 1, j0 : j1 + 1])
    else:
        assert found == (0 if (row, column) == (0, 0) and old.shape == new.shape else HEADER_BYTES)


def test_png_is_a_grey_image_of_one_byte_a_cell() -> None:
    file = io.BytesIO()
    Image.fromarray(CELLS.view(np.uint8)).save(file, format="PNG", optimize=True)
    assert png_grid(grid(CELLS)) == HEADER_BYTES + len(file.getvalue())
