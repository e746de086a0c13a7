"""``Bridge``: a robot's ``/map`` in, the fleet's map out.

It knows neither Zenoh nor rclpy: what reaches ROS is a ``Port``. Maps that come faster than they can be taken in
replace each other, and so do those that go out, so that no queue grows.
"""

from __future__ import annotations

import asyncio
import logging
import math
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial

from fleetmap.bridges import cdr, grids, said
from fleetmap.bridges.options import BridgeOptions, WireOptions
from fleetmap.bridges.port import Port, Say
from fleetmap.bridges.qos import LATCHED, LATEST, STREAM, Qos
from fleetmap.bridges.transforms import TransformBuffer
from fleetmap.model.errors import ConfigError, FleetmapError, MapFormatError
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.grid_like import pose_of
from fleetmap.model.mergedmap import MergedMap
from fleetmap.model.pose import Pose2
from fleetmap.model.threads import in_thread
from fleetmap.peer.health import Problem
from fleetmap.peer.join import make_peer
from fleetmap.peer.peer import Peer

logger = logging.getLogger(__name__)

POSE_S = 0.5
"""Between two looks for where the robot is."""
POSE_M, POSE_RAD = 0.01, 0.01
"""Less than that is no new pose."""
WATCH_S = 1.0
"""Between two diagnostics."""
PATIENCE_S = 5.0
"""After so long without a map or a pose somebody should know."""


