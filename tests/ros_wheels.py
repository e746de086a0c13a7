"""The Pythons that have ROS's own wheels, which FLEETMAP_ROS names, and nodes that run under them."""

from __future__ import annotations

import base64
import contextlib
import json
import os
import subprocess
import sysconfig
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.pose import Pose2

ROOT = Path(__file__).parent.parent


def wheels() -> list[Any]:
    """The Pythons, or a skip."""
    named = [path for path in os.environ.get("FLEETMAP_ROS", "").split(os.pathsep) if path]
    if not named:
        return [pytest.param(None, marks=pytest.mark.skip(reason="FLEETMAP_ROS is not set: no rclpy"))]
    return [pytest.param(Path(path), id=Path(path).parent.parent.name) for path in named]


def one_of_the_wheels() -> list[Any]:
    """The first of them: what nodes do to each other is the same in all."""
    return wheels()[:1]


def environment(domain: int) -> dict[str, str]:
    """This checkout and what it needs beside ROS's packages; nodes of this machine and of this test alone."""
    found = os.pathsep.join([str(ROOT), sysconfig.get_paths()["purelib"], sysconfig.get_paths()["platlib"]])
    own = {"PYTHONPATH": found, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": str(domain)}
    return {**os.environ, **own}


def command_of(python: Path, namespace: str) -> list[str]:
    """A robot of real rclpy."""
    return [str(python), str(ROOT / "tests" / "ros_node.py"), namespace]


class RosNode:
    """A robot in a process of its own, with pipes."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process

    def do(self, what: str, **order: Any) -> dict[str, Any]:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps({"do": what, **order}) + "\n")
        self._process.stdin.flush()
        return json.loads(self._process.stdout.readline())

    def publish(self, topic: str, grid: OccupancyGrid, *, frame: str = "map") -> None:
        self.do(
            "publish",
            topic=topic,
            frame=frame,
            resolution_m=grid.resolution_m,
            shape=grid.cells_yx.shape,
            origin=[grid.origin.x_m, grid.origin.y_m],
            cells=base64.b64encode(grid.cells_yx.tobytes()).decode(),
        )

    def grid(self, topic: str, *, wait_s: float) -> tuple[str, OccupancyGrid] | None:
        """What came last on a topic that is listened to, after so long."""
        told = self.do("grid", topic=topic, wait_s=wait_s)
        if not told:
            return None
        cells = np.frombuffer(base64.b64decode(told["cells"]), np.int8).reshape(told["shape"])
        resolution_m = round(told["resolution_m"], 6)
        return told["frame"], OccupancyGrid(cells, resolution_m, Pose2(*told["origin"], 0.0))

    def close(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
        assert self._process.stdout is not None
        self._process.stdout.close()


@contextlib.contextmanager
def ros_node(python: Path, namespace: str = "/", *, domain: int) -> Iterator[RosNode]:
    pipe, command = subprocess.PIPE, command_of(python, namespace)
    node = RosNode(subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, env=environment(domain)))
    try:
        yield node
    finally:
        node.close()


def bridge_command(python: Path, parameters: dict[str, Any], *, namespace: str) -> list[str]:
    """The rclpy node of the bridge, as a user starts it."""
    command = [str(python), "-m", "fleetmap.bridges.rclpy_node", "--ros-args", "-r", f"__ns:={namespace}"]
    for name, value in parameters.items():
        command += ["-p", f"{name}:={value}"]
    return command


def start_bridge(python: Path, parameters: dict[str, Any], *, namespace: str, domain: int) -> subprocess.Popen[str]:
    """The same, started."""
    return subprocess.Popen(
        bridge_command(python, parameters, namespace=namespace),
        env=environment(domain),
        text=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        cwd=ROOT,
    )
