"""Grids of ROS, whole and as rectangles: the newest map is taken once, and what is wrong changes nothing of it."""

import itertools
import math
import threading

import numpy as np
import pytest
from conftest import two_rooms
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fleetmap.bridges import cdr, grids
from fleetmap.model.errors import MapFormatError
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.pose import Pose2

pytest.importorskip("rosbags")

GRID = OccupancyGrid(np.array([[0, 100, -1], [50, 1, 99]], np.int8), 0.05, Pose2(1.0, -2.0, 0.7))
CHANGED = OccupancyGrid(np.array([[0, 100, -1], [50, 0, 98]], np.int8), 0.05, Pose2(1.0, -2.0, 0.7))


def message_of(grid, frame_id="/map"):
    return grids.map_message(grid, frame_id=frame_id, stamp_ns=0)


def rectangle(x, y, width, height, data):
    header = cdr.header("map", 0)
    return cdr.make(cdr.MAP_UPDATE, header=header, x=x, y=y, width=width, height=height, data=np.array(data, np.int8))


def test_the_newest_map_is_taken_once():
    latest = grids.LatestMap()
    assert latest.take() is None
    assert not latest.update(rectangle(0, 0, 1, 1, [7]))
    assert latest.replace(message_of(two_rooms()))
    assert latest.replace(message_of(GRID))
    taken = latest.take()
    assert np.array_equal(taken.cells_yx, GRID.cells_yx)
    assert (taken.resolution_m, taken.origin.x_m, latest.frame_id) == (0.05, 1.0, "map")
    assert latest.take() is None


def test_updates_make_a_map_new_and_change_none_that_was_taken():
    latest, data = grids.LatestMap(), GRID.cells_yx.reshape(-1).copy()
    message = message_of(GRID)
    message.data = data
    latest.replace(message)
    data[:] = 77
    before = latest.take()
    assert latest.update(rectangle(1, 0, 2, 1, [3, 4]))
    assert latest.take().cells_yx.tolist() == [[0, 3, 4], [50, 1, 99]]
    assert np.array_equal(before.cells_yx, GRID.cells_yx)
    assert latest.update(rectangle(3, 2, 0, 0, []))
    assert latest.take() is None


@pytest.mark.parametrize(
    "wrong",
    [
        rectangle(-1, 0, 1, 1, [7]),
        rectangle(0, -1, 1, 1, [7]),
        rectangle(3, 0, 1, 1, [7]),
        rectangle(2, 0, 2, 1, [7, 7]),
        rectangle(0, 1, 1, 2, [7, 7]),
        rectangle(0, 0, 4, 3, [7] * 12),
        rectangle(0, 0, 2, 2, [7] * 3),
        rectangle(0, 0, 2**31, 2**31, [7]),
        rectangle(2**31 - 1, 2**31 - 1, 1, 1, [7]),
    ],
)
def test_of_an_update_that_lies_elsewhere_nothing_is_applied(wrong):
    latest = grids.LatestMap()
    latest.replace(message_of(GRID))
    latest.take()
    with pytest.raises(MapFormatError):
        latest.update(wrong)
    assert latest.take() is None
    latest.update(rectangle(0, 0, 1, 1, [0]))
    assert np.array_equal(latest.take().cells_yx, GRID.cells_yx)


def test_a_map_without_cells_is_none_and_leaves_the_last_one():
    empty = message_of(GRID, "elsewhere")
    empty.info.width, empty.info.height, empty.data = 0, 0, np.zeros(0, np.int8)
    latest = grids.LatestMap()
    assert not latest.replace(empty)
    assert latest.take() is None
    latest.replace(message_of(GRID))
    assert not latest.replace(empty)
    assert latest.frame_id == "map"
    assert np.array_equal(latest.take().cells_yx, GRID.cells_yx)


HUGE = cdr.make("geometry_msgs/msg/Quaternion", x=1e200, y=-1e200, z=1e200, w=1e200)


@pytest.mark.parametrize(
    ("field", "value"), [("resolution", math.nan), ("resolution", -0.05), ("width", 2), ("orientation", HUGE)]
)
def test_of_a_map_with_a_wrong_field_nothing_is_applied(field, value):
    # The huge rotation: the bridge expects MapFormatError, and a ConfigError of Pose2 leaves its callback.
    wrong = message_of(CHANGED, "elsewhere")
    setattr(wrong.info.origin if field == "orientation" else wrong.info, field, value)
    latest = grids.LatestMap()
    latest.replace(message_of(GRID))
    with pytest.raises(MapFormatError):
        latest.replace(wrong)
    assert latest.frame_id == "map"
    assert np.array_equal(latest.take().cells_yx, GRID.cells_yx)


def cells(shape):
    return arrays(np.int8, shape, elements=st.sampled_from([-1, 0, 50, 100]))


@given(st.tuples(st.integers(1, 7), st.integers(1, 7)).flatmap(lambda s: st.tuples(cells(s), cells(s))))
def test_an_update_makes_the_one_grid_of_the_other_and_is_no_larger_than_needed(pair):
    before, after = (OccupancyGrid(c, 0.05, Pose2(1.0, 2.0, 0.0)) for c in pair)
    message = grids.update_message(before, after, frame_id="map", stamp_ns=5)
    changed = np.argwhere(before.cells_yx != after.cells_yx)
    if message is None:
        assert len(changed) == 0
        return
    assert [message.y, message.x] == changed.min(axis=0).tolist()
    assert [message.y + message.height, message.x + message.width] == (changed.max(axis=0) + 1).tolist()
    latest = grids.LatestMap()
    latest.replace(message_of(before))
    latest.update(cdr.decode(cdr.encode(message, cdr.MAP_UPDATE), cdr.MAP_UPDATE, topic="/t"))
    assert np.array_equal(latest.take().cells_yx, after.cells_yx)


@pytest.mark.parametrize(
    "other",
    [
        GRID,
        OccupancyGrid(CHANGED.cells_yx, 0.1, GRID.origin),
        OccupancyGrid(CHANGED.cells_yx, 0.05, Pose2(1.0, -2.0, 0.71)),
        OccupancyGrid(CHANGED.cells_yx.T, 0.05, GRID.origin),
        OccupancyGrid(CHANGED.cells_yx[:, :2], 0.05, GRID.origin),
    ],
)
def test_there_is_no_update_of_nothing_or_between_grids_of_other_places_and_sizes(other):
    assert grids.update_message(GRID, other, frame_id="map", stamp_ns=5) is None


def test_two_threads_never_see_half_a_map():
    latest, done, torn = grids.LatestMap(), threading.Event(), []
    whole = [OccupancyGrid(np.full((60, 60), k, np.int8), 0.05) for k in range(4)]

    def take():
        while not done.is_set():
            grid = latest.take()
            if grid is not None and len(np.unique(grid.cells_yx)) != 1:
                torn.append(grid)

    thread = threading.Thread(target=take)
    thread.start()
    try:
        for grid in itertools.islice(itertools.cycle(whole), 300):
            latest.replace(message_of(grid))
            latest.update(rectangle(0, 0, 60, 60, np.full(3600, grid.cells_yx[0, 0] + 50)))
    finally:
        done.set()
        thread.join()
    assert torn == []
