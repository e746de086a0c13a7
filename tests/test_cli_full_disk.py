"""Full disks, of results and of standard output: one sentence, an exit code, and nothing half written."""

import contextlib
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fleetmap.codecs.fmap import save_fmap
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.map_server import load_map, save_map
from fleetmap.vectorize import vectorize

MOST_S = 120.0


@pytest.fixture
def small_disk(tmp_path):
    """A disk of its own with room for 64 kB."""
    if os.geteuid() != 0:
        pytest.skip("not root: no disk of a test's own")
    folder = tmp_path / "disk"
    folder.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=64k", "none", folder], capture_output=True, check=False
    )
    if mounted.returncode != 0:
        pytest.skip(f"no rights to mount: {mounted.stderr.decode().strip()}")
    yield folder
    subprocess.run(["umount", folder], check=True)


def fill(folder: Path) -> None:
    with contextlib.suppress(OSError), (folder / "filler").open("wb", buffering=0) as file:
        while file.write(bytes(4096)):
            pass


def test_a_full_disk_is_one_sentence_and_leaves_what_was_there(fleetmap_command, small_disk, map_folder):
    vectors = map_folder / "map.fmap"
    save_fmap(vectorize(load_map(map_folder / "map.yaml")), vectors)
    save_map(OccupancyGrid(np.array([[100, 0]], np.int8), 0.05), small_disk / "old.yaml")
    fill(small_disk)
    there = sorted(os.listdir(small_disk))
    for command, as_json in (
        (["vectorize", map_folder / "map.yaml", "-o", vectors, "--residual", "map.fgrid"], True),
        (["rasterize", vectors, "-o", "old.yaml"], False),
        (["rasterize", vectors, "-o", "old.yaml", "--png"], True),
    ):
        run = fleetmap_command(*command, *["--json"] * as_json, cwd=small_disk)
        assert run.code == 1, (command, run.out, run.err)
        assert "Traceback" not in run.err
        if as_json:
            assert "No space left" in run.document["error"]["message"]
        else:
            assert re.fullmatch(r"error: .*No space left on device\n", run.err)
        assert sorted(os.listdir(small_disk)) == there, command
    assert load_map(small_disk / "old.yaml").cells_yx.tolist() == [[100, 0]]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")
@pytest.mark.parametrize(
    "arguments",
    [
        ["--version"],
        ["--help"],
        ["vectorize", "map.yaml", "-o", "map.fmap", "--json"],
        ["compare", "absent.yaml", "map.yaml", "--json"],
        ["nonsense", "--json"],
    ],
)
def test_a_full_standard_output_is_one_sentence(map_folder, timeout_factor, arguments):
    with Path("/dev/full").open("w") as full:
        run = subprocess.run(
            [sys.executable, "-m", "fleetmap", *arguments],
            cwd=map_folder, stdout=full, stderr=subprocess.PIPE, text=True, timeout=MOST_S * timeout_factor,
            check=False,
        )  # fmt: skip
    assert run.returncode == 1
    assert run.stderr.strip() == "error: standard output can't be written: No space left on device"


def test_a_reader_that_has_enough_is_no_error(map_folder, timeout_factor):
    reader, writer = os.pipe()
    os.close(reader)
    run = subprocess.run(
        [sys.executable, "-m", "fleetmap", "--help"],
        cwd=map_folder, stdout=writer, stderr=subprocess.PIPE, text=True, timeout=MOST_S * timeout_factor, check=False,
    )  # fmt: skip
    os.close(writer)
    assert (run.returncode, run.stderr) == (1, "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")
def test_who_can_be_told_nothing_still_gets_the_exit_code(map_folder, timeout_factor):
    with Path("/dev/full").open("w") as full:
        run = subprocess.run(
            [sys.executable, "-m", "fleetmap", "compare", "absent.yaml", "map.yaml"],
            cwd=map_folder, stdout=full, stderr=full, timeout=MOST_S * timeout_factor, check=False,
        )  # fmt: skip
    assert run.returncode == 1
