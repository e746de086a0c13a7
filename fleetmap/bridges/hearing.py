"""``Hearing``: what a robot's nodes say: its map, and where it is. Bad bytes are refused and counted, on any thread."""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import partial

from fleetmap.bridges import cdr
from fleetmap.bridges.grids import LatestMap
from fleetmap.bridges.options import BridgeOptions
from fleetmap.bridges.port import Port
from fleetmap.bridges.qos import LATCHED, STREAM, Qos
from fleetmap.bridges.transforms import TransformBuffer
from fleetmap.model.errors import FleetmapError, MapFormatError
from fleetmap.model.grid_like import pose_of
from fleetmap.model.pose import Pose2

logger = logging.getLogger(__name__)


class Hearing:
    """The subscriptions of a bridge, and what came on them last.

    Parameters
    ----------
    robot : own name, for the log
    port : the node in the ROS graph, not yet open
    options : topics and frames
    on_map : called when a map or an update came, on any thread

    Attributes
    ----------
    latest : the last map, with its updates
    maps_in : maps and updates that came
    refused : by (topic, reason), messages that were none
    """

    def __init__(self, robot: str, port: Port, options: BridgeOptions, on_map: Callable[[], None]) -> None:
        self._robot, self._port, self._options, self._on_map = robot, port, options, on_map
        self.latest, self._transforms = LatestMap(), TransformBuffer()
        self._pose: tuple[str, Pose2] | None = None
        self.maps_in = 0
        self.refused: dict[tuple[str, str], int] = {}
        self._take(options.map_topic, cdr.MAP, LATCHED, self._take_map)
        updates = options.map_updates_topic or f"{options.map_topic}_updates"
        self._take(updates, cdr.MAP_UPDATE, Qos(depth=10), self._take_update)
        if options.tf_topic:
            self._take(options.tf_topic, cdr.TF, STREAM, partial(self._take_transforms, False))
        if options.tf_static_topic:
            # As many as there may be publishers: each keeps its own transforms.
            latched = Qos(latched=True, depth=100)
            self._take(options.tf_static_topic, cdr.TF, latched, partial(self._take_transforms, True))
        if options.pose_topic:
            self._take(options.pose_topic, cdr.POSE, LATCHED, self._take_pose)

    @property
    def map_topic(self) -> str:
        """Its whole name."""
        return self._port.resolve(self._options.map_topic)

    @property
    def map_frame(self) -> str:
        """The robot's map frame; empty while it isn't known."""
        return self._options.map_frame or self.latest.frame_id

    @property
    def refusals(self) -> int:
        """All messages and transforms that were none."""
        return sum(self.refused.values()) + self._transforms.refused

    def pose(self) -> Pose2 | None:
        """T_map_base, as far as it is known.

        Raises
        ------
        ConfigError : it is no place on earth
        """
        if not self.map_frame:
            return None
        if not self._options.pose_topic:
            found = self._transforms.lookup(self.map_frame, self._options.base_frame)
            return None if found is None else found[0]
        if self._pose is None:
            return None
        frame, pose = self._pose
        if frame in (self.map_frame, ""):
            return pose
        found = self._transforms.lookup(self.map_frame, frame)
        return None if found is None else found[0] @ pose

    def why_no_pose(self) -> str:
        """In words, what is missing."""
        topic = self._options.pose_topic
        if topic:
            return f"no pose on {self._port.resolve(topic)} yet: teammates don't see where this robot is"
        if "tf2_msgs" in self._port.problems():
            return "no pose, as tf2_msgs is not installed: name a topic with pose_topic, as amcl_pose"
        why = self._transforms.why_not(self.map_frame, self._options.base_frame)
        return f"no pose: {why}. Name frames with map_frame and base_frame, or a topic with pose_topic"

    def why_no_map(self, offered: list[str]) -> str:
        """In words, what is missing; ``offered``: topics on which somebody says maps."""
        # What other bridges say is no robot's own map.
        shared = self._options.fleet_map_topic.rsplit("/", 1)[-1]
        if self.map_topic in offered:
            return f"no map on {self.map_topic} yet, though it is offered there: has the mapper said its first one?"
        others = ", ".join(name for name in offered if name.rsplit("/", 1)[-1] != shared)
        if others:
            return f"no map on {self.map_topic} yet; maps are offered on {others}: name one with map_topic or namespace"
        where = self._port.where()
        return f"no map on {self.map_topic} yet, and on no other topic either ({where}): does the mapper run there?"

    def refuse(self, topic: str, error: FleetmapError) -> None:
        """Count a message that was none; the first of its kind goes to the log."""
        key = topic, error.field if isinstance(error, MapFormatError) else "format"
        self.refused[key] = self.refused.get(key, 0) + 1
        if self.refused[key] == 1:
            logger.warning("%s: %s: a message is refused: %s; told once", self._robot, topic, error)

    def _take(self, topic: str, type_name: str, qos: Qos, take: Callable[[str, bytes], None]) -> None:
        whole = self._port.resolve(topic)

        def handle(data: bytes) -> None:
            try:
                take(whole, data)
            except FleetmapError as error:
                self.refuse(whole, error)

        self._port.subscribe(topic, type_name, qos, handle)

    def _take_map(self, topic: str, data: bytes) -> None:
        if self.latest.replace(cdr.decode(data, cdr.MAP, topic=topic)):
            self.maps_in += 1
            self._on_map()

    def _take_update(self, topic: str, data: bytes) -> None:
        if self.latest.update(cdr.decode(data, cdr.MAP_UPDATE, topic=topic)):
            self.maps_in += 1
            self._on_map()

    def _take_transforms(self, static: bool, topic: str, data: bytes) -> None:
        self._transforms.take(cdr.decode(data, cdr.TF, topic=topic).transforms, static=static)

    def _take_pose(self, topic: str, data: bytes) -> None:
        message = cdr.decode(data, cdr.POSE, topic=topic)
        self._pose = str(message.header.frame_id).lstrip("/"), pose_of(message.pose.pose)
