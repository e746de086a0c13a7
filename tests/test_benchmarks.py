"""Each script in benchmarks/ runs, on tiny input, so that none can rot. No figure is asserted."""

import subprocess
import sys
from pathlib import Path

import pytest

from fleetmap.codecs.mode1 import CONTEXTS

SCRIPTS = sorted((Path(__file__).parent.parent / "benchmarks").glob("*.py"))


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_every_benchmark_runs_on_tiny_input(script, timeout_factor):
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
