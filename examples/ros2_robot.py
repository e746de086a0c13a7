"""A ROS 2 robot without wheels: it says half of a map file on `map`, as slam_toolbox would, and hears `fleet_map`.

Needs rclpy and nav_msgs. Beside a bridge in the same namespace (docs/ros2.md):

    python examples/ros2_robot.py /r1 RUN/map.yaml --half left
"""

import argparse
import contextlib

import rclpy
from nav_msgs.msg import OccupancyGrid
from rclpy.qos import DurabilityPolicy, QoSProfile

import fleetmap


def main(namespace: str, map_yaml: str, half: str) -> None:
    """Say the half that this robot knows, then listen until Ctrl-C."""
    grid = fleetmap.load_map(map_yaml)
    cells, middle = grid.cells_yx.copy(), grid.width // 2
    cells[:, slice(middle, None) if half == "left" else slice(None, middle)] = -1
    message = OccupancyGrid(data=cells.reshape(-1).tolist())
    message.header.frame_id, message.info.resolution = f"{namespace[1:]}/map", grid.resolution_m
    message.info.height, message.info.width = cells.shape
    message.info.origin.position.x, message.info.origin.position.y = grid.origin.x_m, grid.origin.y_m
    rclpy.init()
    node = rclpy.create_node("robot", namespace=namespace)
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)

    def heard(shared: OccupancyGrid) -> None:
        print(f"{namespace}/fleet_map: {sum(cell >= 0 for cell in shared.data)} cells known", flush=True)

    node.create_subscription(OccupancyGrid, "fleet_map", heard, latched)
    node.create_publisher(OccupancyGrid, "map", latched).publish(message)
    with contextlib.suppress(KeyboardInterrupt):
        rclpy.spin(node)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("namespace", help="as /r1")
    parser.add_argument("map_yaml", help="a map of map_server")
    parser.add_argument("--half", choices=["left", "right"], default="left")
    main(**vars(parser.parse_args()))
