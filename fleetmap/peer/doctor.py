"""What is wrong with a fleet's network, seen from a computer that is in none: ``fleetmap doctor``."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

from fleetmap.peer.health import Problem, behind_router, other_version, unreachable
from fleetmap.peer.probe import Visit, why_not
from fleetmap.peer.watcher import Seen, Watcher

LOOK_S = 0.5


@dataclass(frozen=True, slots=True)
class Findings:
    """What was found.

    Parameters
    ----------
    links : endpoints that this computer was linked to
    robots : of the fleet, by name
    other_fleets : that have robots there
    problems : by kind and whom they are about; also what robots tell of themselves
    """

    links: tuple[str, ...]
    robots: tuple[Seen, ...]
    other_fleets: tuple[str, ...]
    problems: tuple[Problem, ...]


async def examine(
    fleet: str,
    *,
    profile: str,
    connect: Sequence[str] = (),
    listen: Sequence[str] = (),
    config: Mapping[str, object] | None = None,
    for_s: float = 4.0,
) -> Findings:
    """Join nothing, look for so many seconds, and ask the robots what they find wrong.

    Raises
    ------
    ConfigError : an option has an impossible value
    LinkError : the transport could not be opened
    """
    seen: list[Seen] = []
    async with Watcher(fleet, profile=profile, connect=connect, listen=listen, config=config) as watcher:
        until_s = asyncio.get_running_loop().time() + for_s
        while True:
            seen = await watcher.look()
            if asyncio.get_running_loop().time() >= until_s:
                break
            await asyncio.sleep(LOOK_S)
        links, routers = await watcher.links()
        _, fleets = await watcher.surroundings()
        found = [problem for robot in seen for problem in _of_robot(robot)]
        others = [endpoint for endpoint in watcher.dialled if endpoint not in links]
        reasons = await asyncio.gather(*(asyncio.to_thread(why_not, e, watcher.settings) for e in others))
        # Robots that are linked the other way round leave no link of this end.
        found += [unreachable(e, why) for e, why in zip(others, reasons, strict=True) if why is not None or not links]
        if links and routers:
            found += await asyncio.to_thread(partial(_behind_router, watcher, {robot.robot for robot in seen}))
        other_fleets = tuple(name for name in fleets if name != fleet)
        if not seen and (links or not watcher.dialled) and not found:
            found.append(Problem("nobody", fleet, _nobody(fleet, watcher, links, other_fleets)))
    return Findings(
        tuple(links), tuple(seen), other_fleets, tuple(sorted(found, key=lambda p: (p.kind, p.robot, p.text)))
    )


def _of_robot(seen: Seen) -> list[Problem]:
    if seen.version is not None:
        return [other_version(seen.robot, seen.version)]
    found = []
    if seen.lives > 1:
        text = f"{seen.lives} living peers are named {seen.robot}: give each robot a name of its own, or end the others"
        found.append(Problem("namesake", seen.robot, text))
    if seen.figures is None:
        text = f"{seen.robot} shows that it lives, and doesn't answer: it is hung or very busy, or its way back is cut"
        found.append(Problem("mute", seen.robot, text))
    else:
        found += [Problem("told", seen.robot, f"{seen.robot} tells: {text}") for text in seen.figures.problems]
    return found


def _behind_router(watcher: Watcher, seen: set[str]) -> list[Problem]:
    heard: set[str] = set()
    for endpoint in watcher.dialled:
        with Visit(endpoint, watcher.settings) as visit:
            heard |= visit.robots(f"fleetmap/{watcher.fleet}")
    unheard = sorted(heard - seen)
    return [behind_router(unheard)] if unheard else []


def _nobody(fleet: str, watcher: Watcher, links: Sequence[str], others: Sequence[str]) -> str:
    if others:
        return f"no robot of fleet {fleet!r} there, but robots of {', '.join(others)}: name one of these with --fleet"
    if links:
        return f"{', '.join(links)} answers, and no robot of fleet {fleet!r} is linked to it: start one"
    return (
        "nobody answers by multicast: start a robot, see that all are in one network, which may keep multicast back, "
        "or give --connect an endpoint where a robot listens, as tcp/10.0.0.2:7447"
    )
