"""Maps named on the command line: a map_server YAML, an .fmap or .fgrid file, or the picture of a floor plan."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fleetmap.model.checks import as_number
from fleetmap.model.errors import ConfigError, MapFormatError
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import FREE, OCCUPIED
from fleetmap.model.map_image import read_brightness
from fleetmap.model.map_server import load_map
from fleetmap.model.mergedmap import MergedMap
from fleetmap.model.vectormap import VectorMap

PICTURES = (".png", ".pgm", ".bmp")
"""Of floor plans: what ``model.map_image`` reads."""

DARK_BELOW = 128
"""Pixels of a floor plan that are darker, of 255, are walls."""


def check_output(path: Path, *suffixes: str, inputs: Sequence[Path] = ()) -> None:
    """Refuse a place for a result before any work is done for it.

    A name without its suffix could not be read again, and ``vectorize map.yaml -o map.yaml`` would destroy the map.
    """
    if path.suffix not in suffixes:
        raise ConfigError(option="out", value=str(path), reason=f"expected a name that ends in {' or '.join(suffixes)}")
    if any(path.resolve() == given.resolve() for given in inputs):
        raise ConfigError(option="out", value=str(path), reason="is one of the maps that are read; expected a new name")
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


def check_resolution(path: Path | None, resolution_m: float | None) -> None:
    """Refuse a floor plan without its resolution, and a resolution without a floor plan, before any work is done.

    Raises
    ------
    ConfigError : names it
    """
    picture = path is not None and path.suffix.lower() in PICTURES
    if resolution_m is None:
        if picture:
            reason = f"expected the metres a pixel of {path}: a picture doesn't say them"
            raise ConfigError(option="resolution", value=None, reason=reason)
        return
    number = as_number(resolution_m)
    if number is None or number <= 0:
        raise ConfigError(option="resolution", value=resolution_m, reason="expected metres a pixel, above 0")
    if not picture:
        reason = f"is for the picture of a floor plan ({', '.join(PICTURES)}); other maps have their own"
        raise ConfigError(option="resolution", value=resolution_m, reason=reason)


def read_vector_map(path: Path, resolution_m: float | None = None) -> VectorMap:
    """The map in ``path`` as vectors: those of an .fmap file; a grid, a merged map or a floor plan is vectorized.

    Parameters
    ----------
    resolution_m : metres a pixel, of a floor plan (``check_resolution``)

    Raises
    ------
    MapFormatError : names the file and the field
    """
    from fleetmap.codecs.fmap import load_fmap
    from fleetmap.model.kernel_cache import modules_of
    from fleetmap.model.kernel_compiler import compile_ahead
    from fleetmap.vectorize import vectorize

    compile_ahead(modules_of("model", "vectorize", "codecs"))
    content = load_fmap(path) if path.suffix == ".fmap" else None
    if isinstance(content, VectorMap):
        return content
    try:
        if content is not None:
            return vectorize(content.to_grid())
        if path.suffix.lower() not in PICTURES:
            return vectorize(read_grid(path))
        if resolution_m is None:
            reason = "is a picture; expected a map_server .yaml, an .fmap or an .fgrid file"
            raise MapFormatError(path=path, field="name", reason=reason)
        return vectorize(read_plan(path, resolution_m))
    except MapFormatError as error:
        if not error.path.startswith("<"):
            raise
        raise MapFormatError(path=path, field=error.field, reason=error.reason) from None  # of an array or a map


def read_plan(path: Path, resolution_m: float) -> OccupancyGrid:
    """A floor plan: dark pixels are walls, all others free. Its lower left corner is at (0, 0), as map_server's.

    Raises
    ------
    MapFormatError : names the file and the field
    """
    image = read_brightness(path)
    if image.alpha_yx is None:
        dark = image.levels_yx < DARK_BELOW * (image.full // 255)
    else:  # as on white paper
        alpha = image.alpha_yx.astype(np.int64)
        dark = image.levels_yx * alpha + image.full * (255 - alpha) < DARK_BELOW * image.full
    states = np.where(dark[::-1], OCCUPIED, FREE).astype(np.uint8)
    return OccupancyGrid.from_states(states, resolution_m)
