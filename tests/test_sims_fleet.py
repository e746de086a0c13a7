"""Simulated fleets end to end: real processes, real links, real ends."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from fleetmap.cli.sim import USUAL, _telling
from fleetmap.codecs.fmap import load_fmap
from fleetmap.model.errors import ConfigError, LinkError
from fleetmap.model.map_server import load_map
from fleetmap.peer.rendezvous import PORT, rendezvous
from fleetmap.sims import Progress, SimConfig, run_fleet
from fleetmap.sims.fleet import name_fleet

PATIENCE = float(os.environ.get("FLEETMAP_TEST_PATIENCE", "1"))
"""Scales every timeout, for slow machines."""

REQUIRED = {
    "robots", "components", "covered", "converged", "digest", "collisions", "merged_error_m", "duration_s",
    "bytes_vector", "bytes_deltas", "bytes_grid_gzip_full", "bytes_grid_gzip_updates", "ratio_full", "ratio_updates",
    "wire_bytes_vector", "wire_bytes_grid_gzip_full", "wire_bytes_grid_gzip_updates", "wire_bytes_grid_exact_updates",
    "wire_ratio_full", "wire_ratio_updates", "wire_ratio_exact", "wire", "explored_m2",
    "bytes_per_m2", "wire_bytes_per_m2", "bytes_per_s_robot", "wire_bytes_per_s_robot", "fleet", "endpoint",
}  # fmt: skip


def gone(pid: int, *, timeout_s: float = 15.0) -> bool:
    """Whether a process has ended, or does within the timeout."""
    until_s = time.monotonic() + timeout_s * PATIENCE
    while time.monotonic() < until_s:
        try:
            state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
        except (FileNotFoundError, ProcessLookupError):
            return True
        if state == "Z":
            return True
        time.sleep(0.05)
    return False


def check_bytes(document) -> None:
    """Payload and wire stand for the same messages, and both sides carry what a fleet says besides its map."""
    robots, wire = document["per_robot"], document["wire"]
    assert sum(wire.values()) == document["wire_bytes_vector"] > document["bytes_vector"]
    assert sum(robot["wire_bytes_vector"] for robot in robots) == document["wire_bytes_vector"]
    time_s = sum(robot["t_s"] for robot in robots)
    # Keep-alives are those of simulated time, in which a heartbeat each 2 s leaves none to be sent.
    assert wire["keep_alives"] == 0
    # Heartbeats too: what is said on the wire differs from the payload counted by these alone.
    beats = sum(robot["sent"]["digest"] for robot in robots)
    heartbeat_bytes = beats / sum(robot["sent_messages"]["digest"] for robot in robots)
    expected = document["bytes_vector"] - beats + heartbeat_bytes * time_s / 2.0
    assert wire["payload"] == pytest.approx(expected, abs=heartbeat_bytes * len(robots))
    for name, short in (("gzip_full", "full"), ("gzip_updates", "updates"), ("exact_updates", "exact")):
        grids = document[f"wire_bytes_grid_{name}"]
        assert grids > document[f"bytes_grid_{name}"]
        assert document[f"wire_ratio_{short}"] == pytest.approx(grids / document["wire_bytes_vector"], abs=0.01)
        assert document[f"wire_ratio_{short}"] < document[f"ratio_{short}"]
    assert document["bytes_per_m2"] == pytest.approx(document["bytes_vector"] / document["explored_m2"], abs=0.01)
    assert document["wire_bytes_per_s_robot"] == pytest.approx(document["wire_bytes_vector"] / time_s, abs=0.01)


async def test_a_second_run_neither_joins_nor_splits_the_first_one(tmp_path) -> None:
    unnamed = SimConfig(out=tmp_path)
    async with rendezvous() as first, rendezvous() as second:
        assert second.endpoint != first.endpoint
        assert not second.usual
        names = [name_fleet(unnamed, meeting) for meeting in (first, second)]
        assert names[0] != names[1]
        # Who was told where to meet, or what to be called, does not quietly go elsewhere.
        with pytest.raises(LinkError, match=r"--listen tcp/127\.0\.0\.1:0"):
            async with rendezvous(first.endpoint):
                pass
        async with rendezvous("tcp/127.0.0.1:0") as third:
            assert third.endpoint not in (first.endpoint, second.endpoint)
    assert name_fleet(SimConfig(out=tmp_path, fleet="mine"), second) == "mine"


def test_a_run_that_found_the_usual_place_taken_says_where_it_is(tmp_path, capsys) -> None:
    moved = Progress("exploring", 0.0, "tcp/127.0.0.1:43211", (), "sim-ab12")
    shown: list[Progress] = []
    for config, progress in (
        (SimConfig(out=tmp_path), moved),
        (SimConfig(out=tmp_path), replace(moved, endpoint=USUAL, fleet="sim")),
        (SimConfig(out=tmp_path, listen="tcp/127.0.0.1:0"), moved),
    ):
        tell = _telling(config, shown.append)
        tell(progress)
        tell(progress)
    assert len(shown) == 6
    assert capsys.readouterr().err.count("this fleet is sim-ab12 at tcp/127.0.0.1:43211") == 1
    assert f"tcp/127.0.0.1:{PORT}" == USUAL


@pytest.mark.parametrize(
    "listen", ["udp/127.0.0.1:7447", "tcp/127.0.0.1", "tcp/:7447", "tcp/127.0.0.1:x", "tcp/h:70000"]
)
def test_an_endpoint_that_is_none_is_refused(tmp_path, listen) -> None:
    with pytest.raises(ConfigError, match="tcp/HOST:PORT"):
        SimConfig(out=tmp_path, listen=listen)


def test_two_robots_explore_an_office_and_hold_the_same_map(tmp_path) -> None:
    told: list[Progress] = []
    result = run_fleet(SimConfig(out=tmp_path / "run", robots=2, world="office", size_m=8, seed=1), told.append)
    document = result.document
    assert set(document) >= REQUIRED
    assert document["converged"] is True
    assert document["components"] == 1
    assert document["collisions"] == 0
    assert document["covered"] >= 0.98
    assert document["merged_error_m"]["median"] <= 0.05
    assert document["merged_error_m"]["p95"] <= 0.15
    assert document["dead"] == []
    assert document["bytes_vector"] >= document["bytes_deltas"] > 0
    sent = sum(size for robot in document["per_robot"] for size in robot["sent"].values())
    assert sent == document["bytes_vector"]
    for robot in document["per_robot"]:
        assert sum(robot["sent"].values()) == robot["bytes_vector"]
    check_bytes(document)

    assert json.loads((result.out / "stats.json").read_text())["digest"] == document["digest"]
    assert load_fmap(result.out / "map.fmap").digest == document["digest"]
    assert load_map(result.out / "map.yaml").resolution_m == pytest.approx(0.05)
    assert document["digest"] in (result.out / "report.html").read_text()
    assert (result.out / "map.png").stat().st_size > 1000

    assert {p.phase for p in told} >= {"exploring", "converging"}
    assert all(gone(robot.pid) for robot in told[-1].robots)


def test_robots_that_do_not_know_their_starts_find_each_other(tmp_path) -> None:
    result = run_fleet(
        SimConfig(out=tmp_path, robots=2, size_m=16, seed=3, starts="unknown", listen="tcp/127.0.0.1:0"), lambda _: None
    )
    document = result.document
    assert (document["components"], document["converged"], document["collisions"]) == (1, True, 0)
    assert document["covered"] == 1.0
    error = document["merged_error_m"]
    assert isinstance(error, dict)
    assert error["p95"] < 0.08
    # Each was in a map of its own at first, and never at a wrong place of another's.
    assert 0.0 < document["misplaced_m"] < 0.1
    assert 0.0 < document["together_s"] <= document["simulated_s"]


def test_a_killed_robot_does_not_stop_the_others_and_the_report_says_so(tmp_path) -> None:
    killed: list[int] = []

    def kill_one(progress: Progress) -> None:
        if progress.t_s >= 9.0 and not killed:
            killed.append(progress.robots[1].pid)
            os.kill(killed[0], signal.SIGKILL)

    result = run_fleet(SimConfig(out=tmp_path, robots=3, world="maze", size_m=9, seed=4), kill_one)
    document = result.document
    assert killed
    (dead,) = document["dead"]
    assert dead["robot"] == "r1"
    assert "signal 9" in dead["reason"]
    assert dead["t_s"] >= 9.0
    assert document["converged"] is True
    assert document["covered"] >= 0.98
    report = (tmp_path / "report.html").read_text()
    assert "r1 was lost after" in report
    # Its map is still part of what the others hold.
    states = {robot["robot"]: robot["state"] for robot in document["per_robot"]}
    assert states["r1"] == "dead"


SCRIPT = """
import sys
from pathlib import Path
from fleetmap.sims import SimConfig, run_fleet
def tell(progress):
    print(progress.phase, progress.t_s, *[r.pid for r in progress.robots], flush=True)
