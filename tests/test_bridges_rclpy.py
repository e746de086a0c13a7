"""Against real ROS 2: rclpy and message packages as its developers build them, under the Pythons of FLEETMAP_ROS."""

import base64
import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from conftest import TIMEOUT_FACTOR, two_rooms
from ros_sdk import Sdk, ros_router, say_grid
from ros_wheels import one_of_the_wheels, ros_node, start_bridge, wheels

import fleetmap
from fleetmap.bridges import cdr, grids, said
from fleetmap.model.pose import Pose2
from fleetmap.peer import TeammateInfo
from fleetmap.peer.health import Problem
from fleetmap.peer.ports import free_port

DOMAIN = 40 + os.getpid() % 60
"""Nodes of another run on this machine shall not be heard."""
WAIT_S = 15.0 * TIMEOUT_FACTOR
BRIDGE_ENDS_S = 2.0

python = pytest.mark.parametrize("python", wheels())
one_python = pytest.mark.parametrize("python", one_of_the_wheels())


def merged_rooms():
    from fleetmap.merge import fold
    from fleetmap.merge.protocol import Source
    from fleetmap.model.pose import FixedPose
    from fleetmap.vectorize import vectorize

    return fold([Source(("r1", 1, "0"), FixedPose(), vectorize(two_rooms()))])


def sent():
    """A message of each type that goes out, of those in the wheels."""
    mates = [TeammateInfo("r2", Pose2(1.0, 2.0, 0.5), (3.0, 4.0), 0.1), TeammateInfo("r3", None, None, 0.2)]
    problem = Problem("map", "/map", "no map on /map yet")
    stamp = {"frame_id": "fleet", "stamp_ns": 1_700_000_000_123_456_789}
    return {
        cdr.MAP: grids.map_message(two_rooms(), **stamp),
        cdr.MARKERS: said.walls(merged_rooms(), **stamp),
        cdr.POSES: said.poses(mates, **stamp),
        cdr.DIAGNOSTICS: said.diagnostics("r1", "site", [problem], {"maps in": 3}, stamp_ns=7),
        cdr.TEXT: cdr.make(cdr.TEXT, data="ä word"),
        cdr.WHOLE_NUMBER: cdr.make(cdr.WHOLE_NUMBER, data=2**63),
        cdr.CLOCK: cdr.make(cdr.CLOCK, clock=cdr.time_of(5_000_000_007)),
    }


def fields(message):
    """A message as nested lists, to be compared."""
    if isinstance(message, np.ndarray):
        return message.tolist()
    if isinstance(message, list):
        return [fields(part) for part in message]
    if hasattr(message, "__dataclass_fields__"):
        return [fields(getattr(message, name)) for name in message.__dataclass_fields__ if not name.isupper()]
    return message


@python
def test_rclpy_reads_all_that_is_sent_and_what_it_writes_is_read(python):
    with ros_node(python, domain=DOMAIN) as node:
        for type_name, message in {**sent(), cdr.MARKERS: said.names([], frame_id="fleet", stamp_ns=1)}.items():
            check_there_and_back(node, type_name, message)
        check_there_and_back(node, cdr.MARKERS, sent()[cdr.MARKERS])


def check_there_and_back(node, type_name, message):
    told = node.do("decode", type=type_name, data=base64.b64encode(cdr.encode(message, type_name)).decode())
    again = cdr.decode(base64.b64decode(told["data"]), type_name, topic="x")
    # Single floats are no longer what was put in.
    expected = cdr.decode(cdr.encode(message, type_name), type_name, topic="x")
    assert json.dumps(fields(again)) == json.dumps(fields(expected)), type_name


@python
def test_hashes_are_those_of_the_wheels(python):
    share = python.parent.parent / "share"
    checked = set()
    for path in share.glob("*/msg/*.json"):
        document = json.loads(path.read_text())
        for entry in document["type_hashes"]:
            if entry["type_name"] in cdr.HASHES:
                assert entry["hash_string"] == cdr.HASHES[entry["type_name"]]
                checked.add(entry["type_name"])
    # Of these the wheels have none: they are held against what rosbags makes of them, and published hashes.
    assert set(cdr.HASHES) - checked == {cdr.TF, cdr.MAP_UPDATE}


