"""Map files of ROS: a YAML header and a grey image, read as map_server of Nav2 reads them.

The image has the *top* row first, the grid the lowest y: rows are flipped both ways.
"""

from __future__ import annotations

import math
import os
import reprlib
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Literal

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.checks import check_type
from fleetmap.model.errors import ConfigError, MapFormatError, MapWarning
from fleetmap.model.grid import FREE_BELOW, FREE_THRESHOLD, OCCUPIED_ABOVE, OCCUPIED_THRESHOLD, OccupancyGrid
from fleetmap.model.map_image import Brightness, read_brightness
from fleetmap.model.pose import Pose2

GREY_OCCUPIED, GREY_FREE, GREY_UNKNOWN = 0, 254, 205
"""The greys that map_saver writes in trinary mode."""

RAW_UNKNOWN = 255
"""What stands for unknown in mode ``raw``, where any other grey up to 100 is the value itself."""

MODES = ("trinary", "scale", "raw")


@dataclass(frozen=True, slots=True)
class MapHeader:
    """What the YAML file says."""

    image: Path
    resolution_m: float
    origin: Pose2
    negate: bool
    occupied_thresh: float
    free_thresh: float
    mode: str


def load_map(yaml_path: str | os.PathLike[str]) -> OccupancyGrid:
    """Read a map_server map.

    The resolution stays the number in the file, and the origin may have a yaw. Warns with ``MapWarning``
    where map_server's rule makes free space of grey 205, its own mark for unknown, where an alpha channel
    changes cells, and where a PGM is longer than its header says.

    Raises
    ------
    MapFormatError : names the file and the field; raised before memory is taken for the cells
    """
    if not isinstance(yaml_path, str | os.PathLike):
        raise ConfigError(option="yaml_path", value=yaml_path, reason="expected the name of a map_server YAML file")
    header = read_header(Path(yaml_path))
    image = read_brightness(header.image)
    cells = _cells(image, header)

    def warn(message: str) -> None:
        warnings.warn(f"{yaml_path}: {message}", MapWarning, stacklevel=3)

    if image.surplus:
        warn(f"{header.image.name} goes on behind its last pixel, by {image.surplus}: is its header right?")
    if header.mode == "trinary" and image.alpha_yx is not None:
        colours, cells = cells, _cells(image.with_alpha(), header)
        changed = int(np.count_nonzero(cells != colours))
        if changed:
            warn(
                f"alpha of {header.image.name} counts as one more colour in mode trinary, as in map_server: {changed} "
                f"of {cells.size} cells are not what their colours say; expected an image without alpha, as "
                f"Image.open({header.image.name!r}).convert('L') of Pillow makes one"
            )
    occupancy = GREY_UNKNOWN / 255 if header.negate else 1 - GREY_UNKNOWN / 255
    if header.mode != "raw" and occupancy < header.free_thresh and (cells[image.is_grey(GREY_UNKNOWN)] == 0).any():
        warn(
            f"free_thresh {header.free_thresh} makes grey {GREY_UNKNOWN} (p = {occupancy:.3f}) free, "
            f"which map_saver writes for unknown; expected {FREE_THRESHOLD} if it means unknown here, too"
        )
    try:
        return OccupancyGrid(cells[::-1], header.resolution_m, header.origin)
    except MapFormatError as error:  # of the grid, which knows no file
        raise MapFormatError(path=os.fspath(yaml_path), field=error.field, reason=error.reason) from None


def save_map(grid: OccupancyGrid, yaml_path: str | os.PathLike[str], *, image: Literal["pgm", "png"] = "pgm") -> None:
    """Write a grid as a map_server map: ``yaml_path``, and the image beside it under the same stem.

    Reading it gives the same cells: mode ``trinary`` if they are all -1, 0 or 100, else ``raw``, which has no place
    for ``free_below`` and ``occupied_above``. Both files are written under other names and then moved, the image
    first, so that nobody reads half of one, and a disk that is full leaves the map that was there.

    Raises
    ------
    ConfigError : ``image`` is neither ``pgm`` nor ``png``, or ``grid`` no ``OccupancyGrid``
    OSError : the folder is missing or not writable, or its disk full
    """
    import yaml
    from PIL import Image

    check_type("grid", grid, OccupancyGrid, hint="of a MergedMap .to_grid() makes one, of a VectorMap rasterize()")
    if image not in ("pgm", "png"):
        raise ConfigError(option="image", value=image, reason="expected 'pgm' or 'png'")
    path = Path(yaml_path)
    image_path = path.with_suffix(f".{image}")
    if image_path == path:
        raise ConfigError(option="yaml_path", value=str(path), reason="has the name of the image; expected .yaml")

    if (grid.free_below, grid.occupied_above) != (FREE_BELOW, OCCUPIED_ABOVE):
        as_read = OccupancyGrid(grid.cells_yx, grid.resolution_m, grid.origin)
        changed = int(np.count_nonzero(as_read.states_yx() != grid.states_yx()))
        if changed:
            warnings.warn(
                f"{path}: the file has no place for free_below={grid.free_below:g} and occupied_above="
                f"{grid.occupied_above:g}: {changed} cells are read in another state, unless these are given again",
                MapWarning,
                stacklevel=2,
            )
    cells = grid.cells_yx[::-1]
    trinary = not ((cells > 0) & (cells < 100)).any()
    greys = np.arange(256).astype(np.uint8)
    if trinary:
        greys[[0, 100, 255]] = GREY_FREE, GREY_OCCUPIED, GREY_UNKNOWN
    pixels = Image.fromarray(greys[cells.view(np.uint8)])
    header = {
        "image": image_path.name,
        "mode": "trinary" if trinary else "raw",
        "resolution": float(grid.resolution_m),
        "origin": [grid.origin.x_m, grid.origin.y_m, grid.origin.yaw_rad],
        "negate": 0,
        "occupied_thresh": OCCUPIED_THRESHOLD,
        "free_thresh": FREE_THRESHOLD,
    }
    text = yaml.safe_dump(header, sort_keys=False, default_flow_style=None)
    with _written_whole(image_path, path) as (image_file, yaml_file):
        pixels.save(image_file, format="PPM" if image == "pgm" else "PNG")
        yaml_file.write(text.encode())


