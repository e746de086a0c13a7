"""``fleetmap vectorize``: a grid becomes a vector map."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from fleetmap.cli.output import AsJson, print_json, print_table


def vectorize(
    grid: Annotated[Path, typer.Argument(metavar="MAP.yaml", help="A map_server map.")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="OUT.fmap", help="Where the vector map goes.")],
    epsilon: Annotated[float, typer.Option(min=0.5, max=64.0, help="Error bound in cells.")] = 2**0.5,
    specks: Annotated[
        int, typer.Option(min=0, max=10_000, help="Drop free and unknown specks of at most so many cells.")
    ] = 12,
    as_json: AsJson = False,
) -> None:
    """Turn a map_server grid into a vector map: the boundary of free space within epsilon.

    An independent check of the result against the grid says whether it is valid: every boundary point within
    epsilon of an edge and every point of an edge within epsilon of the boundary, edges that meet only at
    vertices, the same components of free space. Exits with 1 if it is not.

    Example:  fleetmap vectorize map.yaml -o map.fmap
    """
    from fleetmap.cli.maps import check_output, read_map_server
    from fleetmap.codecs.fmap import save_fmap
    from fleetmap.vectorize import vectorize as vectorize_grid
    from fleetmap.vectorize import verify

    check_output(out, ".fmap")
    cells = read_map_server(grid)
    vectorize_grid(cells, epsilon_cells=epsilon, specks=specks)  # the first call loads the kernels
    started = time.perf_counter()
    vector_map = vectorize_grid(cells, epsilon_cells=epsilon, specks=specks)
    elapsed_ms = (time.perf_counter() - started) * 1e3
    report = verify(cells, vector_map, specks=specks)
    save_fmap(vector_map, out)
    document = {
        "edges": len(vector_map),
        "vertices": vector_map.count_vertices(),
        "bytes": out.stat().st_size,
        "ms": elapsed_ms,
        "valid": report.valid,
        "violations": [
            {"kind": v.kind, "x_m": v.place_xy_m[0], "y_m": v.place_xy_m[1], "detail": v.detail}
            for v in report.violations
        ],
        "dropped": {"count": report.dropped.count, "cells": report.dropped.cells},
        "epsilon_cells": vector_map.epsilon_cells,
        "digest": f"{vector_map.digest:016x}",
    }
    if as_json:
        print_json(document)
    else:
        rows = [[k, str(document[k])] for k in ("edges", "vertices", "bytes")]
        rows += [
            ["time", f"{elapsed_ms:.1f} ms"],
            ["specks dropped", f"{report.dropped.count} ({report.dropped.cells} cells)"],
            ["valid", "yes" if report.valid else f"no: {len(report.violations)} violations"],
        ]
        print_table(f"{grid} -> {out}", ["", "value"], rows)
        for v in report.violations[:20]:
            typer.echo(f"  {v.kind} at ({v.place_xy_m[0]:.3f}, {v.place_xy_m[1]:.3f}) m: {v.detail}", err=True)
    if not report.valid:
        raise typer.Exit(1)
