"""Two ROS 2 robots, one of which is out of reach for a while and maps on: how soon is the hole filled.

Each robot is on a host of its own (a network namespace), which is linked to the other's by the fleet alone. r1 speaks
to the rclpy node of the bridge by real rclpy, if FLEETMAP_ROS names a Python that has it, else as r2 does; r2 to
`fleetmap bridge ros2` by zenoh-ros2-sdk. A quarter turn lies between their map frames, which are known. Each second
each robot uncovers some more of an office, and says its whole map. The second host's link is cut, and up again while
both go on.

Printed: how long after that each robot's `fleet_map` holds all that both have mapped meanwhile, how like the truth the
two maps are in the end, and how long each bridge takes to end after Ctrl-C.

    python benchmarks/ros2_cut.py [--cut-s 60] [--size 30] [--json]

Needs Linux and the right to make a namespace; says so where it has none.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from namespaces import INSIDE, Air, in_a_namespace
from ros_wheels import ROOT, RosNode, bridge_command, command_of, environment

import fleetmap
from fleetmap.bridges import cdr
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.kernel_cache import AGENT, modules_of
from fleetmap.model.kernel_compiler import compile_ahead
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN
from fleetmap.model.pose import Pose2
from fleetmap.sims.worlds import make_world

PORT, ROS_PORT, DOMAIN = 7448, 7447, 7
BEFORE_S = 10
"""So long both map within reach, before the cut."""
LIMIT_S = 60.0
ALIKE_MS = 98.5
"""Per cent of equal cells from which on a map counts as complete; what is still missing then is less than a step."""


class Robot:
    """One side: how much it knows after so many steps, in the fleet's frame and in its own."""

    def __init__(self, name: str, node: RosNode, truth: OccupancyGrid, *, turned: bool, steps: int) -> None:
        self.name, self.node, self._truth, self._turned, self._steps = name, node, truth, turned, steps
        node.do("listen", topic="fleet_map", type=cdr.MAP)

    def known(self, step: int) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """(width,) columns that it has seen: r1 from the left, r2 from the right, up to a bit over the middle."""
        width = self._truth.width
        seen = int(width * 0.6 * (step + 1) / self._steps)
        columns = np.arange(width)
        return columns >= width - seen if self._turned else columns < seen

    def say(self, step: int) -> None:
        """Say the whole map as it is known now."""
        cells = np.where(self.known(step), self._truth.cells_yx, -1)
        if self._turned:
            grid = OccupancyGrid(np.ascontiguousarray(np.rot90(cells, -1)), self._truth.resolution_m, Pose2())
        else:
            grid = OccupancyGrid(cells, self._truth.resolution_m, self._truth.origin)
        self.node.publish("map", grid)

    def sees(self) -> OccupancyGrid | None:
        """The fleet's map as it is on its side."""
        told = self.node.grid("fleet_map", wait_s=0.05)
        return None if told is None else told[1]


def truth(size_m: float) -> OccupancyGrid:
    """An office, without the inside of its walls."""
    world = make_world("office", size_m=size_m, seed=1)
    states = np.where(world.solid, OCCUPIED, FREE).astype(np.uint8)
    inner = np.pad(states == FREE, 2)
    height, width = states.shape
    near = sum(np.roll(inner, shift, (0, 1)) for shift in np.ndindex(5, 5))[:height, :width] > 0
    states[~near & (states == OCCUPIED)] = UNKNOWN
    return OccupancyGrid.from_states(states, 0.05, world.origin)


