"""``fleetmap stats``: what vector maps cost, beside what grids would have cost."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from fleetmap.accounting.wire import required_bandwidth_kbps
from fleetmap.cli.output import AsJson, print_json, print_table, progress, stderr
from fleetmap.model.errors import ConfigError, MapFormatError


def stats(
    inputs: Annotated[
        list[Path] | None,
        typer.Argument(metavar="MAP.yaml... | BAG... | RUN", help="map_server maps, bags, or one run folder of `sim`."),
    ] = None,
    fleet: Annotated[str | None, typer.Option(metavar="NAME", help="Watch this fleet, without being in it.")] = None,
    connect: Annotated[
        list[str] | None, typer.Option(metavar="ENDPOINT", help="With --fleet: as tcp/10.0.0.2:7447.")
    ] = None,
    listen: Annotated[
        list[str] | None, typer.Option(metavar="ENDPOINT", help="With --fleet: where others may connect.")
    ] = None,
    no_multicast_scouting: Annotated[
        bool, typer.Option("--no-multicast-scouting", help="With --fleet: find peers by --connect alone.")
    ] = False,
    for_s: Annotated[
        float | None, typer.Option("--for-s", min=0.0, metavar="S", help="With --fleet: so long; else until Ctrl-C.")
    ] = None,
    topic: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Of a bag: this topic of grids; else all of them.")
    ] = None,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Of a bag: write report.html here.")] = None,
    free_below: Annotated[float | None, typer.Option(metavar="PERCENT", help="Of a bag: cells below are free.")] = None,
    occupied_above: Annotated[
        float | None, typer.Option(metavar="PERCENT", help="Of a bag: cells above are occupied.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compare the size of vector maps with that of compressed grids: of maps, bags, a finished run, or a live fleet.

    For maps: bytes of each codec, how many times less that is than gzip -9 of the grid, and than the best
    grid codec for the same content: of a lossy row, for the grid that is drawn of it. Vector rows are lossy,
    so epsilon in cells and the paper's metrics against the grid stand beside them. `vector` drops free and
    unknown specks of at most 12 cells, `vector_specks` keeps them, `vector_full` has all three boundaries;
    the rows behind `vector` are the lines of that map in other formats. Times are CPU time.

    For instance:  fleetmap stats maps/*.yaml

    For bags (a folder of ros2 bag, .mcap, .db3, or .bag of ROS 1): what each topic of nav_msgs/OccupancyGrid and its
    `_updates` took, and what the same maps would have taken as vectors, as whole gzipped grids and as gzipped
    rectangles, over time; `--out` draws it.

    For instance:  fleetmap stats rosbag2_2026_03_01-10_00_00 --out judged

    For a run: what all robots sent, and what grids would have cost at the same publishes, to one receiver: as
    payload, and on an IP link, where all sides carry poses, goals, heartbeats and keep-alives, too. kbps is the
    paper's required bandwidth, size / time, with the simulated time.

    or, after a simulation:  fleetmap stats RUN --json

    With --fleet: asks each robot what it has counted since it joined, and shows it, until Ctrl-C. The watcher is no
    robot and takes no map; its questions and their answers are counted apart. Ends with 1 if it reached nobody.

    For instance:  fleetmap stats --fleet sim --connect tcp/127.0.0.1:7447
    """
    if (fleet is None) == (not inputs):
        reason = "expected maps, a run folder, or --fleet NAME" if fleet is None else "goes without maps or a run"
        raise ConfigError(option="fleet", value=fleet, reason=reason)
    if fleet is not None:
        _watch(fleet, connect or [], listen or [], "local" if no_multicast_scouting else "lan", for_s, as_json)
        return
    if any(value is not None for value in (connect, listen, for_s)) or no_multicast_scouting:
        raise ConfigError(option="fleet", value=fleet, reason="--connect, --listen and --for-s go with --fleet")
    assert inputs is not None
    from fleetmap.bridges.bags import is_bag

    bags = [path for path in inputs if is_bag(path)]
    if bags:
        if len(bags) < len(inputs):
            raise ConfigError(option="inputs", value=str(inputs[0]), reason="bags go without maps and runs")
        if out is not None and len(bags) > 1:
            raise ConfigError(option="out", value=str(out), reason="is for one bag")
        _bags(bags, topic or [], out, free_below, occupied_above, as_json)
        return
    if any(value is not None for value in (topic, out, free_below, occupied_above)):
        reason = "--topic, --out, --free-below and --occupied-above go with bags"
        raise ConfigError(option="topic", value=topic, reason=reason)
    if len(inputs) == 1 and inputs[0].is_dir():
        document = _run_stats(inputs[0])
        if as_json:
            print_json(document)
        else:
            _print_run(document)
        return
    from fleetmap.cli.map_stats import measure_map
    from fleetmap.cli.maps import read_map_server
    from fleetmap.model.kernel_cache import modules_of
    from fleetmap.model.kernel_compiler import compile_ahead

    compile_ahead(modules_of("model", "vectorize", "codecs"))
    documents = []
    for path in inputs:
        grid = read_map_server(path)
        with progress(str(path)) as tell:
            document = measure_map(path, grid, tell)
        documents.append(document)
        if not as_json:
            _print_map(document)
    medians, same = _medians(documents, "ratios"), _medians(documents, "ratios_same_content")
    if as_json:
        print_json({"maps": documents, "median_ratios": medians, "median_ratios_same_content": same})
    elif len(documents) > 1:
        rows = [[name, f"{ratio:.2f}", f"{same[name]:.2f}"] for name, ratio in medians.items()]
        print_table(f"median of {len(documents)} maps", ["codec", "x below gzip -9", "x below best grid"], rows)


