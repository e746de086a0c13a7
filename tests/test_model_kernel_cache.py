"""Compiled kernels: whatever becomes of their files, and wherever they can't be written, programs go on."""

import os
import pickle
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from fleetmap.model import kernel_cache
from fleetmap.model.interrupts import interrupts_later
from fleetmap.model.kernel import KernelFiles

SORT = "fleetmap.model.sort_kernels"
SORTS = """
    import numpy as np
    from fleetmap.model.sort_kernels import order_of
    rows = np.array([[3, 0], [1, 0], [2, 0]], np.int32)
    print(order_of(rows).tolist())
"""


def run(code, **environment):
    """Run code in a process of its own; its answer and what the log said."""
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout, done.stderr
