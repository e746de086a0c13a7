"""``run_fleet``: a simulated fleet from the first process to the report."""

from __future__ import annotations

import asyncio
import secrets
import tempfile
import time
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import AbstractAsyncContextManager, asynccontextmanager, nullcontext
from dataclasses import asdict, fields, replace
from pathlib import Path

import numpy as np

from fleetmap.model.errors import ConfigError, LinkError
from fleetmap.model.kernel_cache import AGENT, modules_of
from fleetmap.model.kernel_compiler import compile_in_thread
from fleetmap.peer.rendezvous import PORT, Meeting, rendezvous
from fleetmap.sims.config import Progress, RobotProgress, SimConfig, SimResult
from fleetmap.sims.crew import Crew
from fleetmap.sims.outcome import write_outcome
from fleetmap.sims.run import Run
from fleetmap.sims.worlds import choose_starts, make_world

KERNELS = (*AGENT, "sims")
"""Groups of kernels that the robots and the report need."""

FLEET = "sim"
"""Name of the fleet at the usual endpoint: with that, all that another robot needs to join."""

ROUND_S = 3.0
"""Simulated time that is granted at once: about one publish of each robot."""

STARTUP_S = 120.0
"""Until all processes have loaded their libraries and joined."""

REPEAT_S = 4.0
"""Progress is told at least this often, so that nobody takes a slow phase for the end."""

SAMPLES = 4000
"""Reachable cells that the progress figure ``covered`` looks at."""

CONVERGE_S = 60.0
IDLE_ROUNDS = 2
"""The fleet is done when no robot has had anything to do for so many rounds."""

NOTHING: Callable[[Progress], None] = lambda _: None  # noqa: E731 - a default that does nothing


Beside = Callable[[str, str], AbstractAsyncContextManager[object]]
"""Of a fleet's name and its endpoint: what goes on beside it, as a recorder."""


def run_fleet(
    config: SimConfig, on_progress: Callable[[Progress], None] = NOTHING, *, beside: Beside | None = None
) -> SimResult:
    """Run a simulated fleet and leave the run folder ``config.out``.

    Parameters
    ----------
    on_progress : called after each round, when the phase changes, and each 4 s
    beside : entered when the robots have started, and left before they end

    Raises
    ------
    ConfigError, MapFormatError : the world can't be had, or would be overwritten
    LinkError : the fleet has no place to meet, or no robot process came up
    KeyboardInterrupt : after all processes have ended
    """
    return asyncio.run(_run(config, on_progress, beside or (lambda fleet, endpoint: nullcontext())))


def _keep_world(config: SimConfig) -> None:
    """Refuse a run folder that is none, or in which ``map.yaml`` and its image would replace the world's map."""
    world = Path(config.world)
    if world.is_file() and world.resolve().parent == config.out.resolve():
        raise ConfigError(option="out", value=str(config.out), reason="holds the world's map; expected another folder")
    if config.out.exists() and not config.out.is_dir():
        raise ConfigError(option="out", value=str(config.out), reason="is a file; expected a folder, or a new name")


def name_fleet(config: SimConfig, meeting: Meeting) -> str:
    """The fleet's name: two runs of one name would be one fleet to whoever joins, so the second has another.

    ``meeting`` : where it meets; one at an endpoint that was asked for is told from others by that
    """
    if config.fleet is not None:
        return config.fleet
    return FLEET if meeting.usual or config.listen is not None else f"{FLEET}-{secrets.token_hex(2)}"


def _listen(config: SimConfig) -> str | None:
    """Where the fleet meets. One that has a name stays at the usual place, where whoever named it looks for it."""
    usual = f"tcp/127.0.0.1:{PORT}"
    return usual if config.listen is None and config.fleet is not None else config.listen