def read_header(path: Path) -> MapHeader:
    """Read and check the YAML file alone.

    Raises
    ------
    MapFormatError : as ``load_map``; the image is not looked at
    """
    from fleetmap.model.map_yaml import Value, as_number, as_truth, read_yaml

    fields = read_yaml(path)

    def refuse(field: str, expected: str) -> MapFormatError:
        found = reprlib.repr(fields[field]) if field in fields else "nothing"
        return MapFormatError(path=path, field=field, reason=f"expected {expected}; found {found}")

    def number(field: str, value: Value, expected: str) -> float:
        result = as_number(value)
        if math.isnan(result):
            raise refuse(field, expected)
        return result

    name = fields.get("image")
    if not isinstance(name, str) or not _is_file_name(name):
        raise refuse("image", "the name of an image file")
    resolution_m = number("resolution", fields.get("resolution"), "metres a cell, above 0")
    if resolution_m <= 0:
        raise refuse("resolution", "metres a cell, above 0")
    origin = fields.get("origin")
    if not isinstance(origin, list) or len(origin) != 3:
        raise refuse("origin", "[x, y, yaw]")
    x_m, y_m, yaw_rad = (number("origin", value, "three finite decimal numbers") for value in origin)
    occupied, free = (
        number(field, fields.get(field), "a number from 0 to 1") for field in ("occupied_thresh", "free_thresh")
    )
    if not 0 <= free < occupied <= 1:
        raise refuse("free_thresh", f"0 <= free_thresh < occupied_thresh <= 1 (occupied_thresh is {occupied})")
    mode = fields.get("mode", "trinary")
    if not isinstance(mode, str) or mode.lower() not in MODES:
        raise refuse("mode", " or ".join(MODES))
    negate = as_truth(fields.get("negate"))
    if negate is None:
        raise refuse("negate", "0 or 1")
    return MapHeader(path.parent / name, resolution_m, Pose2(x_m, y_m, yaw_rad), negate, occupied, free, mode.lower())


def _is_file_name(name: str) -> bool:
    try:
        return bool(name) and b"\0" not in os.fsencode(name)
    except UnicodeEncodeError:  # half of a surrogate pair, written as an escape
        return False


def _cells(image: Brightness, header: MapHeader) -> NDArray[np.int8]:
    """(height, width) cell values, top row first; one table over all levels of brightness."""
    shade = np.arange(image.full + 1) / image.full
    occupancy = shade if header.negate else 1 - shade
    if header.mode == "raw":
        value = np.rint(shade * 255)
        table = np.where(value <= 100, value, -1)
    else:
        is_occupied, is_free = occupancy > header.occupied_thresh, occupancy < header.free_thresh
        scaled = np.rint((occupancy - header.free_thresh) / (header.occupied_thresh - header.free_thresh) * 100)
        between = scaled if header.mode == "scale" else np.full_like(scaled, -1)
        table = np.where(is_occupied, 100, np.where(is_free, 0, between))
    cells: NDArray[np.int8] = table.astype(np.int8)[image.levels_yx]
    if header.mode == "scale" and image.alpha_yx is not None:
        cells[image.alpha_yx < 255] = -1
    return cells


@contextmanager
def _written_whole(*paths: Path) -> Iterator[list[IO[bytes]]]:
    """Files to write, beside where they belong; moved there in this order once all are written, else removed."""
    beside: list[Path] = []
    try:
        with ExitStack() as stack:
            files: list[IO[bytes]] = []
            for path in paths:
                handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
                beside.append(Path(name))
                files.append(stack.enter_context(os.fdopen(handle, "wb")))
            yield files
        for whole, path in zip(beside, paths, strict=True):
            whole.chmod(0o644)  # mkstemp's 0600 would hide the map from the other nodes of a robot
            whole.replace(path)
    finally:
        for left in beside:
            left.unlink(missing_ok=True)
