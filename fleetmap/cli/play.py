"""``fleetmap play``: a bag as a robot of a fleet, or a recording as the fleet that it was."""

from __future__ import annotations

import asyncio
from contextlib import AsyncExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fleetmap.cli.joining import Config, Connect, Listen, NoMulticast, profile, settings
from fleetmap.cli.output import AsJson, print_json, progress_bar, stderr
from fleetmap.model.errors import ConfigError, MapFormatError

if TYPE_CHECKING:
    from fleetmap.bridges.bags import Bag
    from fleetmap.peer.options import JoinOptions
    from fleetmap.peer.peer import Peer

LINGER_S = 2.0
"""At the end, as long as somebody is there: what was lost on the way is asked for again."""


def play(
    bag: Annotated[Path, typer.Argument(metavar="BAG", help="A folder of ros2 bag, .mcap, .db3, or .bag of ROS 1.")],
    robot: Annotated[str, typer.Option(metavar="NAME", help="The robot's name in the fleet.")] = "",
    topic: Annotated[str, typer.Option(metavar="NAME", help="Of nav_msgs/OccupancyGrid; its _updates count.")] = "",
    start: Annotated[
        str, typer.Option(metavar="X,Y,YAW", help="Where the bag's map frame lies in the fleet's, metres and radians.")
    ] = "",
    map_frame: Annotated[str, typer.Option(metavar="NAME", help="Of the map; else what its messages say.")] = "",
    base_frame: Annotated[str, typer.Option(metavar="NAME", help="Of the robot, for its pose by /tf.")] = "base_link",
    free_below: Annotated[float | None, typer.Option(metavar="PERCENT", help="Cells below are free.")] = None,
    occupied_above: Annotated[float | None, typer.Option(metavar="PERCENT", help="Cells above are occupied.")] = None,
    rate: Annotated[float, typer.Option(metavar="TIMES", help="So many times as fast as it was.")] = 1.0,
    fast: Annotated[bool, typer.Option("--fast", help="As fast as possible.")] = False,
    hold_s: Annotated[float, typer.Option("--hold-s", min=0.0, metavar="S", help="Stay so long after its end.")] = 0.0,
    fleet: Annotated[str, typer.Option(metavar="NAME", help="The fleet to join.")] = "default",
    level: Annotated[str, typer.Option(metavar="NAME", help="Its storey.")] = "0",
    connect: Connect = None,
    listen: Listen = None,
    no_multicast_scouting: NoMulticast = False,
    config: Config = None,
    as_json: AsJson = False,
) -> None:
    """Publish a bag's map as a robot of a fleet, in its own time, faster, or as fast as possible.

    For instance:  fleetmap play rosbag2_2026_03_01-10_00_00 --robot r1 --topic /map --start 0,0,0 --rate 10

    A file that `fleetmap record` wrote comes back as the fleet that it was: all its robots, under their names, in one
    process. With --robot, its /map, which is the merged one, is published by that robot alone.

    For instance:  fleetmap play RUN.mcap --fast --hold-s 60
    """
    if not rate > 0:
        raise ConfigError(option="rate", value=rate, reason="expected more than 0; --fast is as fast as possible")
    from fleetmap.bridges.bags import Bag
    from fleetmap.bridges.options import parse_start
    from fleetmap.bridges.player import is_recording
    from fleetmap.peer.options import JoinOptions

    with Bag(bag) as opened:
        if not any(topic.messages for topic in opened.topics):
            raise MapFormatError(path=bag, field="messages", reason="there are none")
        again = is_recording(opened) and not robot
        if not again and not robot:
            raise ConfigError(option="robot", value=robot, reason="expected the robot's name in the fleet, as r1")
        options = JoinOptions(
            robot or "replayed",
            fleet=fleet,
            level=level,
            start=parse_start(start),
            connect=connect or (),
            listen=listen or (),
            profile=profile(no_multicast_scouting),
            config=settings(config),
        )
        speed = None if fast else rate
        graded = {"free_below": free_below, "occupied_above": occupied_above}
        frames = {"map_frame_id": map_frame.lstrip("/"), "base_frame_id": base_frame.lstrip("/")}
        work = (
            _again(opened, options, speed, hold_s)
            if again
            else _as_robot(opened, options, topic, speed, hold_s, {**graded, **frames})
        )
        document = asyncio.run(work)
    if as_json:
        print_json(document)
    else:
        typer.echo(", ".join(f"{key} {value}" for key, value in document.items() if value != ""))


async def _as_robot(
    bag: Bag, options: JoinOptions, topic: str, rate: float | None, hold_s: float, how: dict[str, Any]
) -> dict[str, Any]:
    from fleetmap.bridges.bags import map_topics
    from fleetmap.bridges.player import play_map
    from fleetmap.peer.join import make_peer

    found = list(map_topics(bag, [topic] if topic else []))
    if len(found) > 1:
        raise ConfigError(option="topic", value="", reason=f"expected one of {', '.join(found)}")
    async with make_peer(options) as peer:
        with progress_bar(f"playing {bag.path.name}", "messages") as tell:
            played = await play_map(bag, peer, topic=found[0], rate=rate, tell=tell, **how)
        merged = await peer.refresh()
        stats = peer.stats()
        await _hold([peer], hold_s)
        return {
            "robot": peer.robot,
            "topic": found[0],
            "maps": played.maps,
            "published": played.published,
            "refused": played.refused,
            "refused_because": played.reason,
            "bytes_vector": stats.bytes_vector,
            **{f"bytes_{name}": size for name, size in stats.baselines.items()},
            "digest": merged.digest,
        }


async def _again(bag: Bag, options: JoinOptions, rate: float | None, hold_s: float) -> dict[str, Any]:
    from fleetmap.bridges.player import play_recording

    async with AsyncExitStack() as stack:
        with progress_bar(f"playing {bag.path.name}", "messages") as tell:
            peers = await play_recording(bag, options, stack, rate=rate, tell=tell)
        digest = (await peers[0].synced()).digest if peers else ""
        await _hold(peers, hold_s)
        return {"robots": ", ".join(sorted({peer.robot for peer in peers})), "digest": digest}


async def _hold(peers: list[Peer], hold_s: float) -> None:
    own = {peer.robot for peer in peers}
    others = {info.robot for peer in peers for info in peer.peers if info.alive} - own
    if not others and not hold_s:
        stderr.print(
            "nobody else is in the fleet, so that nobody holds this map from here on; --hold-s 60 stays for who comes",
            markup=False,
            highlight=False,
        )
    with suppress(asyncio.CancelledError):  # Ctrl-C: it has all been said
        await asyncio.sleep(max(hold_s, LINGER_S if others else 0.0))
