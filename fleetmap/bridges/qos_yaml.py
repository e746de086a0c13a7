"""Quality of service as bags have it: what ``ros2 bag play`` offers a topic with."""

from __future__ import annotations

import yaml

from fleetmap.bridges.qos import Qos

FOREVER = {"sec": 9223372036, "nsec": 854775807}


def offered_profiles(qos: Qos) -> str:
    """The metadata ``offered_qos_profiles`` of a channel, in the numbers of rosbag2 that all its versions read."""
    profile = {
        "history": 1,
        "depth": qos.depth,
        "reliability": 1 if qos.reliable else 2,
        "durability": 1 if qos.latched else 2,
        "deadline": FOREVER,
        "lifespan": FOREVER,
        "liveliness": 1,
        "liveliness_lease_duration": FOREVER,
        "avoid_ros_namespace_conventions": False,
    }
    return yaml.safe_dump([profile], sort_keys=False)
