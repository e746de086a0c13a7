"""zenoh-ros2-sdk, an implementation of rmw_zenoh's wire by others, with rosbags' types: its own it fetches by git."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import zenoh

from fleetmap.bridges import cdr, grids
from fleetmap.model.grid import OccupancyGrid
from fleetmap.peer.keys import zenoh_config

LATCHED = ":1:,1:,:,:,,"
"""Of rmw_zenoh: what makes the SDK ask for what was said before."""


@contextmanager
def ros_router(endpoint: str, *, brokering: bool = False) -> Iterator[zenoh.Session]:
    """What stands in for rmw_zenohd: a router of its settings."""
    settings = {
        "mode": "router",
        "listen/endpoints": [endpoint],
        "scouting/multicast/enabled": False,
        "routing/router/peers_failover_brokering": brokering,
    }
    session = zenoh.open(zenoh_config(settings))
    try:
        yield session
    finally:
        session.close()


class Sdk:
    """Its session at a router of this machine, of which a process has one; use it as ``with``."""

    def __init__(self, port: int) -> None:
        self._port = port
        self._open: list[Any] = []

    def __enter__(self) -> Sdk:
        from zenoh_ros2_sdk.session import ZenohSession

        self._session = ZenohSession.get_instance("127.0.0.1", self._port)
        self._session.store = cdr.typestore()
        self._session.register_message_type = lambda definition, name: cdr.typestore().types[name]
        return self

    def __exit__(self, *_: object) -> None:
        for each in self._open:
            each.close()
        self._session.close()

    def publisher(self, topic: str, type_name: str, *, type_hash: str | None = None) -> Any:
        from zenoh_ros2_sdk import ROS2Publisher

        made = ROS2Publisher(
            topic, type_name, type_hash=type_hash or cdr.HASHES[type_name], router_port=self._port, domain_id=0
        )
        self._open.append(made)
        return made

    def heard(self, topic: str, type_name: str, *, qos: str | None = None) -> list[tuple[float, Any]]:
        """What comes on a topic from now on, with when."""
        from zenoh_ros2_sdk import ROS2Subscriber

        came: list[tuple[float, Any]] = []
        self._open.append(
            ROS2Subscriber(
                topic,
                type_name,
                lambda message: came.append((time.monotonic(), message)),
                type_hash=cdr.HASHES[type_name],
                router_port=self._port,
                domain_id=0,
                qos=qos,
            )
        )
        return came


def say_grid(publisher: Any, grid: OccupancyGrid, *, frame_id: str = "map") -> None:
    message = grids.map_message(grid, frame_id=frame_id, stamp_ns=time.time_ns())
    publisher.publish(header=message.header, info=message.info, data=np.ascontiguousarray(message.data))