def run(size_m: float, before_s: int, cut_s: float) -> dict[str, Any]:
    """The whole story, in a namespace of one's own."""
    whole, python = truth(size_m), next(iter(os.environ.get("FLEETMAP_ROS", "").split(os.pathsep)), "")
    steps = before_s + round(cut_s)
    height_m = whole.height * whole.resolution_m
    turn = f"{whole.origin.x_m},{whole.origin.y_m + height_m},{-np.pi / 2}"
    os.environ.update(environment(DOMAIN))
    with Air() as air, ExitStack() as stack:
        for host in (1, 2):
            air.host(host)
        bridges = {
            "r1": air.start(1, bridge(python, "r1", "0,0,0", listen=f"tcp/10.77.0.1:{PORT}")),
            "r2": air.start(2, bridge("", "r2", turn, connect=f"tcp/10.77.0.1:{PORT}")),
        }
        for process in bridges.values():
            stack.callback(process.kill)
        sdk = [sys.executable, str(ROOT / "tests" / "ros_sdk_node.py"), str(ROS_PORT)]
        nodes = {
            "r1": RosNode(air.start(1, command_of(Path(python), "/r1") if python else [*sdk, "/r1"])),
            "r2": RosNode(air.start(2, [*sdk, "/r2"])),
        }
        for node in nodes.values():
            stack.callback(node.close)
        robots = [Robot(name, node, whole, turned=name == "r2", steps=steps) for name, node in nodes.items()]
        time.sleep(5.0)
        for step in range(steps):
            began_s = time.monotonic()
            if step == before_s:
                before = [alike(robot, robots, step - 1, whole) for robot in robots]
                air.cut(2)
            for robot in robots:
                robot.say(step)
            time.sleep(max(0.0, began_s + 1.0 - time.monotonic()))
        during = [alike(robot, robots, steps - 1, whole) for robot in robots]
        air.cut(2, up=True)
        healed_s = time.monotonic()
        filled_s: dict[str, float] = {}
        while len(filled_s) < len(robots) and time.monotonic() - healed_s < LIMIT_S:
            for robot in robots:
                if robot.name not in filled_s and alike(robot, robots, steps - 1, whole) >= ALIKE_MS:
                    filled_s[robot.name] = round(time.monotonic() - healed_s, 2)
        seen = [robot.sees() for robot in robots]
        while not same(seen) and time.monotonic() - healed_s < LIMIT_S:
            seen = [robot.sees() for robot in robots]
        ended_s = {}
        for name, process in bridges.items():
            began_s = time.monotonic()
            process.send_signal(signal.SIGINT)
            process.wait(10)
            ended_s[name] = round(time.monotonic() - began_s, 2)
    return {
        "r1_by": "rclpy" if python else "zenoh-ros2-sdk",
        "cut_s": cut_s,
        "equal_cells_before_the_cut": before,
        "equal_cells_at_the_end_of_the_cut": during,
        "filled_after_s": filled_s,
        "equal_cells_in_the_end": [
            0.0 if grid is None else round(fleetmap.compare(grid, whole).MS, 2) for grid in seen
        ],
        "one_map": same(seen),
        "ended_after_s": ended_s,
    }


def same(seen: list[OccupancyGrid | None]) -> bool:
    """Whether both see the same cells."""
    first, second = seen
    return first is not None and second is not None and bool(np.array_equal(first.cells_yx, second.cells_yx))


def alike(robot: Robot, robots: list[Robot], step: int, whole: OccupancyGrid) -> float:
    """Per cent of equal cells of what one robot sees and what all together have mapped."""
    seen = robot.sees()
    if seen is None:
        return 0.0
    known = np.any([each.known(step) for each in robots], axis=0)
    together = OccupancyGrid(np.where(known, whole.cells_yx, -1), whole.resolution_m, whole.origin)
    return round(float(fleetmap.compare(seen, together).MS), 2)


def bridge(python: str, robot: str, start: str, *, connect: str = "", listen: str = "") -> list[str]:
    """The command of a bridge: the rclpy node, or that of the command line."""
    common = {"robot": robot, "fleet": "cut", "profile": "local"}
    if python:
        lists = {name: f"['{value}']" for name, value in (("connect", connect), ("listen", listen)) if value}
        return bridge_command(Path(python), {**common, "start": f"'{start}'", **lists}, namespace=f"/{robot}")
    command = [
        sys.executable,
        "-m",
        "fleetmap",
        "bridge",
        "ros2",
        robot,
        "--namespace",
        f"/{robot}",
        f"--start={start}",
    ]
    command += ["--fleet", "cut", "--profile", "local", "--ros-endpoint", f"tcp/127.0.0.1:{ROS_PORT}", "--domain", "0"]
    for name, value in (("--connect", connect), ("--listen", listen or f"tcp/10.77.0.{robot[1:]}:{PORT}")):
        command += [name, value] if value else []
    return command


def main() -> int:
    """Make a namespace, measure in it, and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cut-s", type=float, default=60.0)
    parser.add_argument("--size", type=float, default=30.0, help="metres")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--tiny", action="store_true", help="see that it runs")
    parser.add_argument(INSIDE, action="store_true", dest="inside", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.tiny:
        options.cut_s, options.size = 2.0, 10.0
    if not options.inside:
        compile_ahead(modules_of(*AGENT))
        return in_a_namespace(__file__)
    document = run(options.size, 2 if options.tiny else BEFORE_S, options.cut_s)
    if options.json:
        print(json.dumps(document, indent=2))
    else:
        for name, value in document.items():
            print(f"{name:36} {value}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
