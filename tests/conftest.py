"""What several test files share: a small map on disk, the command line as a subprocess, the real maps."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import zenoh
from hypothesis import settings

from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.kernel_cache import kernel_modules
from fleetmap.model.kernel_compiler import compile_ahead
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN
from fleetmap.model.map_server import save_map
from fleetmap.model.pose import Pose2
from fleetmap.peer.ports import free_port

# A shell that runs the tests in the background has its children ignore Ctrl-C; those that test it must not.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# The same examples on each run; long hunts belong in benchmarks/.
settings.register_profile("fleetmap", deadline=None, derandomize=True)
settings.load_profile("fleetmap")


def pytest_configure(config):
    """Compile on all cores what a run of all tests needs; single files compile what they import."""
    is_worker = hasattr(config, "workerinput")  # of pytest-xdist: they find what was compiled before they began
    if config.args_source is not config.ArgsSource.ARGS and not is_worker:
        compile_ahead(kernel_modules())


def pytest_collection_modifyitems(items):
    """Benchmarks come last: they are what is left out when the time is over."""
    items.sort(key=lambda item: "in_time" in getattr(item, "fixturenames", ()))


BUDGET_S = float(os.environ.get("FLEETMAP_TEST_BUDGET_S", "840"))
"""So long after the first test benchmarks are still begun."""


@pytest.fixture(scope="session", autouse=True)
def begun_s():
    return time.monotonic()


@pytest.fixture
def in_time(begun_s):
    """Skips, and says so, what would make the suite too long."""
    if time.monotonic() - begun_s > BUDGET_S:
        pytest.skip(f"the suite has run for {BUDGET_S:.0f} s: FLEETMAP_TEST_BUDGET_S gives it longer")


TIMEOUT_FACTOR = float(os.environ.get("FLEETMAP_TEST_TIMEOUT_FACTOR", "1"))
"""Scales every timeout of the tests, for slow machines."""


@dataclass(frozen=True)
class Run:
    """What a command did."""

    code: int
    out: str
    err: str

    @property
    def document(self):
        return json.loads(self.out)


@pytest.fixture(scope="session")
def timeout_factor():
    return TIMEOUT_FACTOR


@pytest.fixture(scope="session")
def fleetmap_command():
    """Run ``fleetmap ARGUMENTS`` as a user would, in a folder."""

    def run(*arguments, cwd, timeout_s=120.0):
        command = [sys.executable, "-m", "fleetmap", *map(str, arguments)]
        done = subprocess.run(
            command, cwd=cwd, capture_output=True, text=True, timeout=timeout_s * TIMEOUT_FACTOR, check=False
        )
        return Run(done.returncode, done.stdout, done.stderr)

    return run


def two_rooms():
    """A grid of 120 x 80 cells: two rooms with a door, a pillar, walls two cells thick, unknown around."""
    states = np.full((80, 120), UNKNOWN, np.uint8)
    states[8:72, 8:112] = OCCUPIED
    states[10:70, 10:60] = FREE
    states[10:70, 62:110] = FREE
    states[35:50, 60:62] = FREE
    states[25:28, 30:34] = OCCUPIED
    return OccupancyGrid.from_states(states, 0.05, Pose2(-1.0, 2.0, 0.0))


@pytest.fixture
def map_folder(tmp_path):
    """A folder with ``map.yaml``: two rooms with a door."""
    save_map(two_rooms(), tmp_path / "map.yaml")
    return tmp_path


@pytest.fixture
def router() -> Iterator[str]:
    """The endpoint of a router that tells peers nothing of each other."""
    endpoint = f"tcp/127.0.0.1:{free_port('127.0.0.1')}"
    config = zenoh.Config()
    settings = {"mode": '"router"', "listen/endpoints": f'["{endpoint}"]', "scouting/multicast/enabled": "false"}
    for key, value in {**settings, "scouting/gossip/enabled": "false"}.items():
        config.insert_json5(key, value)
    session = zenoh.open(config)
    yield endpoint
    session.close()


def real_maps():
    """The map_server YAMLs of the folder of real data, or a skip."""
    folder = os.environ.get("FLEETMAP_DATA")
    if not folder:
        return [pytest.param(None, marks=pytest.mark.skip(reason="FLEETMAP_DATA is not set: no real maps"))]
    return [pytest.param(path, id=path.parent.name) for path in sorted(Path(folder).glob("maps/*/map.yaml"))]


def pytest_generate_tests(metafunc):
    """A test that takes ``real_map`` runs on each real map."""
    if "real_map" in metafunc.fixturenames:
        metafunc.parametrize("real_map", real_maps())
