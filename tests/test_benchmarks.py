"""Each script in benchmarks/ runs, on tiny input, so that none can rot. No figure is asserted."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from fleetmap.codecs.mode1 import CONTEXTS

SCRIPTS = sorted((Path(__file__).parent.parent / "benchmarks").glob("*.py"))
OWN_TESTS = ("wire",)


@pytest.mark.parametrize("script", [s for s in SCRIPTS if s.stem not in OWN_TESTS], ids=lambda path: path.stem)
def test_every_benchmark_runs_on_tiny_input(script, timeout_factor, in_time):
    done = subprocess.run(
        [sys.executable, script, "--tiny"], capture_output=True, text=True, timeout=120 * timeout_factor, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()


def test_the_training_prints_tables_for_every_context():
    script = Path(__file__).parent.parent / "benchmarks" / "train_mode1.py"
    done = subprocess.run([sys.executable, script, "--tiny"], capture_output=True, text=True, check=True)
    module: dict[str, object] = {}
    exec(done.stdout, module)
    assert [len(table) for name in ("DELTA", "SNAPSHOT") for table in module[name]] == [CONTEXTS] * 4


def test_the_estimator_of_bytes_on_the_wire_agrees_with_the_kernel():
    script = Path(__file__).parent.parent / "benchmarks" / "wire.py"
    done = subprocess.run([sys.executable, script, "--tiny", "--json"], capture_output=True, text=True, check=True)
    if done.stdout.startswith("skipped"):
        pytest.skip(done.stdout.strip())
    (puts,) = json.loads(done.stdout)["put"]
    assert puts["kernel"] > puts["payload"]
    assert abs(puts["off"]) < 0.1
