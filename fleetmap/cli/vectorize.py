"""``fleetmap vectorize``: a grid becomes a vector map."""

from __future__ import annotations

import time
from collections import Counter
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fleetmap.cli.output import AsJson, print_json, print_table

if TYPE_CHECKING:
    from fleetmap.model.vectormap import VectorMap

PLACES_SHOWN = 20
"""Of the violations so many are listed for people; ``--json`` has all of them."""


class Profile(StrEnum):
    """What a vector map holds."""

    SHARE = "share"
    FULL = "full"
    EXACT = "exact"


class Method(StrEnum):
    """How a grid becomes a vector map."""

    BOUNDARY = "boundary"
    PAPER = "paper"


class Reading(StrEnum):
    """How the paper's greedy is read."""

    B = "B"
    C = "C"
    MENDED = "mended"


def vectorize(
    grid: Annotated[Path, typer.Argument(metavar="MAP.yaml", help="A map_server map.")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="OUT.fmap", help="Where the vector map goes.")],
    profile: Annotated[
        Profile,
        typer.Option(
            case_sensitive=False,
            help="share: the boundary of free space, with the thickness of walls. full: all boundaries between free, "
            "occupied and unknown. exact: full, and every cell comes back free, occupied or unknown as it was.",
        ),
    ] = Profile.SHARE,
    epsilon: Annotated[
        float | None,
        typer.Option(
            min=0.5,
            max=64.0,
            show_default="sqrt(2)",
            help="Error bound in cells; 1 to 4 for the paper's method; exact has its own.",
        ),
    ] = None,
    specks: Annotated[
        int | None,
        typer.Option(
            min=0,
            max=10_000,
            show_default="12",
            help="Drop free and unknown specks of at most so many cells; for the boundary method.",
        ),
    ] = None,
    method: Annotated[
        Method,
        typer.Option(
            case_sensitive=False, help="Trace the boundary of free space, or run the paper's greedy to compare."
        ),
    ] = Method.BOUNDARY,
    reading: Annotated[
        Reading | None,
        typer.Option(
            case_sensitive=False, show_default="C", help="How to read the paper's greedy; for the paper's method."
        ),
    ] = None,
    residual: Annotated[
        Path | None,
        typer.Option(
            metavar="OUT.fgrid",
            help="Also write what the vector map leaves out: with both, rasterize gives every cell back as free, "
            "occupied or unknown; values between 0 and 100 are not kept.",
        ),
    ] = None,
    free_below: Annotated[
        float | None,
        typer.Option(
            metavar="PERCENT", show_default="20", help="Cells with a value below are free; for modes scale and raw."
        ),
    ] = None,
    occupied_above: Annotated[
        float | None,
        typer.Option(
            metavar="PERCENT",
            show_default="64",
            help="Cells with a value above are occupied; those between are unknown.",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Turn a map_server grid into a vector map: the boundary of free space within epsilon.

    An independent check of the result against the grid says whether it is valid: every boundary point within
    epsilon of an edge and every point of an edge within epsilon of the boundary, edges that meet only at
    vertices, the same components of free space, and no wall with a hole in the grid that is drawn of it. Exits
    with 1 if it is not.

    The map is lossy: drawn as a grid again it kept MS above 96 %, OPDF above 97 % and UPDF above 99 % on all of 21
    real maps. Profile share draws walls 12 cells deep at most: of thicker or hollow obstacles far less comes back
    (OPDF_reverse 60 % for a block with walls of 60 cells); full has them whole.

    With --method paper the graph of occupied cells is shortened as in Baizid et al. 2016, and the points to be
    near are the centres of occupied cells that touch a free one. The result is written in any case.

    Examples:  fleetmap vectorize map.yaml -o map.fmap

               fleetmap vectorize map.yaml -o lossless.fmap --profile exact

               fleetmap vectorize map.yaml -o map.fmap --residual map.fgrid

               fleetmap vectorize graded.yaml -o map.fmap --free-below 50 --occupied-above 54
    """
    from fleetmap.cli.maps import check_output, read_map_server
    from fleetmap.codecs.fgrid import check_size, save_fgrid
    from fleetmap.codecs.fmap import save_fmap
    from fleetmap.model.errors import ConfigError
    from fleetmap.model.kernel_cache import modules_of
    from fleetmap.model.kernel_compiler import compile_ahead
    from fleetmap.vectorize import rasterize, verify
    from fleetmap.vectorize import vectorize as vectorize_grid
    from fleetmap.vectorize.paper_method import vectorize_by_paper
    from fleetmap.vectorize.vectorizer import Vectorizer

    by_paper = method is Method.PAPER
    if by_paper and specks is not None:
        raise ConfigError(option="specks", value=specks, reason="the paper's method drops none: leave it out")
    if not by_paper and reading is not None:
        raise ConfigError(option="reading", value=reading.value, reason="is for --method paper")
    if by_paper and profile is not Profile.SHARE:
        raise ConfigError(option="profile", value=profile.value, reason="is for --method boundary")
    options = Vectorizer(profile=profile.value, epsilon_cells=epsilon, specks=specks)  # refuses what can't be
    check_output(out, ".fmap")
    if residual is not None:
        check_output(residual, ".fgrid")
    cells = read_map_server(grid).with_thresholds(free_below=free_below, occupied_above=occupied_above)
    if residual is not None:
        check_size(cells, residual)
    if by_paper:
        reading = reading or Reading.C

    def make() -> VectorMap:
        if reading is not None:
            return vectorize_by_paper(cells, reading=reading.value, epsilon_cells=options.epsilon_cells)
        return vectorize_grid(cells, profile=profile.value, epsilon_cells=epsilon, specks=specks)

    groups = ("vectorize.paper",) if by_paper else ("vectorize",)
    compile_ahead(modules_of("model", *groups, "vectorize.verify", "codecs"))
    make()  # the first call loads the kernels
    started = time.perf_counter()
    vector_map = make()
    elapsed_ms = (time.perf_counter() - started) * 1e3
    report = verify(
        cells, vector_map, points="centres" if by_paper else "boundary", specks=0 if by_paper else options.specks
    )
    save_fmap(vector_map, out)
    if residual is not None:
        save_fgrid(cells, residual, base=(vector_map.digest, lambda like: rasterize(vector_map, like=like)))
    document = {
        "profile": vector_map.profile,
        "method": method.value,
        "reading": reading and reading.value,
        "edges": len(vector_map),
        "vertices": vector_map.count_vertices(),
        "bytes": out.stat().st_size,
        "residual_bytes": None if residual is None else residual.stat().st_size,
        "ms": elapsed_ms,
        "valid": report.valid,
        "violations": [
            {"kind": v.kind, "x_m": v.place_xy_m[0], "y_m": v.place_xy_m[1], "detail": v.detail}
            for v in report.violations
        ],
        "dropped": {"count": report.dropped.count, "cells": report.dropped.cells},
        "epsilon_cells": vector_map.epsilon_cells,
        "free_below": cells.free_below,
        "occupied_above": cells.occupied_above,
        "digest": f"{vector_map.digest:016x}",
    }
    if as_json:
        print_json(document)
    else:
        counts = Counter(v.kind for v in report.violations)
        rows = [
            ["profile", vector_map.profile],
            ["method", f"{method.value}, reading {reading.value}" if reading else method.value],
        ]
        rows += [[k, str(document[k])] for k in ("edges", "vertices", "bytes")]
        rows += [["residual", f"{document['residual_bytes']}"]] if residual is not None else []
        rows += [
            ["time", f"{elapsed_ms:.1f} ms"],
            ["specks dropped", f"{report.dropped.count} ({report.dropped.cells} cells)"],
            ["valid", "yes" if report.valid else f"no: {len(report.violations)} violations"],
        ]
        # The paper's two constraints, kept or not, before what else a vector map promises.
        shown = dict.fromkeys([*(["uncovered", "astray"] if by_paper else []), *counts])
        rows += [[f"  {kind}", str(counts[kind])] for kind in shown]
        print_table(f"{grid} -> {out}", ["", "value"], rows)
        for kind in counts:
            of_kind = [v for v in report.violations if v.kind == kind]
            for v in of_kind[: PLACES_SHOWN // len(counts)]:
                typer.echo(f"  {v.kind} at ({v.place_xy_m[0]:.3f}, {v.place_xy_m[1]:.3f}) m: {v.detail}", err=True)
        if len(report.violations) > PLACES_SHOWN:
            typer.echo(f"  at most {PLACES_SHOWN} places are listed here; --json lists all", err=True)
    if not report.valid:
        raise typer.Exit(1)
