"""Bags and recordings on the command line, and a fleet of three kinds of robots."""

import contextlib
import json
import signal
import subprocess
import sys
import time
import warnings

import pytest
from bags import conversation, growing, write_bag
from conftest import TIMEOUT_FACTOR, two_rooms
from ros_sdk import Sdk, say_grid

import fleetmap
from fleetmap.bridges import cdr
from fleetmap.cli import main
from fleetmap.peer.ports import free_port

WAIT_S = 60.0 * TIMEOUT_FACTOR


@pytest.fixture
def bag(tmp_path):
    return write_bag(tmp_path / "bag", "mcap", list(conversation(growing())))


def test_stats_of_a_bag(fleetmap_command, bag, tmp_path):
    run = fleetmap_command("stats", bag, "--json", "--out", "judged", cwd=tmp_path)
    assert run.code == 0, run.err
    ((document,), (topic,)) = run.document["bags"], run.document["bags"][0]["topics"]
    assert document["bag"] == str(bag)
    assert topic["codecs"].keys() == {"bag", "grid_gzip_full", "grid_gzip_updates", "vector"}
    assert topic["ratios"]["vector"] == 1.0
    assert topic["series"][-1][1] == topic["codecs"]
    page = (tmp_path / "judged" / "report.html").read_text()
    assert "/map, as vectors" in page
    assert "<svg" in page


def test_stats_of_a_bag_for_people(bag, capsys):
    assert main._run(["stats", str(bag)]) == 0
    out = capsys.readouterr().out
    assert "4 maps and 4 updates" in out
    assert "changed rectangles, gzip -6" in out


WRONG = [
    (["stats", "bag", "map.yaml"], 2, "bags go without maps"),
    (["stats", "bag", "--topic", "/x"], 2, "no topic of grids in bag; there is /map"),
    (["stats", "bag", "--free-below", "0.5", "--occupied-above", "0.6"], 2, "expected per cents"),
    (["stats", "map.yaml", "--topic", "/map"], 2, "go with bags"),
    (["stats", "missing.mcap"], 1, "missing: expected a bag"),
    (["play", "bag"], 2, "expected the robot's name"),
    (["play", "bag", "--robot", "r 1"], 2, "expected 1 to 64 of"),
    (["play", "bag", "--robot", "r1", "--start", "1,2"], 2, "expected X,Y,YAW"),
    (["play", "bag", "--robot", "r1", "--rate", "0"], 2, "expected more than 0"),
    (["play", "bag", "--robot", "r1", "--topic", "/tf"], 2, "no topic of grids"),
    (["play", "missing", "--robot", "r1"], 1, "missing: expected a bag"),
    (["record", "x.bag"], 2, "ends in .mcap"),
    (["record", "no/x.mcap"], 2, "no such folder"),
    (["sim", "--record", "x.bag"], 2, "ends in .mcap"),
    (["bridge", "ros2"], 2, "robot=''"),
    (["bridge", "ros2", "r1", "--via", "dds"], 2, "expected one of rmw_zenoh, ros2dds"),
    (["bridge", "ros2", "r1", "--ros-endpoint", "localhost"], 2, "ros_endpoint"),
    (["bridge", "ros2", "--params-file", "missing.yaml"], 2, "can't be read"),
]


@pytest.mark.parametrize(("arguments", "code", "expected"), WRONG)
def test_what_is_wrong_is_said_at_once(bag, map_folder, monkeypatch, capsys, arguments, code, expected):
    monkeypatch.chdir(map_folder)
    showwarning = warnings.showwarning
    try:
        assert main._run([*arguments, "--json"] if arguments[0] != "bridge" else arguments) == code
    finally:
        warnings.showwarning = showwarning
    said = capsys.readouterr()
    if arguments[0] == "bridge":
        assert expected in " ".join(said.err.split())
    else:
        assert expected in json.loads(said.out)["error"]["message"]


def test_a_bag_is_played_into_a_fleet(fleetmap_command, bag, tmp_path):
    endpoint = f"tcp/127.0.0.1:{free_port('127.0.0.1')}"
    with fleetmap.sync.join("r2", fleet="f", start=fleetmap.Pose2(), profile="local", listen=[endpoint]) as other:
        common = ["--fleet", "f", "--connect", endpoint, "--no-multicast-scouting"]
        played = fleetmap_command(
            "play", bag, "--robot", "r1", "--start=0,0,0", "--fast", *common, "--json", cwd=tmp_path
        )
        assert played.code == 0, played.err
        assert other.synced().digest == played.document["digest"]
        assert fleetmap.compare(other.merged.to_grid(0.05), two_rooms()).MS > 99.9
    assert played.document["maps"] == 8
    assert played.document["bytes_vector"] > 0
    alone = fleetmap_command("play", bag, "--robot", "r1", "--start=0,0,0", "--fast", "--fleet", "g", cwd=tmp_path)
    assert alone.code == 0, alone.err
    assert "nobody else is in the fleet" in " ".join(alone.err.split())


