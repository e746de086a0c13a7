"""``fleetmap stats``: what vector maps cost, beside what grids would have cost."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from fleetmap.cli.output import AsJson, print_json, print_table
from fleetmap.model.errors import MapFormatError


def stats(
    inputs: Annotated[
        list[Path], typer.Argument(metavar="MAP.yaml... | RUN", help="map_server maps, or one run folder of `sim`.")
    ],
    as_json: AsJson = False,
) -> None:
    """Compare the size of vector maps with that of compressed grids, per map or over a finished run.

    For maps: bytes of each codec and its ratio to gzip -9 of the grid. The vector rows are lossy (epsilon
    = sqrt(2) cells), so the paper's metrics against the grid stand beside them. `vector` drops free and
    unknown specks of at most 12 cells, `vector_specks` keeps them.

    For instance:  fleetmap stats maps/*.yaml

    or, after a simulation:  fleetmap stats RUN --json
    """
    if len(inputs) == 1 and inputs[0].is_dir():
        document = _run_stats(inputs[0])
        if as_json:
            print_json(document)
        else:
            _print_run(document)
        return
    documents = []
    for path in inputs:
        document = _map_stats(path)
        documents.append(document)
        if not as_json:
            _print_map(document)
    if as_json:
        print_json({"maps": documents, "median_ratios": _medians(documents)})
    elif len(documents) > 1:
        rows = [[name, f"{ratio:.2f}"] for name, ratio in _medians(documents).items()]
        print_table(f"median of {len(documents)} maps", ["codec", "x below gzip -9"], rows)


def _map_stats(path: Path) -> dict[str, Any]:
    from fleetmap.cli.maps import read_map_server
    from fleetmap.codecs.baselines import gzip_grid, png_grid
    from fleetmap.codecs.protocol import encode_snapshot
    from fleetmap.model.metrics import compare
    from fleetmap.vectorize import rasterize, vectorize

    grid = read_map_server(path)
    codecs = {
        "raw": int(grid.cells_yx.size),
        "gzip6": gzip_grid(grid, level=6),
        "gzip9": gzip_grid(grid, level=9),
        "png": png_grid(grid),
    }
    metrics, edges = {}, {}
    for name, specks in (("vector", 12), ("vector_specks", 0)):
        vector_map = vectorize(grid, specks=specks)
        codecs[name] = len(encode_snapshot(vector_map))
        edges[name] = len(vector_map)
        found = compare(rasterize(vector_map, like=grid), grid)
        metrics[name] = {m: getattr(found, m) for m in ("MS", "CC", "PC", "OPDF", "UPDF")}
    return {
        "map": str(path),
        "width": grid.width,
        "height": grid.height,
        "resolution_m": grid.resolution_m,
        "edges": edges,
        "codecs": codecs,
        "ratios": {name: codecs["gzip9"] / size for name, size in codecs.items()},
        "metrics": metrics,
    }


def _medians(documents: list[dict[str, Any]]) -> dict[str, float]:
    import statistics

    names = documents[0]["ratios"] if documents else {}
    return {name: statistics.median(d["ratios"][name] for d in documents) for name in names}


def _print_map(document: dict[str, Any]) -> None:
    rows = []
    for name, size in document["codecs"].items():
        metrics = document["metrics"].get(name)
        lossy = [f"{metrics[m]:.2f}" for m in ("MS", "CC", "PC", "OPDF", "UPDF")] if metrics else ["100"] * 5
        rows.append([name, f"{size:,}", f"{document['ratios'][name]:.2f}", *lossy])
    title = f"{document['map']}: {document['width']} x {document['height']} cells of {document['resolution_m']} m"
    print_table(title, ["codec", "bytes", "x below gzip -9", "MS %", "CC %", "PC %", "OPDF %", "UPDF %"], rows)


def _run_stats(folder: Path) -> dict[str, Any]:
    import json

    path = folder / "stats.json"
    try:
        document = json.loads(path.read_text())
    except FileNotFoundError:
        raise MapFormatError(
            path=path, field="file", reason="missing: expected a run folder of `fleetmap sim`"
        ) from None
    except ValueError as error:
        raise MapFormatError(path=path, field="file", reason=f"no JSON: {error}") from None
    keys = ("bytes_vector", "bytes_deltas", "bytes_grid_gzip_full", "bytes_grid_gzip_updates", "per_robot")
    for key in keys:
        if not isinstance(document, dict) or key not in document:
            raise MapFormatError(path=path, field=key, reason="missing: expected the stats of `fleetmap sim`")
    codecs = {key.removeprefix("bytes_"): document[key] for key in keys if key.startswith("bytes_")}
    ratios = {name: size / codecs["vector"] for name, size in codecs.items()} if codecs["vector"] else {}
    return {**document, "codecs": codecs, "ratios": ratios}


def _print_run(document: dict[str, Any]) -> None:
    rows = [
        [name.replace("_", " "), f"{size:,}", f"{document['ratios'].get(name, 0.0):.2f}"]
        for name, size in document["codecs"].items()
    ]
    print_table("the run, all robots", ["", "bytes", "times what fleetmap sent"], rows)
    robots = document["per_robot"]
    if robots:
        columns = sorted({kind for robot in robots for kind in robot.get("sent", {})})
        print_table(
            "bytes sent, by robot and kind",
            ["robot", *columns],
            [[str(r.get("robot")), *(f"{r.get('sent', {}).get(c, 0):,}" for c in columns)] for r in robots],
        )