@one_python
def test_two_robots_one_by_rclpy_and_one_by_the_wire_see_one_growing_map_and_end_at_once(python, tmp_path):
    """r1's bridge is the rclpy node, r2's the Zenoh one, a quarter turn between their maps."""
    port, fleet_port = free_port("127.0.0.1"), free_port("127.0.0.1")
    whole = two_rooms()
    fleet = {"fleet": "ros", "profile": "local"}
    first = {"robot": "r1", "start": "'0,0,0'", "listen": f"['tcp/127.0.0.1:{fleet_port}']", **fleet}
    wire = start_bridge_command(port, fleet_port, tmp_path)
    by_rclpy = start_bridge(python, first, namespace="/r1", domain=DOMAIN)
    try:
        with ros_router(f"tcp/127.0.0.1:{port}"), Sdk(port) as sdk, ros_node(python, "/r1", domain=DOMAIN) as robot:
            publisher, shown = sdk.publisher("/r2/map", cdr.MAP), sdk.heard("/r2/fleet_map", cdr.MAP)
            robot.do("listen", topic="fleet_map", type=cdr.MAP)
            names = ["/r1/map", "/r1/fleet_map", "/r1/fleet_walls", "/diagnostics"]
            listed = robot.do("topics", wanted=names, wait_s=WAIT_S)["topics"]
            assert listed["/r1/fleet_map"] == [cdr.MAP]
            for columns in (70, 90, 120):
                left, right = whole.cells_yx.copy(), whole.cells_yx.copy()
                left[:, columns - 30 :], right[:, : 150 - columns] = -1, -1
                robot.publish("map", fleetmap.OccupancyGrid(left, 0.05, whole.origin))
                turned = fleetmap.OccupancyGrid(np.ascontiguousarray(np.rot90(right, -1)), 0.05, Pose2())
                say_grid(publisher, turned)
                time.sleep(1.0)  # robots map at a pace
            there = until_like(lambda: robot.grid("fleet_map", wait_s=0.3), whole)
            assert there == "fleet"
            here = until_like(lambda: from_message(shown[-1][1]) if shown else None, whole)
            assert here == "fleet"
            robot.do("listen", topic="/diagnostics", type=cdr.DIAGNOSTICS)
            assert "fleetmap: r1 in ros" in robot.do("heard", topic="/diagnostics", wait_s=WAIT_S)["text"]
        for process in (by_rclpy, wire):
            began_s = time.monotonic()
            process.send_signal(signal.SIGINT)
            process.wait(WAIT_S)
            assert time.monotonic() - began_s < BRIDGE_ENDS_S * TIMEOUT_FACTOR
            assert process.returncode == 130
    finally:
        for process in (by_rclpy, wire):
            process.kill()
            process.communicate()


def start_bridge_command(port, fleet_port, folder):
    parameters = folder / "r2.yaml"
    parameters.write_text(
        "/r2/fleetmap:\n  ros__parameters:\n    robot: r2\n    fleet: ros\n    start: [-1.0, 6.0, -1.5707963]\n"
        f"    profile: local\n    connect: [tcp/127.0.0.1:{fleet_port}]\n    ros_endpoint: tcp/127.0.0.1:{port}\n"
    )
    command = [sys.executable, "-m", "fleetmap", "bridge", "ros2", "--params-file", parameters, "--namespace", "/r2"]
    return subprocess.Popen(command, text=True, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)


def from_message(message):
    from fleetmap.model.grid_like import as_grid

    return message.header.frame_id, as_grid(message)


def until_like(look, grid):
    """The frame of what is seen, once it is the whole map."""
    ends_s = time.monotonic() + WAIT_S
    found = None
    while time.monotonic() < ends_s:
        seen = look()
        if seen is not None:
            frame, there = seen
            found = fleetmap.compare(there, grid)
            if found.OPDF > 99 and found.MS > 97:
                return frame
        time.sleep(0.1)
    raise AssertionError(found)


@one_python
def test_a_parameter_that_is_wrong_ends_the_node_with_a_word(python):
    process = start_bridge(python, {"robot": "r1", "start": "'1,2'"}, namespace="/", domain=DOMAIN)
    _, err = process.communicate(timeout=WAIT_S)
    assert process.returncode == 1
    assert "start='1,2': expected X,Y,YAW" in err


@one_python
def test_the_node_takes_a_pose_topic_and_says_which_packages_are_missing(python):
    fleet_port = free_port("127.0.0.1")
    own = {"robot": "r1", "fleet": "pose", "profile": "local", "start": "[1.0, 0.0, 0.0]"}
    own |= {"pose_topic": "amcl_pose", "listen": f"['tcp/127.0.0.1:{fleet_port}']"}
    process = start_bridge(python, own, namespace="/r1", domain=DOMAIN)
    try:
        with ros_node(python, "/r1", domain=DOMAIN) as robot:
            robot.publish("map", two_rooms())
            robot.do("pose", topic="amcl_pose", frame="map", at=[2.0, 3.0])
            with fleetmap.sync.join(
                "r2", fleet="pose", profile="local", start=Pose2(), connect=[f"tcp/127.0.0.1:{fleet_port}"]
            ) as peer:
                ends_s = time.monotonic() + WAIT_S
                seen = []
                while not seen and time.monotonic() < ends_s:
                    robot.do("topics", wanted=["/never"], wait_s=0.2)
                    seen = [mate.pose for mate in peer.teammates(frame="fleet") if mate.pose is not None]
        assert (seen[0].x_m, seen[0].y_m) == pytest.approx((3.0, 3.0))
    finally:
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=WAIT_S)
    assert "tf2_msgs/msg/TFMessage is left out: the package tf2_msgs is not installed" in err
