"""``fleetmap sim``: N robot processes explore a building and end up with one map."""

from __future__ import annotations

import time
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.live import Live
from rich.table import Table

from fleetmap.cli.output import AsJson, print_json, print_table, stderr

if TYPE_CHECKING:
    from fleetmap.sims import Progress, SimConfig
    from fleetmap.sims.fleet import Beside


USUAL = "tcp/127.0.0.1:7447"
"""Where a fleet meets that was told no place."""

EACH_S = 5.0
"""A pipe gets a line this often: progress comes a few times in it, and 10 s without a word are long."""


def sim(
    robots: Annotated[int, typer.Option(min=1, max=50, help="How many robots, each a process of its own.")] = 4,
    world: Annotated[
        str, typer.Option(metavar="NAME|MAP.yaml", help="office, maze, unstructured, or a map_server map.")
    ] = "office",
    size: Annotated[float, typer.Option(min=5.0, max=200.0, help="Side of a generated world, metres.")] = 40.0,
    starts: Annotated[
        str,
        typer.Option(
            metavar="known|unknown",
            help="unknown: they start anywhere, turned anyhow, and must find where the others are.",
        ),
    ] = "known",
    seed: Annotated[int, typer.Option(min=0, help="Of the world, the starts and all noise.")] = 0,
    out: Annotated[Path, typer.Option("--out", metavar="RUN", help="The run folder.")] = Path("RUN"),
    fleet: Annotated[
        str | None, typer.Option(metavar="NAME", help="Of the fleet: sim, unless another run has that place already.")
    ] = None,
    listen: Annotated[
        str | None,
        typer.Option(metavar="ENDPOINT", help="Where others may connect: tcp/127.0.0.1:7447; port 0 for a free one."),
    ] = None,
    hold_s: Annotated[
        float, typer.Option("--hold-s", min=0.0, help="Stay joined so long after the end, for others to join.")
    ] = 0.0,
    lidar_range: Annotated[float, typer.Option(min=1.0, max=100.0, help="Range of the lidar, metres.")] = 10.0,
    beams: Annotated[int, typer.Option(min=90, max=7200, help="Beams of the lidar, over 360 degrees.")] = 720,
    range_noise: Annotated[float, typer.Option(min=0.0, max=0.5, help="Sigma of a range, metres.")] = 0.02,
    pose_noise: Annotated[float, typer.Option(min=0.0, max=0.5, help="Sigma of the believed pose, metres.")] = 0.01,
    radius: Annotated[float, typer.Option(min=0.05, max=2.0, help="Radius of a robot, metres.")] = 0.20,
    record: Annotated[
        Path | None, typer.Option(metavar="FILE.mcap", help="Record the run, as `fleetmap record` does.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Launch a simulated fleet: robots explore, vectorize what they see, send deltas, and merge.

    Ends by itself when nothing reachable is left to explore and all robots hold the same map. Leaves the run
    folder: report.html, map.png, map.yaml, map.fmap, stats.json and a log per robot. Ctrl-C ends all of it.
    Exits with 1 if the living robots don't hold the same map in the end.

    Others join or watch by the fleet's name and its endpoint, which stand in the progress. Where another run has
    the usual endpoint already, this one takes a free port and a name of its own; if it was told a name or a taken
    endpoint, it ends with an error instead.

    For instance:  fleetmap sim --robots 4 --world office --size 40 --seed 1 --out RUN

    or, without telling them where they are:  fleetmap sim --starts unknown

    or on a real map, and waiting for guests:  fleetmap sim --world map.yaml --hold-s 30
    """
    from fleetmap.model.kernel_cache import modules_of
    from fleetmap.model.kernel_compiler import compile_ahead
    from fleetmap.sims import SimConfig, run_fleet
    from fleetmap.sims.fleet import KERNELS

    config = SimConfig(
        out=out,
        robots=robots,
        world=world,
        size_m=size,
        starts=starts,
        seed=seed,
        hold_s=hold_s,
        fleet=fleet,
        listen=listen,
        range_m=lidar_range,
        beams=beams,
        range_noise_m=range_noise,
        pose_noise_m=pose_noise,
        radius_m=radius,
    )
    unrecorded: list[OSError] = []
    beside = None if record is None else _recording(record, unrecorded)
    compile_ahead(modules_of(*KERNELS))
    if stderr.is_terminal:
        with Live(console=stderr, refresh_per_second=4, transient=True) as live:
            result = run_fleet(
                config, _telling(config, lambda progress: live.update(_progress_table(progress))), beside=beside
            )
    else:
        result = run_fleet(config, _telling(config, _PlainProgress()), beside=beside)
    document = result.document
    if as_json:
        print_json(document)
    else:
        _print_summary(document, result.out)
    for error in unrecorded:
        stderr.print(f"the recording is cut off: {error}", markup=False, highlight=False, soft_wrap=True)
    if unrecorded or not document["converged"]:
        raise typer.Exit(1)


def _recording(path: Path, unrecorded: list[OSError]) -> Beside:
    """What writes the run into an MCAP file; what is in the way of that costs the recording, and not the run."""
    from fleetmap.bridges.mcap_file import check_out
    from fleetmap.bridges.recording import recording

    check_out(path)

    @asynccontextmanager
    async def beside(fleet: str, endpoint: str) -> AsyncIterator[None]:
        async with AsyncExitStack() as stack:
            await stack.enter_async_context(recording(path, fleet=fleet, connect=[endpoint], profile="local"))
            yield
            try:
                await stack.aclose()
            except OSError as error:  # the disk is full
                unrecorded.append(error)

    return beside


def _telling(config: SimConfig, show: Callable[[Progress], None]) -> Callable[[Progress], None]:
    """As ``show``; says first if the fleet has another name and place than the usual ones, unasked."""
    told = config.fleet is not None or config.listen is not None

    def on_progress(progress: Progress) -> None:
        nonlocal told
        if not told and progress.endpoint != USUAL:
            stderr.print(
                f"{USUAL} is another's, perhaps another run's: this fleet is {progress.fleet} at {progress.endpoint}",
                markup=False,
                highlight=False,
                soft_wrap=True,
            )
        told = True
        show(progress)

    return on_progress


def _progress_table(progress: Progress) -> Table:
    table = Table(
        title=f"{progress.phase}, {progress.t_s:.0f} s of simulated time, fleet {progress.fleet} at {progress.endpoint}"
    )
    for column in ("robot", "pid", "state", "covered", "driven", "published", "sent", "gzip full", "gzip updates"):
        table.add_column(column, justify="left" if column in ("robot", "state") else "right")
    for r in progress.robots:
        table.add_row(
            r.robot,
            str(r.pid),
            r.state,
            f"{100 * r.covered:.1f} %",
            f"{r.distance_m:.0f} m",
            str(r.published),
            f"{r.bytes_vector:,} B",
            f"{r.bytes_grid_gzip_full:,} B",
            f"{r.bytes_grid_gzip_updates:,} B",
        )
    return table


class _PlainProgress:
    """A line on stderr at each change of phase or tenth of the way, and each 5 s: for logs and pipes."""

    def __init__(self) -> None:
        self._said: object = None
        self._said_s = 0.0

    def __call__(self, progress: Progress) -> None:
        covered = max((r.covered for r in progress.robots), default=0.0)
        now, now_s = (progress.phase, int(covered * 10)), time.monotonic()
        if now != self._said or now_s - self._said_s >= EACH_S:
            self._said, self._said_s = now, now_s
            robots = " ".join(f"{r.robot}[{r.pid}]:{r.state}" for r in progress.robots)
            stderr.print(
                f"{progress.phase}: t={progress.t_s:.0f} s, covered {100 * covered:.0f} %, "
                f"{robots + ', ' if robots else ''}fleet {progress.fleet} at {progress.endpoint}",
                highlight=False,
                soft_wrap=True,
            )


def _print_summary(document: dict[str, object], out: Path) -> None:
    error = document["merged_error_m"]
    rows = []
    for key, value in document.items():
        if key == "merged_error_m" and isinstance(error, dict):
            median, p95 = error["median"], error["p95"]
            rows.append(["merged error", f"median {100 * median:.1f} cm, p95 {100 * p95:.1f} cm"])
        elif key == "covered" and isinstance(value, float):
            rows.append(["covered", f"{100 * value:.1f} %"])
        elif key.startswith("ratio_") and isinstance(value, float):
            rows.append([key.replace("_", " "), f"{value:.1f} x"])
        elif isinstance(value, bool):
            rows.append([key, "yes" if value else "no"])
        elif isinstance(value, float):
            rows.append([key.replace("_", " "), f"{value:,.1f}"])
        elif isinstance(value, int):
            rows.append([key.replace("_", " "), f"{value:,}"])
        elif isinstance(value, str):
            rows.append([key.replace("_", " "), value])
    print_table("the run", ["", "result"], rows)
    dead = document.get("dead")
    for death in dead if isinstance(dead, list) else []:
        typer.echo(f"{death['robot']} died at {death['t_s']:.0f} s of simulated time: {death['reason']}")
    typer.echo(f"report: {out / 'report.html'}")