def _bags(
    bags: list[Path],
    topics: list[str],
    out: Path | None,
    free_below: float | None,
    occupied_above: float | None,
    as_json: bool,
) -> None:
    from fleetmap.bridges.bag_stats import Thresholds
    from fleetmap.cli.bag_stats import bag_document, print_bag

    documents = []
    for path in bags:
        thresholds = Thresholds(free_below, occupied_above)
        documents.append(bag_document(path, topics=topics, thresholds=thresholds, out=out))
        if not as_json:
            print_bag(documents[-1])
            if out is not None:
                typer.echo(f"report: {documents[-1]['report']}")
    if as_json:
        print_json({"bags": documents})


def _watch(fleet: str, connect: list[str], listen: list[str], profile: str, for_s: float | None, as_json: bool) -> None:
    import asyncio

    from rich.console import Console

    from fleetmap.cli.fleet_stats import as_table, watch_fleet

    live = not as_json and stderr.is_terminal
    watching = watch_fleet(fleet, connect=connect, listen=listen, profile=profile, for_s=for_s, live=live)
    document = asyncio.run(watching)
    if as_json:
        print_json(document)
    else:
        console = Console()
        console = console if console.is_terminal else Console(width=160)
        console.print(as_table(document))


def _medians(documents: list[dict[str, Any]], key: str) -> dict[str, float]:
    """Over the maps, for the codecs that ran on all of them."""
    import statistics

    names = [name for name in documents[0][key] if all(name in d[key] for d in documents)] if documents else []
    return {name: statistics.median(d[key][name] for d in documents) for name in names}


