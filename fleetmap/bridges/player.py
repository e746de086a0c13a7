"""Bags as robots: a bag's ``/map`` is published by one robot; a recording of a fleet by as many as it holds."""

from __future__ import annotations

import asyncio
import base64
import json
from collections.abc import Callable
from contextlib import AsyncExitStack, suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from fleetmap.bridges import cdr
from fleetmap.bridges.bags import Bag, Topic
from fleetmap.bridges.grids import LatestMap
from fleetmap.bridges.recorder import RECORDS_TOPIC, TF_TOPIC, base_frame, map_frame
from fleetmap.bridges.transforms import TransformBuffer
from fleetmap.codecs import envelope
from fleetmap.codecs.messages import CHECK_MASK, Record
from fleetmap.engine import Limits, Stream, advance
from fleetmap.model.errors import ConfigError, FleetmapError, MapFormatError, WireError
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.threads import in_thread
from fleetmap.peer.join import make_peer
from fleetmap.peer.options import JoinOptions
from fleetmap.peer.peer import Peer

POSE_NS = 500_000_000
"""Of the bag's time, between two poses that are announced."""
LONGEST_GAP_NS = 3600 * 10**9
MAX_ROBOTS = 64
"""Of a recording, life by life: each is a peer of this process."""
Tell = Callable[[int, int], None]


@dataclass(slots=True)
class Pace:
    """When a message's turn is.

    Parameters
    ----------
    rate : how many times as fast as it was written; None: as fast as possible
    """

    rate: float | None
    before_ns: int | None = None
    due_s: float = 0.0

    async def wait(self, stamp_ns: int) -> None:
        """Until the turn of what was written then; gives others a turn in any case."""
        now_s = asyncio.get_running_loop().time()
        if self.before_ns is None:
            self.before_ns, self.due_s = stamp_ns, now_s
        gap_ns, self.before_ns = stamp_ns - self.before_ns, stamp_ns
        # A clock that was set, or a stamp of 0, is no pause.
        if self.rate is not None and 0 < gap_ns < LONGEST_GAP_NS:
            self.due_s += gap_ns / 1e9 / self.rate
        await asyncio.sleep(max(0.0, self.due_s - now_s))


@dataclass(slots=True)
class Played:
    """What was done so far: messages of grids, maps that changed something, messages that were none."""

    maps: int = 0
    published: int = 0
    refused: int = 0
    reason: str = ""


async def play_map(
    bag: Bag,
    peer: Peer,
    *,
    topic: str,
    rate: float | None,
    map_frame_id: str = "",
    base_frame_id: str = "base_link",
    free_below: float | None = None,
    occupied_above: float | None = None,
    tell: Tell = lambda done, total: None,
) -> Played:
    """Publish one topic's maps, and where the robot was by the bag's transforms.

    Parameters
    ----------
    topic : of nav_msgs/OccupancyGrid; ``topic_updates`` is applied, too
    rate : as in ``Pace``
    map_frame_id, base_frame_id : frames of the map (empty: what the messages say) and of the robot

    Raises
    ------
    MapFormatError : the bag is damaged
    ConfigError, LinkError : as ``publish``
    """
    names = [topic, f"{topic}_updates", "/tf", "/tf_static"]
    total = sum(t.messages for t in bag.topics if t.name in names)
    latest, transforms, played = LatestMap(), TransformBuffer(), Played()
    pace, said_ns = Pace(rate), -POSE_NS
    for done, (which, stamp_ns, data) in enumerate(bag.messages(names), 1):
        await pace.wait(stamp_ns)
        try:
            message = bag.decode(which, data)
            if which.type_name == cdr.TF:
                transforms.take(message.transforms, static=which.name == "/tf_static")
            elif which.type_name in (cdr.MAP, cdr.MAP_UPDATE):
                played.maps += 1
                grid = _take(latest, which, message)
                if grid is not None:
                    played.published += await peer.publish(grid, free_below=free_below, occupied_above=occupied_above)
        except (ConfigError, MapFormatError) as error:
            played.refused += 1
            played.reason = played.reason or str(error)
        frame = map_frame_id or latest.frame_id
        if frame and stamp_ns - said_ns >= POSE_NS:
            found = transforms.lookup(frame, base_frame_id)
            if found is not None:
                said_ns = stamp_ns
                with suppress(ConfigError):  # no place on earth
                    await peer.set_pose(found[0])
        tell(done, total)
    return played


