"""What people hold is taken for what it is, or refused with a word on what was expected."""

import array
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import two_rooms

import fleetmap
from fleetmap.model.errors import ConfigError, MapFormatError
from fleetmap.model.grid_like import as_grid, grid_of
from fleetmap.model.pose import Pose2
from fleetmap.peer.memory_link import LoopClock, MemoryHub


def message(grid, **changes):
    """A grid as drivers hold it, with a quaternion and float32."""
    half = grid.origin.yaw_rad / 2
    origin = SimpleNamespace(
        position=SimpleNamespace(x=grid.origin.x_m, y=grid.origin.y_m, z=0.0),
        orientation=SimpleNamespace(x=0.0, y=0.0, z=np.sin(half), w=np.cos(half)),
    )
    info = {"resolution": np.float32(grid.resolution_m), "width": grid.width, "height": grid.height, "origin": origin}
    info |= {key: value for key, value in changes.items() if key != "data"}
    data = changes.get("data", grid.cells_yx.reshape(-1))
    return SimpleNamespace(info=SimpleNamespace(**info), data=data)


def same(a, b):
    near = np.allclose([a.origin.x_m, a.origin.y_m, a.origin.yaw_rad], [b.origin.x_m, b.origin.y_m, b.origin.yaw_rad])
    return np.array_equal(a.cells_yx, b.cells_yx) and a.resolution_m == b.resolution_m and near


TURNED = fleetmap.OccupancyGrid(two_rooms().cells_yx, 0.05, Pose2(1.0, -2.0, 0.7))


@pytest.mark.parametrize("grid", [two_rooms(), TURNED])
@pytest.mark.parametrize(
    "hold", [lambda c: c, list, lambda c: array.array("b", c.tobytes()), lambda c: c.view(np.uint8)]
)
def test_a_message_is_read_whatever_holds_its_cells(grid, hold):
    assert same(as_grid(message(grid, data=hold(grid.cells_yx.reshape(-1)))), grid)


def test_resolutions_mean_the_number_that_was_written():
    for resolution_m in (0.05, 0.025, 0.1, 0.03, 1.0):
        assert as_grid(message(two_rooms(), resolution=np.float32(resolution_m))).resolution_m == resolution_m
    assert as_grid(message(two_rooms(), resolution=0.051234567890123)).resolution_m == 0.051234567890123


def test_an_array_and_a_file_are_grids(map_folder):
    grid = two_rooms()
    assert same(as_grid(grid.cells_yx, resolution_m=0.05, origin=grid.origin), grid)
    assert same(as_grid(grid.cells_yx.tolist(), resolution_m=0.05, origin=grid.origin), grid)
    assert same(as_grid(map_folder / "map.yaml"), grid)
    assert same(as_grid(str(map_folder / "map.yaml")), grid)


def test_values_out_of_range_are_obstacles_as_in_nav2():
    cells = np.array([[-1, 0, 50, 100, 101, 127, -2, -128]], np.int8)
    assert as_grid(
        message(fleetmap.OccupancyGrid(np.zeros((1, 8), np.int8), 0.05), data=cells[0])
    ).cells_yx.tolist() == [[-1, 0, 50, 100, 100, 100, 100, 100]]


def test_a_map_without_cells_is_none_yet():
    empty = message(two_rooms(), width=0, height=0, data=[], resolution=0.0)
    assert grid_of(empty) is None
    with pytest.raises(MapFormatError, match="has no cells"):
        as_grid(empty)


WRONG = [
    ({"width": 3}, "expected width x height = 3 x 80 = 240 cells; found 9600"),
    ({"width": 1 << 31, "height": 1 << 31}, "at most 268435456 cells"),
    ({"height": -1}, "width, height"),
    ({"height": "x"}, "width, height"),
    ({"resolution": 0.0}, "info.resolution: expected more than 0"),
    ({"resolution": np.nan}, "info.resolution: expected finite"),
    ({"origin": (0, 0, 0)}, "info.origin: expected a geometry_msgs/Pose or a Pose2; found tuple"),
    ({"data": np.zeros(9600)}, "expected a list or an array of int8: found float64"),
    ({"data": [300] * 9600}, "found 300 to 300"),
    ({"data": "x" * 9600}, "expected a list or an array of int8"),
    ({"data": np.ma.zeros(9600, np.int8)}, "masked"),
    ({"width": np.inf}, "width, height"),
    ({"width": 119.5}, "width, height"),
    ({"width": "120"}, "width, height"),
    ({"resolution": 10**400}, "info.resolution: expected finite"),
]


@pytest.mark.parametrize(("changes", "expected"), WRONG)
def test_a_field_that_is_wrong_is_named(changes, expected):
    with pytest.raises(MapFormatError, match=expected):
        as_grid(message(two_rooms(), **changes))


def test_a_field_that_is_missing_is_named():
    for name in ("resolution", "width", "height", "origin"):
        wrong = message(two_rooms())
        delattr(wrong.info, name)
        with pytest.raises(MapFormatError, match=f"info.{name}: missing"):
            as_grid(wrong)
    with pytest.raises(ConfigError, match="a message like nav_msgs"):
        as_grid(object())


async def test_peers_publish_all_of_them_and_all_are_one_map(map_folder):
    grid, hub = two_rooms(), MemoryHub(LoopClock())
    digests = set()
    for k, source in enumerate([grid, message(grid), map_folder / "map.yaml", grid.cells_yx]):
        own = {"resolution_m": 0.05, "origin": grid.origin} if isinstance(source, np.ndarray) else {}
        async with fleetmap.join(f"r{k}", fleet=f"f{k}", start=Pose2(), link=hub.link(f"r{k}")) as peer:
            assert await peer.publish(source, **own)
            digests.add((await peer.refresh()).digest)
    assert len(digests) == 1
