"""Bags in all forms that are read, written by rosbags, which nobody here wrote."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from conftest import two_rooms
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from fleetmap.bridges import cdr, grids, said
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.pose import Pose2

FORMS = ("mcap", "db3", "bag")
BEGIN_NS = 1_700_000_000_000_000_000
STEP_NS = 500_000_000

Said = tuple[str, str, int, Any]


def growing(steps: int = 8) -> list[OccupancyGrid]:
    """The two rooms, known from the left to the right."""
    whole = two_rooms().cells_yx
    known = np.linspace(20, whole.shape[1], steps).astype(int)
    return [OccupancyGrid(np.where(np.arange(120) < k, whole, -1), 0.05, two_rooms().origin) for k in known]


def conversation(maps: Sequence[OccupancyGrid], *, updates: bool = True, topic: str = "/map") -> Iterator[Said]:
    """(topic, type, when, message): every second map as an update, and the robot under way by /tf."""
    for k, grid in enumerate(maps):
        now_ns = BEGIN_NS + k * STEP_NS
        update = None
        if updates and k % 2:
            update = grids.update_message(maps[k - 1], grid, frame_id="map", stamp_ns=now_ns)
        if update is None:
            yield topic, cdr.MAP, now_ns, grids.map_message(grid, frame_id="map", stamp_ns=now_ns)
        else:
            yield f"{topic}_updates", cdr.MAP_UPDATE, now_ns, update
        there = said.transform(Pose2(0.1 * k, 1.0, 0.0), parent="map", child="base_link", stamp_ns=now_ns + 1)
        yield "/tf", cdr.TF, now_ns + 1, there


def write_bag(path: Path, form: str, said_all: Sequence[Said]) -> Path:
    """The bag; returns its name as a user gives it."""
    if form == "bag":
        write_rosbag1(path.with_suffix(".bag"), said_all)
        return path.with_suffix(".bag")
    plugin = StoragePlugin.MCAP if form == "mcap" else StoragePlugin.SQLITE3
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        connections: dict[str, Any] = {}
        for topic, type_name, now_ns, message in said_all:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, type_name, typestore=cdr.typestore())
            writer.write(connections[topic], now_ns, cdr.encode(message, type_name))
    return path


def write_rosbag1(path: Path, said_all: Sequence[Said]) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    from rosbags.typesys import get_types_from_msg

    stamped = "geometry_msgs/TransformStamped[] transforms"
    store.register(get_types_from_msg(cdr.MAP_UPDATE_TEXT, cdr.MAP_UPDATE))
    store.register(get_types_from_msg(stamped, cdr.TF))
    with Rosbag1Writer(path) as writer:
        connections: dict[str, Any] = {}
        for topic, type_name, now_ns, message in said_all:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, type_name, typestore=store)
            data = store.serialize_ros1(as_ros1(store, type_name, message), type_name)
            writer.write(connections[topic], now_ns, data)


def as_ros1(store: Any, type_name: str, message: Any) -> Any:
    """The same message with the sequence numbers that headers of ROS 1 have."""

    def convert(value: Any) -> Any:
        if isinstance(value, list):
            return [convert(each) for each in value]
        kind = getattr(value, "__msgtype__", None)
        if kind is None:
            return value
        fields = {name: convert(getattr(value, name)) for name in value.__dataclass_fields__ if name != "__msgtype__"}
        if kind == "std_msgs/msg/Header":
            fields["seq"] = 0
        return store.types[kind](**fields)

    return convert(message)