def is_recording(bag: Bag) -> bool:
    """Whether `fleetmap record` wrote it."""
    return any(topic.name == RECORDS_TOPIC for topic in bag.topics)


async def play_recording(
    bag: Bag, options: JoinOptions, peers: AsyncExitStack, *, rate: float | None, tell: Tell = lambda done, total: None
) -> list[Peer]:
    """Have all robots of a recording say again what they said, under their names; returns them, open in ``peers``.

    Parameters
    ----------
    options : what each of them joins with; name, level and start are the recording's
    peers : closes them
    rate : as in ``Pace``

    Raises
    ------
    MapFormatError : the recording is damaged
    NameInUse, LinkError : as ``join``
    """
    streams: dict[tuple[str, int], Stream] = {}
    robots: dict[tuple[str, int], Peer] = {}
    transforms, pace = TransformBuffer(), Pace(rate)
    total = sum(topic.messages for topic in bag.topics if topic.name in (RECORDS_TOPIC, TF_TOPIC))
    for done, (which, stamp_ns, data) in enumerate(bag.messages([RECORDS_TOPIC, TF_TOPIC]), 1):
        await pace.wait(stamp_ns)
        expected = cdr.TF if which.name == TF_TOPIC else cdr.TEXT
        if which.type_name != expected:
            raise MapFormatError(
                path=bag.path, field=which.name, reason=f"expected {expected}; found {which.type_name}"
            )
        if which.name == TF_TOPIC:
            transforms.take(bag.decode(which, data).transforms, static=False)
            for (robot, _), peer in robots.items():
                found = transforms.lookup(map_frame(robot), base_frame(robot))
                if found is not None:
                    with suppress(ConfigError):  # no place on earth
                        await peer.set_pose(found[0])
            tell(done, total)
            continue
        text = bag.decode(which, data).data
        before, after = await in_thread(partial(_next_stream, bag, text, streams))
        streams[after.key] = after
        if after.key not in robots:
            if len(robots) == MAX_ROBOTS:
                raise MapFormatError(
                    path=bag.path, field=RECORDS_TOPIC, reason=f"more than {MAX_ROBOTS} lives of robots"
                )
            own = replace(options, robot=after.robot, level=after.level, start=after.start, if_taken="join")
            if robots and options.listen:
                # One of them can listen there; the others find it there.
                own = replace(own, listen=(), connect=(*options.connect, *options.listen))
            robots[after.key] = await peers.enter_async_context(make_peer(own))
        elif after.start != before.start:
            await robots[after.key].set_start(after.start)
        for name, vector_map in after.submaps.items():
            same = before.submaps.get(name) is vector_map and before.anchor(name) == after.anchor(name)
            if not same:
                await robots[after.key].publish(vector_map, submap=name, anchor=after.anchor(name))
        tell(done, total)
    return list(robots.values())


def _take(latest: LatestMap, which: Topic, message: Any) -> OccupancyGrid | None:
    if which.type_name == cdr.MAP:
        latest.replace(message)
    else:
        latest.update(message)
    return latest.take()


def _next_stream(bag: Bag, text: str, streams: dict[tuple[str, int], Stream]) -> tuple[Stream, Stream]:
    """A robot's stream before and after a record.

    Raises
    ------
    MapFormatError : the record is damaged, or doesn't follow
    """
    try:
        document = json.loads(text)
        robot, life = str(document["robot"]), int(document["life"], 16)
        message = base64.b64decode(document["message"], validate=True)
        record = envelope.decode(message, robot=robot)
        if not isinstance(record, Record):
            raise WireError(robot=robot, size_bytes=len(message), reason="no record")
        before = streams.get((robot, life), Stream(robot, life))
        step = advance(
            before,
            record.change,
            seq=record.seq,
            link=record.link,
            digest=record.check,
            limits=Limits(),
            mask=CHECK_MASK,
        )
    except (ValueError, KeyError, TypeError, RecursionError, FleetmapError) as error:
        reason = f"{type(error).__name__}: {error}"
        raise MapFormatError(path=bag.path, field=RECORDS_TOPIC, reason=reason) from None
    return before, step.after