def _print_map(document: dict[str, Any]) -> None:
    from fleetmap.cli.map_stats import METRICS

    rows = []
    for row in document["rows"]:
        name, metrics = row["codec"], row["metrics"]
        lost = [f"{metrics[m]:.2f}" for m in METRICS] if metrics else [""] * 5
        rows.append(
            [
                name,
                row["holds"],
                f"{row['size_bytes']:,}",
                f"{document['ratios'][name]:.2f}",
                f"{document['ratios_same_content'][name]:.2f}",
                f"{row['encode_ms']:.1f}" if row["encode_ms"] else "",
                f"{row['decode_ms']:.1f}" if row["decode_ms"] else "",
                f"{row['epsilon_cells']:.3f}" if metrics else "exact",
                *lost,
            ]
        )
    title = f"{document['map']}: {document['width']} x {document['height']} cells of {document['resolution_m']} m"
    columns = ["codec", "holds", "bytes", "x below gzip -9", "x below best grid", "enc ms", "dec ms", "epsilon"]
    print_table(title, [*columns, *(f"{metric} %" for metric in METRICS)], rows)
    if document["unavailable"]:
        names, extras = ", ".join(document["unavailable"]), sorted(set(document["unavailable"].values()))
        stderr.print(f"not there: {names}; pip install '{extras[0]}'", markup=False)


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
    codecs = {name: document[f"bytes_{name}"] for name in NAMES if f"bytes_{name}" in document}
    ratios = {name: size / codecs["vector"] for name, size in codecs.items()} if codecs["vector"] else {}
    time_s = document.get("simulated_s", 0.0)
    kbps = {name: required_bandwidth_kbps(size, time_s) for name, size in codecs.items()}
    wire = {name: document[f"wire_bytes_{name}"] for name in NAMES if f"wire_bytes_{name}" in document}
    wire_ratios = {name: size / wire["vector"] for name, size in wire.items()} if wire.get("vector") else {}
    return {
        **document,
        "codecs": codecs,
        "ratios": ratios,
        "required_bandwidth_kbps": kbps,
        "wire_codecs": wire,
        "wire_ratios": wire_ratios,
        "wire_bytes": {str(robot.get("robot")): robot.get("wire_bytes_vector") for robot in document["per_robot"]},
    }


def _print_run(document: dict[str, Any]) -> None:
    kbps, wire, wire_ratios = (document[key] for key in ("required_bandwidth_kbps", "wire_codecs", "wire_ratios"))
    rows = [
        [
            NAMES[name],
            f"{size:,}",
            f"{document['ratios'].get(name, 0.0):.2f}",
            "" if kbps[name] is None else f"{kbps[name]:.2f}",
            f"{wire[name]:,}" if name in wire else "",
            f"{wire_ratios[name]:.2f}" if name in wire_ratios else "",
        ]
        for name, size in document["codecs"].items()
    ]
    columns = ["", "payload bytes", "times what fleetmap sent", "kbps", "bytes on the wire", "times"]
    print_table("the run, all robots, to one receiver", columns, rows)
    per = [(key, document.get(key), document.get(f"wire_{key}")) for key in ("bytes_per_m2", "bytes_per_s_robot")]
    known = [[PER[key], f"{payload:.2f}", f"{on_wire:.2f}"] for key, payload, on_wire in per if payload and on_wire]
    if known:
        print_table("what fleetmap took", ["bytes", "payload", "on the wire"], known)
    robots = document["per_robot"]
    if robots:
        kinds = sorted({kind for robot in robots for kind in robot.get("sent", {})})
        table = []
        for robot in robots:
            sent, name = robot.get("sent", {}), str(robot.get("robot"))
            sizes = [f"{sent.get(kind, 0):,}" for kind in kinds]
            on_wire = document["wire_bytes"][name]
            table.append([name, *sizes, f"{sum(sent.values()):,}", "" if on_wire is None else f"{on_wire:,}"])
        title = "bytes sent, by robot and kind: payloads, and with Zenoh, TCP, IP, acknowledgements and keep-alives"
        print_table(title, ["robot", *kinds, "payload", "wire (est.)"], table)


PER = {"bytes_per_m2": "per m² of floor explored", "bytes_per_s_robot": "per second and robot"}
NAMES = {
    "vector": "fleetmap, all it sent",
    "deltas": "of it deltas",
    "grid_gzip_full": "whole grids, gzip -6",
    "grid_gzip_updates": "changed rectangles, gzip -6",
    "grid_exact_updates": "differences, exact layer",
}
