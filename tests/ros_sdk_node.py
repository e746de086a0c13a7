"""A robot that speaks by zenoh-ros2-sdk and does what comes in on its input; its orders are those of ``ros_node``.

python tests/ros_sdk_node.py PORT NAMESPACE
"""

from __future__ import annotations

import base64
import json
import sys
import time
from typing import Any

import numpy as np
from ros_sdk import Sdk, ros_router, say_grid

from fleetmap.bridges import cdr
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.pose import Pose2


def main() -> None:
    port, namespace = int(sys.argv[1]), sys.argv[2]
    publishers: dict[str, Any] = {}
    heard: dict[str, list[tuple[float, Any]]] = {}
    with ros_router(f"tcp/127.0.0.1:{port}"), Sdk(port) as sdk:
        for line in sys.stdin:
            order, answer = json.loads(line), {}
            topic = f"{namespace}/{order['topic']}"
            if order["do"] == "publish":
                if topic not in publishers:
                    publishers[topic] = sdk.publisher(topic, cdr.MAP)
                cells = np.frombuffer(base64.b64decode(order["cells"]), np.int8).reshape(order["shape"])
                say_grid(
                    publishers[topic],
                    OccupancyGrid(cells, order["resolution_m"], Pose2(*order["origin"], 0.0)),
                    frame_id=order["frame"],
                )
            elif order["do"] == "listen":
                heard[topic] = sdk.heard(topic, order["type"])
            elif order["do"] == "grid":
                time.sleep(order["wait_s"])
                if heard[topic]:
                    message = heard[topic][-1][1]
                    info = message.info
                    answer = {
                        "frame": message.header.frame_id,
                        "resolution_m": info.resolution,
                        "shape": [info.height, info.width],
                        "origin": [info.origin.position.x, info.origin.position.y],
                        "cells": base64.b64encode(message.data.tobytes()).decode(),
                    }
            sys.stdout.write(json.dumps(answer) + "\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
