"""``Recorder``: a fleet into an MCAP file. It listens as a peer without a map, and asks the robots for their counts.

- ``/map``, the merged map, and ``/fleet_walls``, its lines, in the frame ``fleet``;
- ``/tf``, where each robot's map and base lie;
- ``/fleetmap/records``, as JSON in ``std_msgs/String``: the records between revisions of a robot's stream, of which
  ``fleetmap play`` makes the same fleet again;
- ``/fleetmap/bytes``, as JSON, too: what each robot has counted; and of it, for plots, ``/fleetmap/bytes_sent/_ROBOT``.
"""

from __future__ import annotations

import asyncio
import base64
import re
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial

from fleetmap.bridges import cdr, grids, said
from fleetmap.bridges.mcap_file import McapFile
from fleetmap.bridges.qos import LATCHED, STREAM
from fleetmap.codecs.messages import StatsMessage
from fleetmap.engine import Stream
from fleetmap.engine.log import record_message
from fleetmap.model.errors import MapFormatError
from fleetmap.model.mergedmap import MergedMap
from fleetmap.model.pose import Pose2
from fleetmap.model.threads import in_thread
from fleetmap.peer import TeammateInfo
from fleetmap.peer.peer import Peer
from fleetmap.peer.watcher import Watcher

FLEET_FRAME = "fleet"
MAP_TOPIC, WALLS_TOPIC, TF_TOPIC = "/map", "/fleet_walls", "/tf"
RECORDS_TOPIC, BYTES_TOPIC = "/fleetmap/records", "/fleetmap/bytes"
LOOK_S = 1.0
"""Between two looks at poses and counts."""


def map_frame(robot: str) -> str:
    """The frame of a robot's map in a recording."""
    return f"{robot}/map"


def base_frame(robot: str) -> str:
    """The frame of a robot in a recording."""
    return f"{robot}/base_link"


def sent_topic(robot: str) -> str:
    """Where the payload bytes that a robot has sent stand, as a name of ROS."""
    return "/fleetmap/bytes_sent/_" + re.sub("[.-]", lambda found: f"_{ord(found[0]):x}_", robot)