@contextlib.contextmanager
def started(*arguments, cwd):
    command = [sys.executable, "-m", "fleetmap", *map(str, arguments)]
    process = subprocess.Popen(command, cwd=cwd, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def until(done):
    ends_s = time.monotonic() + WAIT_S
    while not (found := done()):
        assert time.monotonic() < ends_s
        time.sleep(0.1)
    return found


def test_a_bag_a_bridge_and_a_simulated_robot_are_one_fleet_that_is_recorded_and_played_again(
    fleetmap_command, bag, tmp_path
):
    port, ros = free_port("127.0.0.1"), free_port("127.0.0.1")
    endpoint, common = f"tcp/127.0.0.1:{port}", ["--fleet", "three", "--no-multicast-scouting"]
    sim = ["sim", "--robots", "1", "--world", "office", "--size", "8", "--listen", endpoint, "--fleet", "three"]
    play = ["play", bag, "--robot", "bag", "--start=20,0,0.5", "--fast", "--hold-s", "300", *common]
    bridge = ["bridge", "ros2", "ros", "--start=40,0,1", "--ros-listen", f"tcp/127.0.0.1:{ros}", *common]
    with contextlib.ExitStack() as stack:
        stack.enter_context(started(*sim, "--hold-s", "300", "--out", "RUN", cwd=tmp_path))
        observer = stack.enter_context(joined(endpoint))
        recorder = stack.enter_context(
            started("record", "run.mcap", *common, "--connect", endpoint, "--json", cwd=tmp_path)
        )
        stack.enter_context(started(*play, "--connect", endpoint, cwd=tmp_path))
        stack.enter_context(started(*bridge, "--connect", endpoint, cwd=tmp_path))
        until(
            lambda: {"r0", "bag", "ros", "recorder"} <= {p.robot.partition("-")[0] for p in observer.peers if p.alive}
        )
        with Sdk(ros) as sdk:
            publisher = sdk.publisher("/map", cdr.MAP)

            def shared():
                say_grid(publisher, two_rooms())
                return any(p.robot == "ros" and p.edges for p in observer.peers)

            until(shared)
        until(lambda: (tmp_path / "RUN" / "stats.json").exists())  # it has explored all
        until(lambda: next(p.edges for p in observer.peers if p.robot == "bag") >= 16)
        before = None
        while (merged := observer.synced(WAIT_S, at_least=4)).digest != before:
            before = merged.digest
            time.sleep(2.0)  # the recorder folds once a second
        recorder.send_signal(signal.SIGINT)
        out, err = recorder.communicate(timeout=WAIT_S)
    assert recorder.returncode == 0, err
    document = json.loads(out)
    assert set(document["robots"]) == {"r0", "bag", "ros"}
    assert document["digest"] == merged.digest
    again = fleetmap_command("play", "run.mcap", "--fast", "--fleet", "again", "--json", cwd=tmp_path)
    assert again.code == 0, again.err
    assert again.document == {"robots": "bag, r0, ros", "digest": merged.digest}


@contextlib.contextmanager
def joined(endpoint):
    """A peer that sees the whole fleet, once there is one."""
    with fleetmap.sync.join(
        "observer", fleet="three", start=fleetmap.Pose2(), profile="local", connect=[endpoint]
    ) as peer:
        yield peer


def test_record_says_that_nobody_was_there(fleetmap_command, tmp_path):
    nobody = f"tcp/127.0.0.1:{free_port('127.0.0.1')}"
    run = fleetmap_command(
        "record", "run.mcap", "--connect", nobody, "--no-multicast-scouting", "--for-s", "1", cwd=tmp_path
    )
    assert run.code == 1
    assert "nobody has a map there, so that no file was left" in " ".join(run.err.split())
    assert not (tmp_path / "run.mcap").exists()


def test_a_bridge_in_the_background_of_a_script_ends_by_sigterm(tmp_path):
    """Such a shell has its jobs ignore Ctrl-C."""
    nobody = f"tcp/127.0.0.1:{free_port('127.0.0.1')}"
    command = [sys.executable, "-m", "fleetmap", "bridge", "ros2", "r1", "--no-multicast-scouting"]
    process = subprocess.Popen(
        [*command, "--ros-endpoint", nobody],
        cwd=tmp_path,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_IGN),
    )
    try:
        for line in process.stderr:
            if "joins fleet" in line:
                break
        process.send_signal(signal.SIGINT)
        time.sleep(0.5)
        assert process.poll() is None
        began_s = time.monotonic()
        process.terminate()
        assert process.wait(WAIT_S) == 130
        assert time.monotonic() - began_s < 2.0 * TIMEOUT_FACTOR
    finally:
        process.kill()
        process.communicate()
