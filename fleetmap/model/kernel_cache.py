"""Where the numba kernels are, which of them belong together, and where what they compile to is kept.

numba isn't imported here: a command may ask before it knows whether it needs a kernel at all.
"""

from __future__ import annotations

import hashlib
import logging
import os
import re
import tempfile
from collections.abc import Iterable
from contextlib import suppress
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).parents[1]
"""Where the package ``fleetmap`` lies; importing it from here would turn the arrows between the rooms around."""

AGENT = ("model", "vectorize", "codecs", "merge", "align")
"""Groups of kernels that a peer needs, from the grid that it publishes to the merged map."""

ROOM_BYTES = 1 << 20
"""A folder that can't take so much isn't written to. The largest kernel takes 600 kB, all of them 17 MB."""

logger = logging.getLogger(__name__)


# Modules


@cache
def kernel_modules() -> tuple[str, ...]:
    """Full names of all modules whose name ends in ``_kernels``."""
    found = (path.relative_to(PACKAGE).with_suffix("").parts for path in PACKAGE.rglob("*_kernels.py"))
    return tuple(sorted(".".join(("fleetmap", *parts)) for parts in found))


def group(module: str) -> str:
    """What a kernel module is for: its room, or ``vectorize.verify`` and ``vectorize.paper``, which few need."""
    *_, room, stem = module.split(".")
    use = stem.split("_")[0]
    return f"{room}.{use}" if use in ("verify", "paper") else room


def modules_of(*groups: str) -> list[str]:
    """The kernel modules of these groups and those that they import, each after what it imports."""
    return with_imports(module for module in kernel_modules() if group(module) in groups)


def with_imports(modules: Iterable[str]) -> list[str]:
    """``modules`` and the kernel modules that they import, each after what it imports."""
    found: dict[str, None] = {}

    def add(module: str) -> None:
        if module not in found:
            for imported in imported_kernels(module):
                add(imported)
            found[module] = None

    for module in modules:
        add(module)
    return list(found)


def imported_kernels(module: str) -> list[str]:
    """The kernel modules that a kernel module imports itself."""
    return [name for name in _imports(source_of(module)) if name.endswith("_kernels")]


def source_of(module: str) -> Path:
    """The file of a module of this package."""
    return PACKAGE.joinpath(*module.split(".")[1:]).with_suffix(".py")


@cache
def _imports(source: Path) -> tuple[str, ...]:
    """Modules of this package that a file imports by lines ``from fleetmap.x import y`` at its top level."""
    found = []
    for origin, names in re.findall(r"^from (fleetmap[\w.]*) import ([\w, ]*)", source.read_text("utf-8"), re.M):
        named = [f"{origin}.{name.split()[0]}" for name in names.split(",") if name.strip()]
        # The decorator compiles nothing into a kernel; its options are stamped apart.
        found += [n for n in (origin, *named) if n != "fleetmap.model.kernel" and source_of(n).is_file()]
    return tuple(found)


@cache
def stamp(source: Path) -> str:
    """Tells the state of a source file and of the kernels that it imports.

    numba's own stamp is that of the file alone: a kernel went on calling the old code of another file.
    """
    whole = hashlib.sha256()
    seen: set[Path] = set()

    def add(path: Path) -> None:
        if path in seen:
            return
        seen.add(path)
        whole.update(hashlib.sha256(path.read_bytes()).digest())
        if path == source or path.stem.endswith("_kernels"):
            for name in _imports(path):
                add(source_of(name))

    add(source)
    return whole.hexdigest()


# Folders


@cache
def _candidates() -> tuple[Path | None, ...]:
    """Folders in numba's own order; None stands for ``__pycache__`` beside each source."""
    configured = os.environ.get("NUMBA_CACHE_DIR")
    if configured:
        return (Path(configured),)
    user = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return (None, Path(user) / "numba")


_temporary: list[tempfile.TemporaryDirectory[str]] = []
"""The folder that stands in for all others in this process, once none of them can be written."""


def reading_folders(source: Path) -> list[Path]:
    """Where the compiled kernels of a file may be, whether or not that can be written."""
    return [_place(base, source) for base in (*_candidates(), *(Path(folder.name) for folder in _temporary))]


def writing_folder(source: Path) -> Path | None:
    """Where to keep the compiled kernels of a file; None if nowhere can be written."""
    base = _writable()
    return None if base is None else _place(base[0], source)


def is_temporary(folder: Path) -> bool:
    """Whether the folder ends with this process."""
    return any(folder.is_relative_to(temporary.name) for temporary in _temporary)


def environment() -> dict[str, str]:
    """The environment for processes of one's own: they share the folder that stands in for all others."""
    return {**os.environ, **({"NUMBA_CACHE_DIR": _temporary[0].name} if _temporary else {})}


def _place(base: Path | None, source: Path) -> Path:
    if base is None:
        return source.parent / "__pycache__"
    # As numba does: one folder for each folder of sources.
    return base / f"{source.parent.name}_{hashlib.sha1(str(source.parent).encode()).hexdigest()}"


@cache
def _writable() -> tuple[Path | None] | None:
    """The first folder that can be written, in a tuple of its own; a temporary one if there is no other."""
    for base in _candidates():
        if _has_room(PACKAGE / "model" / "__pycache__" if base is None else base):
            return (base,)
    with suppress(OSError):
        folder = tempfile.TemporaryDirectory(prefix="fleetmap-kernels-", ignore_cleanup_errors=True)
        if _has_room(Path(folder.name)):
            _temporary.append(folder)
        else:
            folder.cleanup()
    tried = " or ".join(str(base or PACKAGE / "*" / "__pycache__") for base in _candidates())
    logger.warning(
        "compiled kernels can't be kept in %s: this process compiles for itself, which takes a minute or two. "
        "Set NUMBA_CACHE_DIR to a folder that can be written, or run `fleetmap warmup` as who may write there",
        tried,
    )
    return (Path(_temporary[0].name),) if _temporary else None


def _has_room(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(bytes(ROOM_BYTES))
            file.flush()
    except OSError:
        return False
    return True
