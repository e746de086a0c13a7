"""zenoh-ros2-sdk, an implementation of rmw_zenoh's wire by others, with rosbags' types: it would fetch its own by git.

python tests/ros_sdk.py ROUTER_PORT listens to what comes in on its input, a line of JSON each, and answers so.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import numpy as np

from fleetmap.bridges import cdr, grids
from fleetmap.model.grid import OccupancyGrid


def sdk(port: int) -> Any:
    """The SDK's session at a router of this machine, knowing our types."""
    from zenoh_ros2_sdk.session import ZenohSession

    session = ZenohSession.get_instance("127.0.0.1", port)
    session.store = cdr.typestore()
    session.register_message_type = lambda definition, name: cdr.typestore().types[name]
    return session


def publisher(port: int, topic: str, type_name: str, **options: Any) -> Any:
    from zenoh_ros2_sdk import ROS2Publisher

    sdk(port)
    return ROS2Publisher(topic, type_name, type_hash=cdr.HASHES[type_name], router_port=port, domain_id=0, **options)


def subscriber(port: int, topic: str, type_name: str, callback: Any, **options: Any) -> Any:
    from zenoh_ros2_sdk import ROS2Subscriber

    sdk(port)
    return ROS2Subscriber(
        topic, type_name, callback, type_hash=cdr.HASHES[type_name], router_port=port, domain_id=0, **options
    )


def publish_grid(to: Any, grid: OccupancyGrid, *, frame_id: str = "map") -> None:
    message = grids.map_message(grid, frame_id=frame_id, stamp_ns=time.time_ns())
    to.publish(header=message.header, info=message.info, data=np.ascontiguousarray(message.data))


if __name__ == "__main__":
    sys.stdout.write(json.dumps({"ready": True}) + "\n")
