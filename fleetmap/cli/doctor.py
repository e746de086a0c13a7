"""``fleetmap doctor``: finds no peers? says why."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from fleetmap.cli.joining import Config, Connect, Listen, NoMulticast, profile, settings
from fleetmap.cli.output import AsJson, print_json, progress


def doctor(
    fleet: Annotated[str, typer.Option(metavar="NAME", help="The fleet to look for.")] = "default",
    connect: Connect = None,
    listen: Listen = None,
    no_multicast_scouting: NoMulticast = False,
    config: Config = None,
    for_s: Annotated[float, typer.Option("--for-s", min=0.0, metavar="S", help="How long to look.")] = 4.0,
    as_json: AsJson = False,
) -> None:
    """Say what keeps robots of a fleet from each other, and what to do about it.

    Run it on the computer of a robot that finds nobody, with the endpoints that the robot is given. It joins nothing:
    it looks who is there, tries each endpoint that it isn't linked to (the name, the port, the certificates), looks
    behind routers, and asks each robot what it finds wrong itself (`peer.health()`). Ends with 1 if there is a problem.

    For instance:  fleetmap doctor --fleet site-4 --connect tcp/10.0.0.2:7447
    """
    import asyncio

    from fleetmap.peer.doctor import examine

    found_by, further = profile(no_multicast_scouting), settings(config)
    with progress(f"looking for robots of fleet {fleet}") as tell:
        tell(", ".join(connect or ()) or "by multicast")
        found = asyncio.run(
            examine(fleet, profile=found_by, connect=connect or (), listen=listen or (), config=further, for_s=for_s)
        )
    document = {
        "fleet": fleet,
        "links": list(found.links),
        "robots": [
            {"robot": seen.robot, "alive": seen.alive, "answers": seen.figures is not None, "endpoint": seen.endpoint}
            for seen in found.robots
        ],
        "other_fleets": list(found.other_fleets),
        "problems": [{"kind": p.kind, "about": p.robot, "text": p.text} for p in found.problems],
    }
    if as_json:
        print_json(document)
    else:
        _print(document)
    if found.problems:
        raise typer.Exit(1)


def _print(document: dict[str, Any]) -> None:
    for link in document["links"]:
        typer.echo(f"linked to {link}")
    for robot in document["robots"]:
        state = "answers" if robot["answers"] else "doesn't answer"
        typer.echo(f"robot {robot['robot']} {state}" + (f", by {robot['endpoint']}" if robot["endpoint"] else ""))
    for problem in document["problems"]:
        typer.echo(f"problem: {problem['text']}")
    if not document["problems"]:
        typer.echo("no problem found")
