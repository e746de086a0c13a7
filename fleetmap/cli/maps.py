"""Maps named on the command line: a map_server YAML, or an .fmap file."""

from __future__ import annotations

from pathlib import Path

from fleetmap.model.errors import MapFormatError
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.map_server import load_map
from fleetmap.model.mergedmap import MergedMap


def read_grid(path: Path) -> OccupancyGrid:
    """The map in ``path`` as a grid: a YAML as it is, an .fmap rasterised."""
    from fleetmap.codecs.fmap import load_fmap
    from fleetmap.vectorize import rasterize

    if path.suffix == ".fmap":
        content = load_fmap(path)
        return content.to_grid() if isinstance(content, MergedMap) else rasterize(content)
    if path.suffix in (".yaml", ".yml"):
        return load_map(path)
    raise MapFormatError(path=path, field="name", reason="expected a map_server .yaml or an .fmap file")