class Bridge:
    """One robot between a ROS graph and its fleet.

    Parameters
    ----------
    peer : the robot in its fleet, connected
    port : the node in the ROS graph, not yet open
    options : topics, frames and rates
    tell : told in a line what happens now and then: the first map, who comes and goes

    Attributes
    ----------
    maps_in, maps_published, maps_out : whole maps and updates that came, maps that changed something, fleet maps that
        went
    refused : by (topic, reason), messages that were none
    """

    def __init__(
        self, peer: Peer, port: Port, options: BridgeOptions, tell: Callable[[str], None] = lambda text: None
    ) -> None:
        self.peer, self.port, self.options, self._tell = peer, port, options, tell
        self._seen: set[str] = set()
        self._told_first = False
        self.maps_in = self.maps_published = self.maps_out = 0
        self.refused: dict[tuple[str, str], int] = {}
        self._latest, self._transforms = grids.LatestMap(), TransformBuffer()
        self._loop = asyncio.get_running_loop()
        self._map_came, self._merged_came = asyncio.Event(), asyncio.Event()
        self._pose: tuple[str, Pose2] | None = None
        self._said_pose: Pose2 | None = None
        self._last_out: OccupancyGrid | None = None
        self._began_s = time.monotonic()
        self._offered: list[str] = []
        self._unfit, self._undrawn = "", ""
        self._told: set[tuple[str, str]] = set()
        self._hear()
        self._offer()

    async def run(self) -> None:
        """Open the port, and hand over both ways until it is cancelled; then the port is closed.

        Raises
        ------
        LinkError : the port or the peer failed for good
        """
        self._began_s = time.monotonic()
        works = (
            self._publish_maps,
            self._watch_merged,
            self._say_merged,
            self._tell_pose,
            self._say_frame,
            self._look_after,
        )
        try:
            async with asyncio.TaskGroup() as group:
                group.create_task(self.port.open())
                for work in works:
                    group.create_task(work())
        except BaseExceptionGroup as errors:
            raise first(errors) from None
        finally:
            await self.port.close()

    @property
    def map_frame(self) -> str:
        """The robot's map frame; empty while it isn't known."""
        return self.options.map_frame or self._latest.frame_id

    def problems(self) -> tuple[Problem, ...]:
        """What is wrong on this side and in the fleet, in words that say what to do."""
        found = [Problem("ros", about, text) for about, text in self.port.problems().items()]
        waited = time.monotonic() - self._began_s > PATIENCE_S
        topic = self.port.resolve(self.options.map_topic)
        if not self.maps_in and waited and self.port.is_reached():
            found.append(Problem("map", topic, self._why_no_map(topic)))
        if self._unfit:
            found.append(Problem("map", topic, f"the map that came last can't be shared: {self._unfit}"))
        if self._undrawn:
            text = f"the fleet's map can't be drawn as a grid: {self._undrawn}. A larger resolution_m takes fewer cells"
            found.append(Problem("fleet map", self.port.resolve(self.options.fleet_map_topic), text))
        if self.maps_in and self._said_pose is None and waited:
            found.append(Problem("pose", self.options.base_frame, self._why_no_pose()))
        if self.peer.T_fleet_robot is None:
            text = (
                "no start is given, so that the own map is not merged with any other. Say where its map frame lies in "
                "the fleet's: --start 0,0,0 (x, y, yaw), or start: [0.0, 0.0, 0.0] as a parameter"
            )
            found.append(Problem("start", self.peer.robot, text))
        return (*found, *self.peer.health())

    def _why_no_map(self, topic: str) -> str:
        # What other bridges say is no robot's own map.
        shared = self.options.fleet_map_topic.rsplit("/", 1)[-1]
        others = [name for name in self._offered if name.rsplit("/", 1)[-1] != shared]
        if others:
            return (
                f"no map on {topic} yet; maps are offered on {', '.join(others)}: name one with map_topic or namespace"
            )
        return f"no map on {topic} yet, and on no other topic either ({self.port.where()}): does the mapper run there?"

    # In

    def _hear(self) -> None:
        options = self.options
        updates = options.map_updates_topic or f"{options.map_topic}_updates"
        self._take(options.map_topic, cdr.MAP, LATCHED, self._take_map)
        self._take(updates, cdr.MAP_UPDATE, Qos(depth=10), self._take_update)
        if options.tf_topic:
            self._take(options.tf_topic, cdr.TF, STREAM, partial(self._take_transforms, False))
        if options.tf_static_topic:
            # As many as there may be publishers: each keeps its own transforms.
            self._take(
                options.tf_static_topic, cdr.TF, Qos(latched=True, depth=100), partial(self._take_transforms, True)
            )
        if options.pose_topic:
            self._take(options.pose_topic, cdr.POSE, Qos(latched=True, depth=1), self._take_pose)

    def _take(self, topic: str, type_name: str, qos: Qos, take: Callable[[str, bytes], None]) -> None:
        whole = self.port.resolve(topic)

        def handle(data: bytes) -> None:
            try:
                take(whole, data)
            except FleetmapError as error:
                self._refuse(whole, error)

        self.port.subscribe(topic, type_name, qos, handle)

    def _take_map(self, topic: str, data: bytes) -> None:
        if self._latest.replace(cdr.decode(data, cdr.MAP, topic=topic)):
            self.maps_in += 1
            self._wake(self._map_came)

    def _take_update(self, topic: str, data: bytes) -> None:
        if self._latest.update(cdr.decode(data, cdr.MAP_UPDATE, topic=topic)):
            self.maps_in += 1
            self._wake(self._map_came)

    def _take_transforms(self, static: bool, topic: str, data: bytes) -> None:
        self._transforms.take(cdr.decode(data, cdr.TF, topic=topic).transforms, static=static)

    def _take_pose(self, topic: str, data: bytes) -> None:
        message = cdr.decode(data, cdr.POSE, topic=topic)
        self._pose = str(message.header.frame_id).lstrip("/"), pose_of(message.pose.pose)

    def _wake(self, event: asyncio.Event) -> None:
        with suppress(RuntimeError):  # the loop is closed: nobody waits any more
            self._loop.call_soon_threadsafe(event.set)

    def _refuse(self, topic: str, error: FleetmapError) -> None:
        key = topic, error.field if isinstance(error, MapFormatError) else "format"
        self.refused[key] = self.refused.get(key, 0) + 1
        if self.refused[key] == 1:
            logger.warning("%s: %s: a message is refused: %s; told once", self.peer.robot, topic, error)

    async def _publish_maps(self) -> None:
        options = self.options
        while True:
            await self._map_came.wait()
            self._map_came.clear()
            began_s = time.monotonic()
            try:
                grid = await in_thread(self._latest.take)
                if grid is not None:
                    self.maps_published += await self.peer.publish(
                        grid, free_below=options.free_below, occupied_above=options.occupied_above
                    )
                    self._unfit = ""
            except (ConfigError, MapFormatError) as error:
                self._unfit = str(error)
            await asyncio.sleep(max(0.0, 1 / options.map_rate_hz - (time.monotonic() - began_s)))

    async def _tell_pose(self) -> None:
        while True:
            await asyncio.sleep(POSE_S)
            try:
                pose = self._pose_now()
                if pose is not None and (self._said_pose is None or _differs(pose, self._said_pose)):
                    await self.peer.set_pose(pose)
                    self._said_pose = pose
            except ConfigError as error:  # no place on earth
                self._refuse(self.options.pose_topic or self.options.tf_topic, error)

    def _pose_now(self) -> Pose2 | None:
        """T_map_base, as far as it is known."""
        if not self.map_frame:
            return None
        if not self.options.pose_topic:
            found = self._transforms.lookup(self.map_frame, self.options.base_frame)
            return None if found is None else found[0]
        if self._pose is None:
            return None
        frame, pose = self._pose
        if frame in (self.map_frame, ""):
            return pose
        found = self._transforms.lookup(self.map_frame, frame)
        return None if found is None else found[0] @ pose

    def _why_no_pose(self) -> str:
        if self.options.pose_topic:
            return (
                f"no pose on {self.port.resolve(self.options.pose_topic)} yet: teammates don't see where this robot is"
            )
        if "tf2_msgs" in self.port.problems():
            return "no pose, as tf2_msgs is not installed: name a topic with pose_topic, as amcl_pose"
        why = self._transforms.why_not(self.map_frame, self.options.base_frame)
        return f"no pose: {why}. Name frames with map_frame and base_frame, or a topic with pose_topic"

    # Out

    def _offer(self) -> None:
        options, self._say = self.options, dict[str, Say]()

        def offer(topic: str, type_name: str, qos: Qos) -> None:
            if topic:
                self._say[topic] = self.port.advertise(topic, type_name, qos)

        offer(options.fleet_map_topic, cdr.MAP, LATCHED)
        if options.fleet_map_updates:
            offer(f"{options.fleet_map_topic}_updates", cdr.MAP_UPDATE, Qos(depth=10))
        offer(options.markers_topic, cdr.MARKERS, LATCHED)
        offer(options.teammates_topic, cdr.POSES, LATEST)
        offer(f"{options.teammates_topic}_names" if options.teammates_topic else "", cdr.MARKERS, LATEST)
        offer(options.diagnostics_topic, cdr.DIAGNOSTICS, Qos(depth=10))
        if options.publish_tf:
            offer(options.tf_topic, cdr.TF, STREAM)

    async def _watch_merged(self) -> None:
        async for _ in self.peer.changes():
            self._merged_came.set()

    async def _say_merged(self) -> None:
        before = ""
        while True:
            await self._merged_came.wait()
            self._merged_came.clear()
            began_s = time.monotonic()
            merged, frame = self.peer.merged, self._merged_frame()
            if len(merged) and frame and f"{merged.digest} {frame}" != before:
                before = f"{merged.digest} {frame}"
                await in_thread(partial(self._say_map, merged, frame))
            await asyncio.sleep(max(0.0, 1 / self.options.fleet_map_rate_hz - (time.monotonic() - began_s)))

    def _merged_frame(self) -> str:
        """Of what ``merged`` is in: while the start is unknown, that is the own map's."""
        return self.map_frame if self.peer.T_fleet_robot is None else self.options.fleet_frame

    def _say_map(self, merged: MergedMap, frame: str) -> None:
        options, stamp_ns = self.options, self.port.now_ns()
        if options.markers_topic:
            walls = said.walls(merged, frame_id=frame, stamp_ns=stamp_ns)
            self._say[options.markers_topic](cdr.encode(walls, cdr.MARKERS))
        try:
            grid = merged.to_grid(options.resolution_m or None)
            self._undrawn = ""
        except MapFormatError as error:  # too many cells: a teammate is kilometres away
            self._undrawn = str(error)
            return
        topic = options.fleet_map_topic
        if options.fleet_map_updates:
            before, self._last_out = self._last_out, grid
            update = None
            if before is not None:
                update = grids.update_message(before, grid, frame_id=frame, stamp_ns=stamp_ns)
            if update is not None:
                self._say[f"{topic}_updates"](cdr.encode(update, cdr.MAP_UPDATE))
        message = grids.map_message(grid, frame_id=frame, stamp_ns=stamp_ns)
        self._say[topic](cdr.encode(message, cdr.MAP))
        self.maps_out += 1

    async def _say_frame(self) -> None:
        """Where the own map lies in the fleet: who looks it up wants it fresh."""
        options = self.options
        while options.publish_tf and options.tf_topic:
            T_fleet_map, stamp_ns = self.peer.T_fleet_robot, self.port.now_ns()
            if T_fleet_map is not None and self.map_frame and stamp_ns:
                message = said.transform(
                    T_fleet_map, parent=options.fleet_frame, child=self.map_frame, stamp_ns=stamp_ns
                )
                self._say[options.tf_topic](cdr.encode(message, cdr.TF))
            await asyncio.sleep(1 / options.tf_rate_hz)

    async def _look_after(self) -> None:
        """Say who is where and what is wrong, each second; new problems go to the log, too."""
        while True:
            await asyncio.sleep(WATCH_S)
            if not self.maps_in:
                self._offered = await in_thread(partial(self.port.topics_of, cdr.MAP))
            self._tell_news()
            own = self.problems()
            fleet_side = set(self.peer.health())  # the peer logs these itself
            for problem in own:
                if (problem.kind, problem.robot) not in self._told and problem not in fleet_side:
                    logger.warning("%s: %s", self.peer.robot, problem.text)
            self._told = {(problem.kind, problem.robot) for problem in own}
            await in_thread(partial(self._say_status, own))

    def _tell_news(self) -> None:
        if self.maps_in and not self._told_first:
            self._told_first = True
            self._tell(f"maps come in on {self.port.resolve(self.options.map_topic)}, in frame {self.map_frame}")
        living = {info.robot for info in self.peer.peers if info.alive}
        for robot in sorted(living - self._seen):
            self._tell(f"{robot} is in reach")
        for robot in sorted(self._seen - living):
            self._tell(f"{robot} is out of reach; its map stays")
        self._seen = living

    def _say_status(self, problems: tuple[Problem, ...]) -> None:
        options, stamp_ns = self.options, self.port.now_ns()
        if options.teammates_topic and self.peer.T_fleet_robot is not None:
            mates = self.peer.teammates(frame="fleet")
            frame = options.fleet_frame
            poses = said.poses(mates, frame_id=frame, stamp_ns=stamp_ns)
            self._say[options.teammates_topic](cdr.encode(poses, cdr.POSES))
            names = said.names(mates, frame_id=frame, stamp_ns=stamp_ns)
            self._say[f"{options.teammates_topic}_names"](cdr.encode(names, cdr.MARKERS))
        if options.diagnostics_topic:
            peer = self.peer
            message = said.diagnostics(peer.robot, peer.fleet, problems, self.figures(), stamp_ns=stamp_ns)
            self._say[options.diagnostics_topic](cdr.encode(message, cdr.DIAGNOSTICS))

    def figures(self) -> dict[str, object]:
        """What it has done so far."""
        stats = self.peer.stats()
        return {
            "robots in reach": ", ".join(p.robot for p in self.peer.peers if p.alive) or "none",
            "maps in": self.maps_in,
            "maps that changed something": self.maps_published,
            "fleet maps out": self.maps_out,
            "fleet map edges": len(self.peer.merged),
            "payload bytes sent": stats.bytes_vector,
            "messages refused": sum(self.refused.values()) + self._transforms.refused,
        }


