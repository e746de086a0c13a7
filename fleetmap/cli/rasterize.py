"""``fleetmap rasterize``: a vector map becomes a grid again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fleetmap.cli.output import AsJson, print_json


def rasterize(
    fmap: Annotated[Path, typer.Argument(metavar="IN.fmap", help="A vector map or a merged map; or a grid, IN.fgrid.")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="MAP.yaml", help="The map_server YAML to write.")],
    png: Annotated[bool, typer.Option("--png", help="Write a PNG image instead of a PGM.")] = False,
    residual: Annotated[
        Path | None,
        typer.Option(
            metavar="IN.fgrid",
            help="What the vector map leaves out: every cell comes back free, occupied or unknown as it was.",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Turn a vector map into a map_server grid (free, occupied, unknown) for nav2 and its friends.

    Examples:  fleetmap rasterize map.fmap -o grid.yaml

               fleetmap rasterize map.fmap -o grid.yaml --residual map.fgrid
    """
    from fleetmap.cli.maps import check_output, read_grid
    from fleetmap.model.errors import MapFormatError
    from fleetmap.model.map_server import save_map

    if fmap.suffix not in (".fmap", ".fgrid"):
        raise MapFormatError(path=fmap, field="name", reason="expected an .fmap or .fgrid file")
    check_output(out, ".yaml", ".yml")
    grid = read_grid(fmap, residual=residual)
    save_map(grid, out, image="png" if png else "pgm")
    if as_json:
        print_json({"width": grid.width, "height": grid.height, "resolution_m": grid.resolution_m, "out": str(out)})
    else:
        typer.echo(f"{out}: {grid.width} x {grid.height} cells of {grid.resolution_m} m")