class Recorder:
    """Writes what a fleet says, from ``run`` on.

    Parameters
    ----------
    peer : a peer without a map, with the fleet's frame as its start
    watcher : asks robots for their counts; None: they are left out
    file : where to write
    clock_ns : the time of messages

    Attributes
    ----------
    robots : whose maps were written
    records, size_bytes : of them
    digest : of the merged map that was written last
    failure : why it stopped writing; None while it goes on
    """

    def __init__(
        self, peer: Peer, watcher: Watcher | None, file: McapFile, *, clock_ns: Callable[[], int] = time.time_ns
    ) -> None:
        self._peer, self._watcher, self._file, self._clock_ns = peer, watcher, file, clock_ns
        self._written: dict[tuple[str, int], Stream] = {}
        self._writing = asyncio.Lock()
        self.robots: set[str] = set()
        self.records = self.size_bytes = 0
        self.digest = ""
        self.failure: BaseException | None = None
        for topic, type_name, qos in (
            (MAP_TOPIC, cdr.MAP, LATCHED),
            (WALLS_TOPIC, cdr.MARKERS, LATCHED),
            (TF_TOPIC, cdr.TF, STREAM),
            (RECORDS_TOPIC, cdr.TEXT, STREAM),
            (BYTES_TOPIC, cdr.TEXT, STREAM),
        ):
            file.add_topic(topic, type_name, qos)

    async def run(self) -> None:
        """Write until it is cancelled, or something is in the way; ``finish`` writes what came last."""
        try:
            async with asyncio.TaskGroup() as group:
                group.create_task(self._follow())
                group.create_task(self._look())
        except BaseExceptionGroup as errors:  # the disk is full, or the peer is closed
            self.failure = errors.exceptions[0]

    async def finish(self) -> None:
        """Write what is held now."""
        await self._write_maps(await self._peer.refresh())
        await self._look_once()

    async def _follow(self) -> None:
        await self._write_maps(await self._peer.refresh())
        async for _ in self._peer.changes():
            await self._write_maps(self._peer.merged)

    async def _write_maps(self, merged: MergedMap) -> None:
        async with self._writing:
            await in_thread(partial(self._write, merged, self._peer.streams))

    def _write(self, merged: MergedMap, streams: tuple[Stream, ...]) -> None:
        stamp_ns = self._clock_ns()
        for stream in streams:
            self._write_record(stream, stamp_ns)
        if len(merged) and merged.digest != self.digest:
            with suppress(MapFormatError):  # robots kilometres apart make no grid; their walls and records are there
                grid = grids.map_message(merged.to_grid(), frame_id=FLEET_FRAME, stamp_ns=stamp_ns)
                self._file.write(MAP_TOPIC, stamp_ns, cdr.encode(grid, cdr.MAP))
            walls = said.walls(merged, frame_id=FLEET_FRAME, stamp_ns=stamp_ns)
            self._file.write(WALLS_TOPIC, stamp_ns, cdr.encode(walls, cdr.MARKERS))
            self.digest = merged.digest

    def _write_record(self, stream: Stream, stamp_ns: int) -> None:
        before = self._written.get(stream.key)
        if before is None and not stream.edges:
            return  # no map yet: a watcher, or the recorder itself
        before = before or Stream(stream.robot, stream.life)
        if before.revision == stream.revision:
            return
        message, _ = record_message(before, stream)
        document = {
            "robot": stream.robot,
            "life": f"{stream.life:016x}",
            "seq": stream.seq,
            "edges": stream.edges,
            "size_bytes": len(message),
            "message": base64.b64encode(message).decode(),
        }
        self._file.write_json(RECORDS_TOPIC, stamp_ns, document)
        self._written[stream.key] = stream
        self.robots.add(stream.robot)
        self.records += 1
        self.size_bytes += len(message)

    async def _look(self) -> None:
        while True:
            await self._look_once()
            await asyncio.sleep(LOOK_S)

    async def _look_once(self) -> None:
        """Write where robots are, and what they have counted."""
        starts = {info.robot: info.T_fleet_robot for info in self._peer.peers if info.T_fleet_robot is not None}
        mates = self._peer.teammates(frame="fleet")
        seen = [] if self._watcher is None else await self._watcher.look()
        async with self._writing:
            stamp_ns = self._clock_ns()
            self._write_frames(starts, mates, stamp_ns)
            for robot in seen:
                if robot.figures is not None and robot.robot in self.robots:
                    self._write_counts(robot.robot, robot.figures, stamp_ns)

    def _write_counts(self, robot: str, figures: StatsMessage, stamp_ns: int) -> None:
        sent = {kind: size_bytes for kind, (_, size_bytes, _) in figures.sent.items()}
        document = {
            "robot": robot,
            "edges": figures.edges,
            "bytes_vector": sum(sent.values()),
            "sent": sent,
            "grids": {name: size_bytes for name, (_, size_bytes, _) in figures.grids.items()},
        }
        self._file.write_json(BYTES_TOPIC, stamp_ns, document)
        topic = sent_topic(robot)
        self._file.add_topic(topic, cdr.WHOLE_NUMBER, STREAM)
        number = cdr.make(cdr.WHOLE_NUMBER, data=sum(sent.values()))
        self._file.write(topic, stamp_ns, cdr.encode(number, cdr.WHOLE_NUMBER))

    def _write_frames(self, starts: dict[str, Pose2], mates: list[TeammateInfo], stamp_ns: int) -> None:
        def write(pose: Pose2, parent: str, child: str) -> None:
            message = said.transform(pose, parent=parent, child=child, stamp_ns=stamp_ns)
            self._file.write(TF_TOPIC, stamp_ns, cdr.encode(message, cdr.TF))

        for robot, start in sorted(starts.items()):
            if robot in self.robots:
                write(start, FLEET_FRAME, map_frame(robot))
        for mate in mates:
            start_or_none = starts.get(mate.robot)
            if mate.pose is not None and start_or_none is not None:
                write(start_or_none.inverse() @ mate.pose, map_frame(mate.robot), base_frame(mate.robot))
