"""Where the numba kernels are, and whether what they compile to is kept."""

from __future__ import annotations

import importlib
import os
import pkgutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

PACKAGE = Path(__file__).parents[1]
"""Where the package ``fleetmap`` lies; importing it from here would turn the arrows between the rooms around."""


def kernel_modules() -> list[str]:
    """Full names of all modules whose name ends in ``_kernels``."""
    return sorted(
        info.name for info in pkgutil.walk_packages([str(PACKAGE)], "fleetmap.") if info.name.endswith("_kernels")
    )


def load_kernels() -> Iterator[str]:
    """Import them one by one: kernels state their signatures, so that the import compiles or loads them."""
    for name in kernel_modules():
        yield name
        importlib.import_module(name)


def cache_folder() -> str | None:
    """The folder that numba caches to, or None if it can't write there."""
    configured = os.environ.get("NUMBA_CACHE_DIR")
    candidates = (
        [Path(configured)]
        if configured
        # numba's own order: beside the source, then the user's cache folder.
        else [PACKAGE / "model" / "__pycache__", Path.home() / ".cache" / "numba"]
    )
    for folder in candidates:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                return str(folder)
        except OSError:
            continue
    return None
