"""Everything that README, docs and examples show is run."""

import contextlib
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from buildings import make_pair

import fleetmap
import fleetmap.sync
from fleetmap.model.map_server import save_map
from fleetmap.peer import rendezvous
from fleetmap.sims.fleet import FLEET

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()


def python_blocks():
    found = []
    for path in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]:
        blocks = re.findall(r"```python\n(.*?)```", path.read_text(), re.DOTALL)
        found += [pytest.param(block, id=f"{path.name}-{i}") for i, block in enumerate(blocks)]
    return found


@pytest.mark.parametrize("block", python_blocks())
def test_every_python_snippet_runs(block, map_folder):
    # The page on security runs where its commands have made these; what is in them is its own tests' matter.
    (map_folder / "keys").mkdir(exist_ok=True)
    for name in ("ca.crt", "r1.crt", "r1.key"):
        (map_folder / "keys" / name).touch()
    done = subprocess.run(
        [sys.executable, "-c", block], cwd=map_folder, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr


def test_the_commands_of_the_table_run_in_its_order(fleetmap_command, map_folder):
    commands = re.findall(r"^\| `fleetmap (.*?)` \|", README, re.MULTILINE)
    assert len(commands) >= 6
    # Not the usual two rooms: turned by half a turn they look almost the same, so that nobody can align them.
    save_map(make_pair("same", 1).a, map_folder / "map.yaml")
    for command in commands:
        beside = contextlib.nullcontext()
        # The endpoint that README names may be in use by another fleet on this machine.
        endpoint = f"tcp/127.0.0.1:{rendezvous.free_port('127.0.0.1')}"
        command = command.replace(f"tcp/127.0.0.1:{rendezvous.PORT}", endpoint)
        if " --fleet " in command:
            fleet = re.search(r"--fleet (\S+)", command)[1]
            start = fleetmap.Pose2()
            beside = fleetmap.sync.join("r0", fleet=fleet, start=start, listen=[endpoint], profile="local")
        with beside as peer:
            if peer is not None:
                peer.publish(map_folder / "map.yaml")
            run = fleetmap_command(*shlex.split(command), cwd=map_folder, timeout_s=300)
        assert run.code == 0, f"fleetmap {command}: {run.err}"
    assert (map_folder / "RUN" / "report.html").exists()


def test_the_fleet_that_is_watched_is_the_one_that_a_simulation_opens():
    (watched,) = re.findall(r"^\| `fleetmap (stats --fleet .*?)` \|", README, re.MULTILINE)
    assert f"--fleet {FLEET} --connect tcp/127.0.0.1:{rendezvous.PORT} " in watched


def test_the_first_command_installs_and_runs_what_exists():
    (first,) = re.findall(r"^(python3 -m venv .*fleetmap sim .*)$", README, re.MULTILINE)
    assert ".venv/bin/pip install -e ." in first
    assert first.endswith("fleetmap sim --robots 4 --world office --size 40 --seed 1 --out RUN")


def test_links_lead_somewhere():
    for path in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]:
        for target in re.findall(r"\]\((?!https?:)([^)#]+)", path.read_text()):
            assert (path.parent / target).exists(), f"{path.name}: {target}"


def test_examples_add_sharing_in_under_thirty_lines():
    for path in (ROOT / "examples").glob("*.py"):
        text = re.sub(r'""".*?"""', "", path.read_text(), flags=re.DOTALL)
        lines = [line for line in text.splitlines() if line.strip() and not line.strip().startswith("#")]
        assert len(lines) < 30, path.name
