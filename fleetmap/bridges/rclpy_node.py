"""The bridge as an rclpy node, for any RMW: ``python -m fleetmap.bridges.rclpy_node --ros-args -p robot:=r1``.

Thin: messages go in and out as the CDR that the middleware carries, so that all else is ``ros2.Bridge``. Its options
are the node's parameters. rclpy is imported here, and only here.
"""

from __future__ import annotations

import asyncio
import importlib
import logging
import signal
import sys
import threading
from dataclasses import Field
from typing import Any

import rclpy
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

from fleetmap.bridges import cdr
from fleetmap.bridges.options import BridgeOptions, checked, options_of
from fleetmap.bridges.port import Say, Take
from fleetmap.bridges.qos import Qos
from fleetmap.bridges.ros2 import Bridge
from fleetmap.model.errors import ConfigError, FleetmapError
from fleetmap.peer.join import make_peer

HELP = """\
A ROS 2 robot's map in, its fleet's map out: the bridge of fleetmap as an rclpy node, until Ctrl-C.

For instance:

  python -m fleetmap.bridges.rclpy_node --ros-args -r __ns:=/r1 -p robot:=r1 -p start:="'0,0,0'"

Parameters:
"""
OF_ROS = ("use_sim_time", "start_type_description_service", "qos_overrides")
"""Parameters that each node has."""


class RclpyPort:
    """A node of rclpy; see ``Port``. Types whose package isn't installed are left out, and said so."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._own: set[str] = set()
        self._missing: dict[str, str] = {}
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        self._thread = threading.Thread(target=self._spin, name="fleetmap-rclpy", daemon=True)
        self._closed = threading.Event()

    def resolve(self, topic: str) -> str:
        """The whole name of a topic, remapped as the node was told."""
        return str(self._node.resolve_topic_name(topic))

    def subscribe(self, topic: str, type_name: str, qos: Qos, take: Take) -> None:
        """Have ``take`` called with each message of a topic, on the node's own thread."""
        kind = self._type(type_name)
        if kind is not None:
            self._node.create_subscription(kind, topic, take, profile(qos), raw=True)

    def advertise(self, topic: str, type_name: str, qos: Qos) -> Say:
        """Offer a topic; returns what publishes on it."""
        kind = self._type(type_name)
        if kind is None:
            return lambda data: None
        publisher = self._node.create_publisher(kind, topic, profile(qos))
        self._own.add(self.resolve(topic))

        def say(data: bytes) -> None:
            if not self._closed.is_set():
                publisher.publish(data)

        return say

    def topics_of(self, type_name: str) -> list[str]:
        """Topics of that type that somebody else offers now."""
        found = self._node.get_topic_names_and_types()
        return sorted(name for name, types in found if type_name in types and self._offered(name))

    def now_ns(self) -> int:
        """ROS time."""
        return int(self._node.get_clock().now().nanoseconds)

    def problems(self) -> dict[str, str]:
        """Packages that are missing."""
        return {
            package: f"{name} is left out: the package {package} is not installed"
            for name, package in self._missing.items()
        }

    def is_reached(self) -> bool:
        """A node always is."""
        return True

    def where(self) -> str:
        """The domain."""
        return f"ROS_DOMAIN_ID {self._node.context.get_domain_id()}"

    async def open(self) -> None:
        """Begin to take what comes."""
        self._thread.start()

    async def close(self) -> None:
        """End the thread; the node stays."""
        self._closed.set()
        self._executor.shutdown(timeout_sec=0.5)

    def _offered(self, topic: str) -> bool:
        return int(self._node.count_publishers(topic)) > (topic in self._own)

    def _type(self, type_name: str) -> Any:
        package, _, name = type_name.split("/")
        try:
            return getattr(importlib.import_module(f"{package}.msg"), name)
        except ImportError:
            self._missing[type_name] = package
            return None

    def _spin(self) -> None:
        try:
            while not self._closed.is_set():
                self._executor.spin_once(timeout_sec=0.2)
        except ExternalShutdownException:
            return


def profile(qos: Qos) -> QoSProfile:
    """The same quality of service as rclpy has it."""
    return QoSProfile(
        depth=qos.depth,
        reliability=ReliabilityPolicy.RELIABLE if qos.reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if qos.latched else DurabilityPolicy.VOLATILE,
    )


def declare(node: Node) -> BridgeOptions:
    """The options as the node's parameters say, which it has from its overrides, or are declared now.

    Raises
    ------
    ConfigError : one has an impossible value, or there is no such parameter
    """
    known = {f.name: f for f in options_of(BridgeOptions)}
    for name in node.get_parameters_by_prefix(""):
        if name not in known and not name.startswith(OF_ROS):
            reason = f"there is no such parameter; expected one of {', '.join(known)}"
            raise ConfigError(option=name, value=node.get_parameter(name).value, reason=reason)
    given = {}
    for f in known.values():
        if not node.has_parameter(f.name):
            node.declare_parameter(f.name, _default(f), _descriptor(f))
        value = node.get_parameter(f.name).value
        if value is not None:
            given[f.name] = list(value) if isinstance(f.default, tuple) and not isinstance(value, str) else value
    return BridgeOptions(**checked(BridgeOptions, given))


def help_text() -> str:
    """What ``--help`` prints: the parameters."""
    lines = [f"  {f.name:20} {f.metadata['about']} [{f.default!r}]" for f in options_of(BridgeOptions)]
    return "\n".join([HELP, *lines])


def main(arguments: list[str] | None = None) -> int:
    """Run the node until Ctrl-C; returns the exit code."""
    if {"-h", "--help"} & set(sys.argv[1:] if arguments is None else arguments):
        sys.stdout.write(help_text() + "\n")
        return 0
    logging.basicConfig(level=logging.WARNING, format="[%(levelname)s] %(message)s")
    rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    # As ROS's own nodes: who launched it may end it by SIGTERM just as well.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        node = Node("fleetmap", automatically_declare_parameters_from_overrides=True)
        try:
            asyncio.run(_serve(node, declare(node)))
        finally:
            node.destroy_node()
    except FleetmapError as error:
        logging.getLogger(__name__).error("%s", error)
        return 1
    except KeyboardInterrupt:
        return 130
    finally:
        rclpy.try_shutdown()
    return 0


async def _serve(node: Node, options: BridgeOptions) -> None:
    cdr.typestore()
    async with make_peer(options.join_options()) as peer:
        await Bridge(peer, RclpyPort(node), options, node.get_logger().info).run()


def _default(f: Field[Any]) -> Any:
    return list(f.default) if isinstance(f.default, tuple) else f.default


def _descriptor(f: Field[Any]) -> ParameterDescriptor:
    # A list without entries has no type in ROS, and start may be text or numbers.
    free = isinstance(f.default, tuple) or f.name in ("start", "level", "robot", "fleet")
    return ParameterDescriptor(description=f.metadata["about"], dynamic_typing=free)


if __name__ == "__main__":
    sys.exit(main())