run_fleet(SimConfig(out=Path(sys.argv[1]), robots=2, world="maze", size_m=20), tell)
"""


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_however_the_parent_ends_no_robot_outlives_it(tmp_path, how: signal.Signals) -> None:
    parent = subprocess.Popen(
        [sys.executable, "-c", SCRIPT, str(tmp_path)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        assert parent.stdout is not None
        for line in parent.stdout:
            phase, t_s, *pids = line.split()
            if phase == "exploring" and float(t_s) > 0:
                break
        parent.send_signal(how)
        _, errors = parent.communicate(timeout=30 * PATIENCE)
    finally:
        parent.kill()
    assert len(pids) == 2
    assert all(gone(int(pid)) for pid in pids)
    if how == signal.SIGINT:
        assert "KeyboardInterrupt" in errors
        assert parent.returncode != 0


@pytest.mark.parametrize(
    ("option", "value"),
    [("robots", 0), ("starts", "guessed"), ("seed", -1), ("range_m", float("nan")), ("radius_m", 0.0), ("beams", 3)],
)
def test_an_impossible_run_is_refused_before_anything_starts(tmp_path, option: str, value: object) -> None:
    with pytest.raises(ConfigError) as refused:
        SimConfig(out=tmp_path, **{option: value})  # type: ignore[arg-type]
    assert refused.value.option == option