async def _run(config: SimConfig, on_progress: Callable[[Progress], None], beside: Beside) -> SimResult:
    began_s = time.monotonic()
    _keep_world(config)
    world = make_world(config.world, size_m=config.size_m, seed=config.seed)
    rng = np.random.default_rng([config.seed, 1])
    together = config.starts == "known"
    starts = choose_starts(world, config.robots, radius_m=config.radius_m, rng=rng, together=together)
    run = Run(config, world, starts, world.reachable(starts, radius_m=config.radius_m))
    (config.out / "logs").mkdir(parents=True, exist_ok=True)
    # If this run is interrupted, figures and logs of an earlier one must not pass for its own.
    for left in (config.out / "stats.json", config.out / "report.html", *(config.out / "logs").glob("r*.log")):
        left.unlink(missing_ok=True)
    # Compiled once here, and loaded from the cache by the robots.
    await compile_in_thread(modules_of(*KERNELS))

    phase = "starting"

    def tell(now: str) -> None:
        nonlocal phase
        phase = now
        t_s = max((p.t_s for p in run.latest.values()), default=0.0)
        on_progress(Progress(phase, t_s, run.endpoint, tuple(run.latest.values()), run.fleet))

    async def repeat() -> None:
        while True:
            await asyncio.sleep(REPEAT_S)
            tell(phase)

    with tempfile.TemporaryDirectory(prefix="fleetmap-sim-") as scratch:
        async with rendezvous(_listen(config)) as meeting, Crew(config.silent_s) as crew, _beside(repeat()):
            run.endpoint = meeting.endpoint
            run.fleet = name_fleet(config, meeting)
            tell("starting")
            await _start(run, crew, Path(scratch), meeting)
            async with beside(run.fleet, meeting.connect):
                tell("exploring")
                await _explore(run, crew, tell)
                tell("converging")
                await _converge(run, crew)
            run.duration_s = time.monotonic() - began_s
            folder = Path(scratch)
            written = await crew.ask(lambda member: {"write": str(folder / f"{member.robot}.fmap")})
            run.stats = {robot: dict(a["stats"]) for robot, a in written.items()}  # type: ignore[call-overload]
            run.maps = {robot: folder / f"{robot}.fmap" for robot in written}
            run.frames = {robot: str(a["frame"]) for robot, a in written.items() if a["frame"] is not None}
            tell("reporting")
            document = await asyncio.to_thread(write_outcome, run, crew.deaths)
            if config.hold_s > 0:
                tell("holding")
                await asyncio.sleep(config.hold_s)
    return SimResult(config.out, document)


@asynccontextmanager
async def _beside(work: Coroutine[object, object, None]) -> AsyncIterator[None]:
    """Run ``work`` until the block ends."""
    task = asyncio.create_task(work)
    try:
        yield
    finally:
        task.cancel()


async def _start(run: Run, crew: Crew, scratch: Path, meeting: Meeting) -> None:
    """Write the world for the robots to move in, and start them all."""
    config, world = run.config, run.world
    cells = np.argwhere(run.reachable)
    sample = np.random.default_rng(0).choice(len(cells), min(SAMPLES, len(cells)), replace=False)
    origin = world.origin
    np.savez(
        scratch / "world.npz",
        solid=world.solid,
        resolution_m=world.resolution_m,
        origin=[origin.x_m, origin.y_m, origin.yaw_rad],
        sample_xy=world.centres_xy(cells[sample]),
    )
    made = asdict(config)
    make = {key: made[key] for key in ("seed", "range_m", "beams", "range_noise_m", "pose_noise_m", "radius_m")}
    for index, start in enumerate(run.starts):
        robot = f"r{index}"
        order = {
            **make,
            "robot": robot,
            "index": index,
            "speed_mps": config.speed_mps,
            "world": str(scratch / "world.npz"),
            "start": [start.x_m, start.y_m, start.yaw_rad],
            "known": config.starts == "known",
            "fleet": run.fleet,
            "endpoint": meeting.connect,
            "listen": meeting.robots_listen,
        }
        await crew.start(robot, order, log=config.out / "logs" / f"{robot}.log")
    for member in crew.members:
        run.latest[member.robot] = RobotProgress(member.robot, member.process.pid)
    await crew.ask(None, timeout_s=STARTUP_S)
    if not crew.living:
        reasons = "; ".join(f"{death.robot} {death.reason}" for death in crew.deaths)
        raise LinkError(endpoint=run.endpoint, reason=f"no robot process came up: {reasons} ({config.out / 'logs'})")


async def _explore(run: Run, crew: Crew, tell: Callable[[str], None]) -> None:
    """Grant rounds until nobody has anything left to do."""
    idle_rounds = 0
    names = {f.name for f in fields(RobotProgress)}
    while crew.living and crew.t_s < run.config.limit_s:
        crew.t_s += ROUND_S
        answers = await crew.ask({"go": crew.t_s})
        for robot, answer in answers.items():
            run.latest[robot] = RobotProgress(**{k: v for k, v in answer.items() if k in names})  # type: ignore[arg-type]
        for death in crew.deaths:
            run.latest[death.robot] = replace(run.latest[death.robot], state="dead")
        run.series.append(dict(run.latest))
        tell("exploring")
        busy = any(run.latest[robot].state == "exploring" for robot in answers)
        idle_rounds = 0 if busy else idle_rounds + 1
        if idle_rounds >= IDLE_ROUNDS:
            run.finished = True
            return


async def _converge(run: Run, crew: Crew) -> None:
    """Let the last deltas go out, then wait until all living peers hold the same revisions."""
    await crew.ask({"settle": True})
    until_s = time.monotonic() + CONVERGE_S
    while crew.living and not run.converged and time.monotonic() < until_s:
        run.sync = await crew.ask({"sync": 5.0})
        held = {(str(answer["digest"]), str(answer["revisions"])) for answer in run.sync.values()}
        run.converged = len(held) == 1 and all(answer["digest"] for answer in run.sync.values())
