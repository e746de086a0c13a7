"""Maps named on the command line: a map_server YAML, or an .fmap file."""

from __future__ import annotations

import tempfile
from pathlib import Path

from fleetmap.model.errors import ConfigError, MapFormatError
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.map_server import load_map
from fleetmap.model.mergedmap import MergedMap


def check_output(path: Path, *suffixes: str) -> None:
    """Refuse a place for a result before any work is done for it.

    A name without its suffix could not be read again, and ``vectorize map.yaml -o map.yaml`` would destroy the map.
    """
    if path.suffix not in suffixes:
        raise ConfigError(option="out", value=str(path), reason=f"expected a name that ends in {' or '.join(suffixes)}")
    if path.is_dir():
        raise ConfigError(option="out", value=str(path), reason="is a folder; expected the name of a file")
    if not path.parent.is_dir():
        raise FileNotFoundError(f"{path}: there is no folder {path.parent}; make it first")
    _try_writing(path.parent, prefix=f".{path.name}.")


def check_folder(path: Path) -> None:
    """Refuse a folder of results, there or to be made, before any work is done for it."""
    there = next(folder for folder in (path.absolute(), *path.absolute().parents) if folder.exists())
    if not there.is_dir():
        raise ConfigError(option="out", value=str(path), reason=f"{there} is a file; expected a folder, or a new name")
    _try_writing(there, prefix=".fleetmap.")


def _try_writing(folder: Path, *, prefix: str) -> None:
    """Make a file and remove it, as results are written: only that tells of all that may stand in the way."""
    try:
        with tempfile.NamedTemporaryFile(dir=folder, prefix=prefix):
            pass
    except OSError as error:
        raise OSError(f"{folder}: no file can be written there: {error.strerror}") from None


def read_map_server(path: Path) -> OccupancyGrid:
    """The map_server map in ``path``; says so if it is something else that fleetmap writes."""
    if path.suffix == ".fmap":
        raise MapFormatError(path=path, field="name", reason="is a vector map; expected a map_server .yaml")
    if path.is_dir():
        raise MapFormatError(path=path, field="name", reason="is a folder; expected a map_server .yaml")
    return load_map(path)


def read_grid(path: Path, *, residual: Path | None = None) -> OccupancyGrid:
    """The map in ``path`` as a grid: a YAML or .fgrid as it is, an .fmap drawn, with what it leaves out if given."""
    from fleetmap.codecs.fgrid import load_fgrid
    from fleetmap.codecs.fmap import load_fmap
    from fleetmap.model.kernel_cache import modules_of
    from fleetmap.model.kernel_compiler import compile_ahead
    from fleetmap.vectorize import rasterize

    if path.suffix in (".fmap", ".fgrid"):
        compile_ahead(modules_of("model", "codecs"))
    if path.suffix == ".fmap":
        content = load_fmap(path)
        if isinstance(content, MergedMap):
            if residual is not None:
                raise ConfigError(option="residual", value=str(residual), reason="is for vector maps, not merged ones")
            return content.to_grid()
        if residual is not None:
            return load_fgrid(residual, base=(content.digest, lambda like: rasterize(content, like=like)))
        return rasterize(content)
    if residual is not None:
        raise ConfigError(option="residual", value=str(residual), reason="is for an .fmap file")
    if path.suffix == ".fgrid":
        return load_fgrid(path)
    if path.suffix in (".yaml", ".yml"):
        return load_map(path)
    raise MapFormatError(path=path, field="name", reason="expected a map_server .yaml, an .fmap or an .fgrid file")
