"""``fleetmap record``: a living fleet into an MCAP file."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fleetmap.cli.joining import Config, Connect, Listen, NoMulticast, profile, settings
from fleetmap.cli.output import AsJson, print_json, progress, stderr

if TYPE_CHECKING:
    from fleetmap.bridges.recorder import Recorder


def record(
    out: Annotated[Path, typer.Argument(metavar="OUT.mcap", help="A file of that name is replaced.")],
    fleet: Annotated[str, typer.Option(metavar="NAME", help="The fleet to record.")] = "default",
    level: Annotated[str, typer.Option(metavar="NAME", help="Its storey.")] = "0",
    robot: Annotated[str, typer.Option(metavar="NAME", help="The recorder's own name; else a free one.")] = "",
    connect: Connect = None,
    listen: Listen = None,
    no_multicast_scouting: NoMulticast = False,
    config: Config = None,
    for_s: Annotated[
        float | None, typer.Option("--for-s", min=0.0, metavar="S", help="So long; else until Ctrl-C.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Record a fleet: its merged map, where its robots are, what they say, and what that takes. Until Ctrl-C.

    The file is MCAP: `ros2 bag`, Foxglove, Lichtblick and Rerun open it. It has /map, /fleet_walls and /tf, and as JSON
    in std_msgs/String /fleetmap/records and /fleetmap/bytes. `fleetmap play` makes the same fleet of it again. The
    recorder is a peer without a map: it costs each robot a link.

    For instance:  fleetmap record RUN.mcap --fleet sim --connect tcp/127.0.0.1:7447
    """
    document = asyncio.run(
        _record(out, robot, fleet, level, connect or [], listen or [], profile(no_multicast_scouting), config, for_s)
    )
    if as_json:
        print_json(document)
    else:
        robots = ", ".join(document["robots"])
        if robots:
            typer.echo(f"{out}: {document['records']} records of {robots}, {document['file_bytes']:,} B")
    if not document["robots"]:
        stderr.print(
            "nobody has a map there, so that no file was left: `fleetmap doctor` says why",
            markup=False,
            highlight=False,
        )
        raise typer.Exit(1)


async def _record(
    out: Path,
    robot: str,
    fleet: str,
    level: str,
    connect: list[str],
    listen: list[str],
    found_by: str,
    config: Path | None,
    for_s: float | None,
) -> dict[str, Any]:
    from fleetmap.bridges.recording import recording

    began_s = time.monotonic()
    joined = {"fleet": fleet, "connect": connect, "listen": listen, "profile": found_by, "config": settings(config)}
    with progress(f"recording {fleet}") as tell:
        async with recording(out, robot=robot, level=level, **joined) as recorder:  # type: ignore[arg-type]
            try:
                while recorder.failure is None and (for_s is None or time.monotonic() - began_s < for_s):
                    tell(f"{recorder.records} records of {len(recorder.robots)} robots")
                    left_s = 1.0 if for_s is None else for_s - (time.monotonic() - began_s)
                    await asyncio.sleep(max(0.0, min(1.0, left_s)))
            except asyncio.CancelledError:
                pass  # Ctrl-C: what was recorded is what is wanted
    return as_document(recorder, out, time.monotonic() - began_s)


def as_document(recorder: Recorder, out: Path, time_s: float) -> dict[str, Any]:
    """The document of `fleetmap record --json`."""
    return {
        "out": str(out),
        "time_s": round(time_s, 2),
        "robots": sorted(recorder.robots),
        "records": recorder.records,
        "record_bytes": recorder.size_bytes,
        "file_bytes": out.stat().st_size if recorder.records else 0,
        "digest": recorder.digest,
    }