async def serve(options: BridgeOptions, wire: WireOptions, tell: Callable[[str], None] = lambda text: None) -> None:
    """Join the fleet and bridge to ROS over Zenoh until it is cancelled.

    Parameters
    ----------
    tell : as ``Bridge`` has it

    Raises
    ------
    ConfigError : an option has an impossible value, or ``fleetmap[ros]`` is not installed
    NameInUse, LinkError : on joining the fleet, or when it can't listen
    """
    from fleetmap.bridges.names import check_namespace
    from fleetmap.bridges.zenoh_port import ZenohPort

    cdr.typestore()
    port = ZenohPort(
        wire.dialect(),
        endpoint=wire.ros_endpoint,
        listen=wire.ros_listen,
        namespace=check_namespace("namespace", wire.namespace),
        node=wire.node,
        use_sim_time=wire.use_sim_time,
    )
    async with make_peer(options.join_options()) as peer:
        await Bridge(peer, port, options, tell).run()


def first(errors: BaseExceptionGroup[BaseException]) -> BaseException:
    """What went wrong, of all that ended with it."""
    found: BaseException = errors
    while isinstance(found, BaseExceptionGroup):
        found = next((e for e in found.exceptions if not isinstance(e, asyncio.CancelledError)), found.exceptions[0])
    return found


def _differs(a: Pose2, b: Pose2) -> bool:
    turn = math.remainder(a.yaw_rad - b.yaw_rad, math.tau)
    return math.hypot(a.x_m - b.x_m, a.y_m - b.y_m) > POSE_M or abs(turn) > POSE_RAD
