"""The options of the bridge: named, typed, given defaults, explained and checked here, and nowhere else.

The command line, the parameters of the rclpy node and parameter files are made from these fields.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, Field, dataclass, field, fields
from typing import Any

from fleetmap.bridges.dialect import Dialect
from fleetmap.bridges.names import check_frame, check_namespace, check_node, check_topic
from fleetmap.bridges.rmw_zenoh import RmwZenoh
from fleetmap.bridges.ros2dds import Ros2Dds
from fleetmap.model.checks import as_number, check_number
from fleetmap.model.errors import ConfigError
from fleetmap.model.grid import check_thresholds
from fleetmap.model.pose import FixedPose, Pose2
from fleetmap.peer.endpoints import check_endpoints
from fleetmap.peer.options import JoinOptions
from fleetmap.peer.settings import read_config

DIALECTS = ("rmw_zenoh", "ros2dds")
MAX_DOMAIN = 232
HOW_TO_START = "expected X,Y,YAW in metres and radians, as 2,1,1.5708"


def option(default: Any, about: str) -> Any:
    """A field with what it is for."""
    return field(default=default, metadata={"about": about})


@dataclass(frozen=True, slots=True)
class BridgeOptions:
    """One robot between ROS 2 and its fleet, whichever way ROS is reached. Topics are relative to the node's namespace.

    Raises
    ------
    ConfigError : an option has an impossible value
    """

    robot: str = option("", "Own name in the fleet: A-Z a-z 0-9 _ . -")
    _: KW_ONLY
    fleet: str = option("default", "Robots of one fleet share their maps.")
    level: str = option("0", "Storey; maps of different levels are never merged.")
    start: str | Sequence[float] = option(
        "", "Where the robot's map frame lies in the fleet's: X,Y,YAW, metres and radians."
    )
    connect: Sequence[str] = option((), "Where another robot of the fleet listens, as tcp/10.0.0.2:7448.")
    listen: Sequence[str] = option((), "Where other robots may connect, as tcp/0.0.0.0:7448.")
    profile: str = option("lan", "lan, local (no multicast), or narrow (slow radios).")
    config: str = option("", "A JSON file of further Zenoh settings of the fleet's session, as certificates.")
    budget_bps: float = option(0.0, "Payload bytes a second that map updates may take; 0: no limit.")

    map_topic: str = option("map", "The robot's map: nav_msgs/OccupancyGrid.")
    map_updates_topic: str = option("", "Its updates: map_msgs/OccupancyGridUpdate; empty: MAP_TOPIC_updates.")
    map_rate_hz: float = option(2.0, "At most so many maps a second are taken in; the newest counts.")
    free_below: float = option(20.0, "Per cent; cells below are free.")
    occupied_above: float = option(64.0, "Per cent; cells above are occupied.")
    tf_topic: str = option("/tf", "Transforms; in and out. Empty: none.")
    tf_static_topic: str = option("/tf_static", "Static transforms.")
    pose_topic: str = option("", "The pose as PoseWithCovarianceStamped, as amcl_pose, instead of transforms.")
    map_frame: str = option("", "The robot's map frame; empty: the frame of its maps.")
    base_frame: str = option("base_link", "The frame that is the robot.")

    fleet_frame: str = option("fleet", "The fleet's frame.")
    fleet_map_topic: str = option("fleet_map", "The fleet's map, latched.")
    fleet_map_rate_hz: float = option(1.0, "At most so many fleet maps a second.")
    fleet_map_updates: bool = option(False, "Also say what changed as FLEET_MAP_TOPIC_updates.")
    resolution_m: float = option(0.0, "Cell of the fleet's map; 0: that of the finest map in it.")
    markers_topic: str = option("fleet_walls", "Walls and frontiers as MarkerArray, latched. Empty: none.")
    teammates_topic: str = option("fleet_robots", "Teammates as PoseArray, and TOPIC_names. Empty: none.")
    diagnostics_topic: str = option("/diagnostics", "What is wrong, as DiagnosticArray. Empty: none.")
    publish_tf: bool = option(True, "Say where the map frame lies in the fleet's on TF_TOPIC.")
    tf_rate_hz: float = option(10.0, "How often.")

    def __post_init__(self) -> None:
        for name in ("map_rate_hz", "fleet_map_rate_hz", "tf_rate_hz"):
            check_number(name, getattr(self, name), expected="0.01 to 1000 a second", fits=lambda hz: 0.01 <= hz <= 1e3)
        self.join_options()  # checks what is the fleet's
        for name in ("map_topic", "fleet_map_topic"):
            check_topic(name, getattr(self, name))
        for name in (
            "map_updates_topic",
            "tf_topic",
            "tf_static_topic",
            "pose_topic",
            "markers_topic",
            "teammates_topic",
            "diagnostics_topic",
        ):
            check_topic(name, getattr(self, name), may_be_empty=True)
        for name in ("base_frame", "fleet_frame"):
            check_frame(name, getattr(self, name))
        check_frame("map_frame", self.map_frame, may_be_empty=True)
        check_number("resolution_m", self.resolution_m, expected="metres, or 0", fits=lambda m: m == 0 or m >= 0.005)
        check_thresholds(self.free_below, self.occupied_above)
        check_flags(self, "fleet_map_updates", "publish_tf")

    def join_options(self) -> JoinOptions:
        """What the robot joins the fleet with."""
        check_number("budget_bps", self.budget_bps, expected="bytes a second, 0 or more", fits=lambda b: b >= 0)
        return JoinOptions(
            self.robot,
            fleet=self.fleet,
            level=self.level,
            start=parse_start(self.start),
            connect=tuple(self.connect),
            listen=tuple(self.listen),
            profile=self.profile,
            config=read_config(self.config) if self.config else None,
            budget_Bps=self.budget_bps or None,
            # What a grid would have cost takes longer to count than the map takes to send.
            baselines=False,
            fold_interval_s=1 / self.fleet_map_rate_hz,
        )


@dataclass(frozen=True, slots=True)
class WireOptions:
    """How ROS is reached without ROS, over Zenoh.

    Raises
    ------
    ConfigError : an option has an impossible value
    """

    via: str = option("rmw_zenoh", "rmw_zenoh, or ros2dds: zenoh-bridge-ros2dds beside nodes on DDS.")
    humble: bool = option(False, "With rmw_zenoh: speak to nodes of Humble, which know no type hashes.")
    ros_endpoint: str = option("tcp/127.0.0.1:7447", "The router (or bridge) beside the robot.")
    ros_listen: str = option("", "Be that router oneself, here, as tcp/127.0.0.1:7447: no ROS has to be installed.")
    domain: int = option(-1, "ROS_DOMAIN_ID; -1: of the environment, else 0.")
    namespace: str = option("/", "Of the node, as /r1.")
    node: str = option("fleetmap", "Its name.")
    use_sim_time: bool = option(False, "Take the time from /clock.")

    def __post_init__(self) -> None:
        if self.via not in DIALECTS:
            raise ConfigError(option="via", value=self.via, reason=f"expected one of {', '.join(DIALECTS)}")
        check_endpoints("ros_endpoint", [self.ros_endpoint])
        check_endpoints("ros_listen", [self.ros_listen] if self.ros_listen else [])
        check_namespace("namespace", self.namespace)
        check_node("node", self.node)
        check_flags(self, "humble", "use_sim_time")
        self.dialect()

    def dialect(self) -> Dialect:
        """Who is spoken to."""
        if self.via == "ros2dds":
            return Ros2Dds()
        return RmwZenoh(_domain(self.domain), humble=self.humble)


def check_flags(options: object, *names: str) -> None:
    """Refuse what is neither true nor false.

    Raises
    ------
    ConfigError : names it
    """
    for name in names:
        if not isinstance(getattr(options, name), bool):
            raise ConfigError(option=name, value=getattr(options, name), reason="expected true or false")


def parse_start(start: str | Sequence[float]) -> Pose2 | None:
    """X,Y,YAW as text or numbers; None if there are none.

    Raises
    ------
    ConfigError : these are not three numbers
    """
    listed: object = start.split(",") if isinstance(start, str) else start
    if not isinstance(listed, Sequence):
        raise ConfigError(option="start", value=start, reason=HOW_TO_START)
    parts: list[object] = [part.strip() if isinstance(part, str) else part for part in listed]
    if parts in ([], [""]):
        return None
    numbers = []
    for part in parts:
        try:
            number = as_number(float(part) if isinstance(part, str) else part)
        except ValueError:
            number = None
        if number is not None and math.isfinite(number):
            numbers.append(number)
    if len(parts) != 3 or len(numbers) != 3:
        raise ConfigError(option="start", value=start, reason=HOW_TO_START)
    pose = Pose2(*numbers)
    try:
        FixedPose.from_pose(pose)
    except ConfigError as error:
        raise ConfigError(option="start", value=start, reason=error.reason) from None
    return pose


def options_of(kind: type[Any]) -> list[Field[Any]]:
    """The fields of BridgeOptions or WireOptions, in order."""
    return [f for f in fields(kind) if "about" in f.metadata]


def checked(kind: type[Any], values: Mapping[str, object]) -> dict[str, Any]:
    """Those of the values that are options of that kind, each of its default's type.

    Raises
    ------
    ConfigError : a value has another type
    """
    found = {}
    for f in options_of(kind):
        if f.name in values:
            found[f.name] = _of_type(f, values[f.name])
    return found


def _of_type(f: Field[Any], value: object) -> object:
    if f.name == "start":
        return value if isinstance(value, str) else list(value) if isinstance(value, Sequence) else _refused(f, value)
    if isinstance(f.default, bool):
        return value if isinstance(value, bool) else _refused(f, value)
    if isinstance(f.default, int | float):
        number = as_number(value)
        whole = isinstance(f.default, int)
        if number is None or (whole and number != int(number)):
            return _refused(f, value)
        return int(number) if whole else number
    if isinstance(f.default, str):
        # YAML reads level: 0 as a number.
        text = str(value) if isinstance(value, int) and not isinstance(value, bool) else value
        return text if isinstance(text, str) else _refused(f, value)
    listed = [value] if isinstance(value, str) else value
    if isinstance(listed, Sequence) and all(isinstance(each, str) for each in listed):
        return [each for each in listed if each]
    return _refused(f, value)


def _refused(f: Field[Any], value: object) -> object:
    kinds = {bool: "true or false", int: "a whole number", float: "a number", str: "text", tuple: "a list of text"}
    raise ConfigError(option=f.name, value=value, reason=f"expected {kinds[type(f.default)]}")


def _domain(domain: int) -> int:
    value: object = domain
    if domain == -1:
        value = os.environ.get("ROS_DOMAIN_ID") or "0"
        value = int(value) if isinstance(value, str) and value.isdecimal() else value
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value <= MAX_DOMAIN:
        reason = f"expected ROS_DOMAIN_ID, 0 to {MAX_DOMAIN}"
        raise ConfigError(option="domain", value=value, reason=reason)
    return value
