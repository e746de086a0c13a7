"""A node of real rclpy that does what comes in on its input, a line of JSON each. Runs under ROS's wheels.

python tests/ros_node.py NAMESPACE
"""

from __future__ import annotations

import array
import base64
import importlib
import json
import sys
import time
from functools import partial

import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message, serialize_message

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def kind_of(type_name):
    package, _, name = type_name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def grid_of(told):
    message = OccupancyGrid()
    message.header.frame_id = told["frame"]
    message.info.resolution = told["resolution_m"]
    message.info.height, message.info.width = told["shape"]
    message.info.origin.position.x, message.info.origin.position.y = told["origin"][:2]
    message.info.origin.orientation.w = 1.0
    message.data = array.array("b", base64.b64decode(told["cells"]))
    return message


def main():
    rclpy.init()
    node = Node("robot", namespace=sys.argv[1])
    publishers, latest = {}, {}

    def spin(until, wait_s):
        ends = time.monotonic() + wait_s
        while not until() and time.monotonic() < ends:
            rclpy.spin_once(node, timeout_sec=0.05)

    def topics():
        return dict(node.get_topic_names_and_types())

    for line in sys.stdin:
        order = json.loads(line)
        answer = {}
        match order["do"]:
            case "decode":
                # Read by the real implementation, and written by it again.
                message = deserialize_message(base64.b64decode(order["data"]), kind_of(order["type"]))
                answer = {"data": base64.b64encode(serialize_message(message)).decode(), "text": str(message)[:200]}
            case "publish":
                topic = order["topic"]
                if topic not in publishers:
                    publishers[topic] = node.create_publisher(OccupancyGrid, topic, LATCHED)
                publishers[topic].publish(grid_of(order))
            case "pose":
                if "pose" not in publishers:
                    publishers["pose"] = node.create_publisher(PoseWithCovarianceStamped, order["topic"], LATCHED)
                message = PoseWithCovarianceStamped()
                message.header.frame_id = order["frame"]
                message.pose.pose.position.x, message.pose.pose.position.y = order["at"]
                message.pose.pose.orientation.w = 1.0
                publishers["pose"].publish(message)
            case "listen":
                topic = order["topic"]
                qos = 10 if topic == "/diagnostics" else LATCHED
                node.create_subscription(kind_of(order["type"]), topic, lambda m, t=topic: latest.update({t: m}), qos)
            case "grid":
                # What came last, and whatever comes while one waits.
                spin(partial(bool, None), order["wait_s"])
                message = latest.get(order["topic"])
                if message is not None:
                    info = message.info
                    answer = {
                        "frame": message.header.frame_id,
                        "resolution_m": info.resolution,
                        "shape": [info.height, info.width],
                        "origin": [info.origin.position.x, info.origin.position.y],
                        "cells": base64.b64encode(array.array("b", message.data).tobytes()).decode(),
                    }
            case "heard":
                spin(partial(latest.__contains__, order["topic"]), order["wait_s"])
                answer = {"text": str(latest.get(order["topic"]))}
            case "topics":
                wanted = set(order["wanted"])
                spin(lambda w=wanted: w <= topics().keys(), order["wait_s"])
                answer = {"topics": topics()}
        sys.stdout.write(json.dumps(answer) + "\n")
        sys.stdout.flush()
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
