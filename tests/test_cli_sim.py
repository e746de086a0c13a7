"""``fleetmap sim`` and the examples, run together as a user would: real processes, real sessions on loopback."""

import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parent.parent / "examples"
KEYS = {
    "robots", "components", "covered", "converged", "digest", "collisions", "merged_error_m", "duration_s",
    "bytes_vector", "bytes_deltas", "bytes_grid_gzip_full", "bytes_grid_gzip_updates", "ratio_full", "ratio_updates",
}  # fmt: skip


def wait_for_line(stream, pattern):
    """The first line that matches; the caller's watchdog ends the process if none ever does."""
    for line in stream:
        if found := re.search(pattern, line):
            return found
    raise AssertionError(f"no line matched {pattern!r}")


def test_guests_join_a_finished_fleet_and_hold_the_same_map(fleetmap_command, tmp_path, timeout_factor):
    command = [sys.executable, "-m", "fleetmap", "sim", "--robots", "2", "--size", "8", "--hold-s", "25", "--json"]
    with subprocess.Popen(
        [*command, "--out", "RUN"], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as fleet:
        try:
            name, endpoint = wait_for_line(fleet.stderr, r"holding: .*fleet (\S+) at (tcp/127\.0\.0\.1:\d+)").groups()
            watch = ("stats", "--fleet", name, "--connect", endpoint, "--no-multicast-scouting", "--for-s", 1, "--json")
            watched = fleetmap_command(*watch, cwd=tmp_path)
            assert watched.code == 0, watched.err
            digests = set()
            for example in ("embed_async.py", "embed_sync.py"):
                guest = subprocess.run(
                    [sys.executable, EXAMPLES / example, "--fleet", name, "--connect", endpoint],
                    capture_output=True, text=True, timeout=30 * timeout_factor, check=False,
                )  # fmt: skip
                assert guest.returncode == 0, guest.stderr
                digests.add(re.search(r"digest: (\w+)", guest.stdout)[1])
            out, _ = fleet.communicate(timeout=120 * timeout_factor)
        finally:
            fleet.terminate()
    found = json.loads(out)
    assert set(found) >= KEYS
    assert found["converged"] is True
    assert found["components"] == 1
    assert found["collisions"] == 0
    assert found["covered"] > 0.9
    assert digests == {found["digest"]}
    # What a watcher shows is what the robots counted; only their hearts beat on.
    for row, robot in zip(watched.document["robots"], found["per_robot"], strict=True):
        shown = {kind: count["bytes"] for kind, count in row["kinds"].items() if kind != "digest"}
        assert (row["robot"], shown) == (robot["robot"], {k: n for k, n in robot["sent"].items() if k != "digest"})
        assert row["grid_gzip_full"] == robot["bytes_grid_gzip_full"]
    folder = tmp_path / "RUN"
    assert {"report.html", "map.png", "map.yaml", "map.fmap", "stats.json"} <= {p.name for p in folder.iterdir()}


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_run_says_so_and_ends(tmp_path, timeout_factor, how):
    command = [sys.executable, "-m", "fleetmap", "sim", "--robots", "2", "--size", "20", "--json", "--out", "RUN"]
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    earlier = [tmp_path / "RUN" / name for name in ("stats.json", "report.html", "logs/r7.log")]
    (tmp_path / "RUN" / "logs").mkdir(parents=True)
    for path in earlier:
        path.write_text("{}")
    here = {**os.environ, "TMPDIR": str(scratch)}
    with subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=here
    ) as fleet:
        try:
            pids = re.findall(r"\[(\d+)\]", wait_for_line(fleet.stderr, r"exploring: .*")[0])
            fleet.send_signal(how)
            out, _ = fleet.communicate(timeout=30 * timeout_factor)
        finally:
            fleet.kill()
    assert fleet.returncode == 130
    assert json.loads(out)["error"]["type"] == "Interrupted"
    assert not any(path.exists() for path in earlier)
    assert not list(scratch.glob("fleetmap-sim-*"))
    assert len(pids) == 2
    assert not any(Path(f"/proc/{pid}").exists() for pid in pids)


@pytest.mark.parametrize("wire", [True, False])
def test_a_run_is_shown_by_payload_and_wire_and_an_older_one_without_wire(fleetmap_command, tmp_path, wire):
    names = {"vector": 1000, "deltas": 600, "grid_gzip_full": 50_000, "grid_gzip_updates": 9000}
    document = {f"bytes_{name}": size for name, size in names.items()}
    document |= {"per_robot": [{"robot": "r0", "sent": {"delta": 600, "pose": 400}}], "simulated_s": 10.0}
    if wire:
        document |= {"wire_bytes_vector": 8000, "wire_bytes_grid_gzip_full": 60_000, "bytes_per_m2": 4.0}
        document |= {"wire_bytes_per_m2": 32.0}
    (tmp_path / "RUN").mkdir()
    (tmp_path / "RUN" / "stats.json").write_text(json.dumps(document))
    found = fleetmap_command("stats", "RUN", "--json", cwd=tmp_path).document
    assert found["codecs"] == names
    assert found["ratios"]["grid_gzip_full"] == 50.0
    assert found["wire_ratios"] == ({"vector": 1.0, "grid_gzip_full": 7.5} if wire else {})
    table = fleetmap_command("stats", "RUN", cwd=tmp_path)
    assert table.code == 0, table.err
    assert "50.00" in table.out
    assert ("7.50" in table.out) == wire
    assert ("32.00" in table.out) == wire
