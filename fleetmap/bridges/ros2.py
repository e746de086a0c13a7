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

from fleetmap.bridges import cdr
from fleetmap.bridges.hearing import Hearing
from fleetmap.bridges.options import BridgeOptions, WireOptions
from fleetmap.bridges.port import Port
from fleetmap.bridges.saying import Saying
from fleetmap.model.errors import ConfigError, MapFormatError
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
NO_START = (
    "no start is given, so that the own map is not merged with any other. Say where its map frame lies in the fleet's: "
    "--start 0,0,0 (x, y, yaw), or start: [0.0, 0.0, 0.0] as a parameter"
)


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
    hearing, saying : both sides towards ROS
    maps_published : maps that changed something
    offered : topics on which others say maps, while none has come
    """

    def __init__(
        self, peer: Peer, port: Port, options: BridgeOptions, tell: Callable[[str], None] = lambda text: None
    ) -> None:
        self.peer, self.port, self.options, self._tell = peer, port, options, tell
        self._loop = asyncio.get_running_loop()
        self._map_came, self._merged_came = asyncio.Event(), asyncio.Event()
        self.hearing = Hearing(peer.robot, port, options, self._wake)
        self.saying = Saying(port, options)
        self.maps_published = 0
        self.offered: list[str] = []
        self._began_s = time.monotonic()
        self._unfit = ""
        self._said_pose: Pose2 | None = None
        self._told: set[tuple[str, str]] = set()
        self._told_first, self._seen = False, set[str]()

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

    def problems(self) -> tuple[Problem, ...]:
        """What is wrong on this side and in the fleet, in words that say what to do."""
        hearing, saying, topic = self.hearing, self.saying, self.hearing.map_topic
        waited = time.monotonic() - self._began_s > PATIENCE_S
        found = [Problem("ros", about, text) for about, text in self.port.problems().items()]
        if not hearing.maps_in and waited and self.port.is_reached():
            found.append(Problem("map", topic, hearing.why_no_map(self.offered)))
        if self._unfit:
            found.append(Problem("map", topic, f"the map that came last can't be shared: {self._unfit}"))
        if saying.undrawn:
            text = (
                f"the fleet's map can't be drawn as a grid: {saying.undrawn}. A larger resolution_m takes fewer cells"
            )
            found.append(Problem("fleet map", self.port.resolve(self.options.fleet_map_topic), text))
        if hearing.maps_in and self._said_pose is None and waited:
            found.append(Problem("pose", self.options.base_frame, hearing.why_no_pose()))
        if self.peer.T_fleet_robot is None:
            found.append(Problem("start", self.peer.robot, NO_START))
        return (*found, *self.peer.health())

    def figures(self) -> dict[str, object]:
        """What it has done so far."""
        return {
            "robots in reach": ", ".join(sorted(self._living())) or "none",
            "maps in": self.hearing.maps_in,
            "maps that changed something": self.maps_published,
            "fleet maps out": self.saying.maps_out,
            "fleet map edges": len(self.peer.merged),
            "payload bytes sent": self.peer.stats().bytes_vector,
            "messages refused": self.hearing.refusals,
        }

    def _wake(self) -> None:
        with suppress(RuntimeError):  # the loop is closed: nobody waits any more
            self._loop.call_soon_threadsafe(self._map_came.set)

    def _living(self) -> set[str]:
        return {info.robot for info in self.peer.peers if info.alive}

    async def _publish_maps(self) -> None:
        options = self.options
        while True:
            await self._map_came.wait()
            self._map_came.clear()
            began_s = time.monotonic()
            try:
                grid = await in_thread(self.hearing.latest.take)
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
                pose = self.hearing.pose()
                if pose is not None and (self._said_pose is None or _differs(pose, self._said_pose)):
                    await self.peer.set_pose(pose)
                    self._said_pose = pose
            except ConfigError as error:  # no place on earth
                self.hearing.refuse(self.options.pose_topic or self.options.tf_topic, error)

    async def _watch_merged(self) -> None:
        async for _ in self.peer.changes():
            self._merged_came.set()

    async def _say_merged(self) -> None:
        before = ""
        while True:
            await self._merged_came.wait()
            self._merged_came.clear()
            began_s = time.monotonic()
            # While the start is unknown, the merged map is the own one, in its own frame.
            known = self.peer.T_merged_robot is not None
            merged, frame = self.peer.merged, self.options.fleet_frame if known else self.hearing.map_frame
            if len(merged) and frame and f"{merged.digest} {frame}" != before:
                before = f"{merged.digest} {frame}"
                await in_thread(partial(self.saying.fleet_map, merged, frame))
            await asyncio.sleep(max(0.0, 1 / self.options.fleet_map_rate_hz - (time.monotonic() - began_s)))

    async def _say_frame(self) -> None:
        """Where the own map lies in the fleet: who looks it up wants it fresh."""
        while self.options.publish_tf and self.options.tf_topic:
            # As of the merged map that was said: the fleet's frame may be another one when robots find each other.
            T_fleet_map, map_frame = self.peer.T_merged_robot, self.hearing.map_frame
            if T_fleet_map is not None and map_frame:
                self.saying.frame(T_fleet_map, map_frame)
            await asyncio.sleep(1 / self.options.tf_rate_hz)

    async def _look_after(self) -> None:
        """Say who is where and what is wrong, each second; new problems go to the log, too."""
        peer = self.peer
        while True:
            await asyncio.sleep(WATCH_S)
            if not self.hearing.maps_in:
                self.offered = await in_thread(partial(self.port.topics_of, cdr.MAP))
            self._tell_news()
            found, of_peer = self.problems(), set(peer.health())  # which the peer logs itself
            for problem in found:
                if (problem.kind, problem.robot) not in self._told and problem not in of_peer:
                    logger.warning("%s: %s", peer.robot, problem.text)
            self._told = {(problem.kind, problem.robot) for problem in found}
            if peer.T_fleet_robot is not None:
                await in_thread(partial(self.saying.teammates, peer.teammates(frame="fleet")))
            await in_thread(partial(self.saying.status, peer.robot, peer.fleet, found, self.figures()))

    def _tell_news(self) -> None:
        """The first map, and who comes and goes."""
        if self.hearing.maps_in and not self._told_first:
            self._told_first = True
            self._tell(f"maps come in on {self.hearing.map_topic}, in frame {self.hearing.map_frame}")
        living = self._living()
        for robot in sorted(living - self._seen):
            self._tell(f"{robot} is in reach")
        for robot in sorted(self._seen - living):
            self._tell(f"{robot} is out of reach; its map stays")
        self._seen = living


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
