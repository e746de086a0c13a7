"""What the pages on ROS 2 and on bags say is run."""

import re
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml
from bags import conversation, growing, write_bag
from conftest import TIMEOUT_FACTOR
from ros_wheels import environment, wheels

from fleetmap.bridges.bags import Bag
from fleetmap.bridges.options import BridgeOptions, WireOptions, checked, options_of
from fleetmap.bridges.parameters import read_parameters
from fleetmap.peer.ports import free_port

ROOT = Path(__file__).parent.parent
ROS2, BAGS = ((ROOT / "docs" / name).read_text() for name in ("ros2.md", "bags.md"))
WAIT_S = 40.0 * TIMEOUT_FACTOR


def commands(page, mark):
    """The lines of the block of commands behind a mark."""
    block = page.split(f"<!-- {mark} -->")[1].split(f"<!-- /{mark} -->")[0]
    return re.search(r"```sh\n(.*?)```", block, re.DOTALL)[1].splitlines()


def test_a_bag_is_judged_and_played_as_the_page_says(tmp_path):
    path = write_bag(tmp_path / "bag", "mcap", list(conversation(growing())))
    (path / "bag.mcap").rename(tmp_path / "run.mcap")
    for mark in ("judge", "play"):
        for line in commands(BAGS, mark):
            program, *arguments = shlex.split(line)
            assert program == ".venv/bin/fleetmap"
            command = [sys.executable, "-m", "fleetmap", *arguments]
            done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=WAIT_S, check=False)
            assert done.returncode == 0, done.stderr
    assert (tmp_path / "judged" / "report.html").exists()


def test_the_topics_of_a_recording_are_those_of_the_page(tmp_path, fleetmap_command):
    run = fleetmap_command(
        *("sim", "--robots", "1", "--world", "maze", "--size", "6", "--listen", "tcp/127.0.0.1:0"),
        *("--record", "run.mcap", "--out", "RUN", "--json"),
        cwd=tmp_path,
    )
    assert run.code == 0, run.err
    again = fleetmap_command("play", "run.mcap", "--fast", "--json", "--fleet", "again", cwd=tmp_path)
    assert again.document["digest"] == run.document["digest"]
    told = re.findall(r"^\| `(/\S+)` \| (\w+)/(\w+) \|", BAGS, re.MULTILINE)
    page = {(name.replace("_r1", "_r0"), f"{package}/msg/{kind}") for name, package, kind in told}
    with Bag(tmp_path / "run.mcap") as bag:
        assert {(topic.name, topic.type_name) for topic in bag.topics} == page


def test_the_parameters_of_the_page_are_those_of_the_bridge(tmp_path):
    own, nav2 = re.findall(r"```yaml\n(.*?)```", ROS2, re.DOTALL)
    path = tmp_path / "r1.yaml"
    path.write_text(own)
    found = read_parameters(path, node="fleetmap", namespace="/r1")
    options = BridgeOptions(**checked(BridgeOptions, found))
    wire = WireOptions(**checked(WireOptions, found))
    assert (options.robot, options.fleet, wire.namespace) == ("r1", "site-4", "/r1")
    assert yaml.safe_load(nav2)["bt_navigator"]["ros__parameters"]["global_frame"] == options.fleet_frame


def test_each_option_that_the_page_names_exists():
    known = {f.name for kind in (BridgeOptions, WireOptions) for f in options_of(kind)}
    given = {name.replace("-", "_") for name in re.findall(r"`--([a-z0-9-]+)", ROS2)}
    assert given - {"params_file", "help", "ros_args", "system_site_packages"} <= known
    assert {"map_rate_hz", "fleet_map_rate_hz", "fleet_map_updates", "pose_topic", "use_sim_time"} <= known


@pytest.mark.parametrize("python", wheels()[-1:])
def test_two_robots_share_their_maps_on_one_computer_as_the_page_says(python, map_folder):
    """The commands as they stand; the ports and the map are this test's."""
    fleet_port = free_port("127.0.0.1")
    (map_folder / "RUN").mkdir()
    for name in ("map.yaml", "map.pgm"):
        (map_folder / name).rename(map_folder / "RUN" / name)
    processes = []
    try:
        for line in commands(ROS2, "try"):
            program, *arguments = shlex.split(line.replace("7448", str(fleet_port)))
            assert program == ".venv/bin/python"
            arguments = [str(ROOT / a) if a.startswith("examples/") else a for a in arguments]
            processes.append(
                subprocess.Popen(
                    [python, *arguments],
                    cwd=map_folder,
                    env=environment(120),
                    stdout=subprocess.PIPE,
                    stderr=subprocess.DEVNULL,
                    text=True,
                )
            )
        *_, first, second = processes
        known = [until_all_is_known(robot) for robot in (first, second)]
        assert known[0] == known[1]
    finally:
        for process in processes:
            process.send_signal(signal.SIGINT)
        for process in processes:
            try:
                process.communicate(timeout=10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.communicate()


def until_all_is_known(robot):
    """The line of a robot that knows the whole map: two_rooms has 6656 cells, of which four corners are never seen."""
    ends_s = time.monotonic() + WAIT_S
    for line in robot.stdout:
        assert time.monotonic() < ends_s
        if int(re.search(r"(\d+) cells known", line)[1]) > 6600:
            return re.sub("/r[12]", "", line)
    raise AssertionError("it ended")
