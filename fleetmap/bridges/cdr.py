"""ROS 2 messages as bytes: the types that are spoken here, their hashes, and CDR by rosbags."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Any

from fleetmap.model.errors import ConfigError, WireError
from fleetmap.model.grid import MAX_CELLS

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

CLOCK = "rosgraph_msgs/msg/Clock"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
MAP = "nav_msgs/msg/OccupancyGrid"
MAP_UPDATE = "map_msgs/msg/OccupancyGridUpdate"
MARKERS = "visualization_msgs/msg/MarkerArray"
POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
POSES = "geometry_msgs/msg/PoseArray"
TEXT = "std_msgs/msg/String"
TF = "tf2_msgs/msg/TFMessage"
WHOLE_NUMBER = "std_msgs/msg/UInt64"

HASHES = {
    CLOCK: "RIHS01_692f7a66e93a3c83e71765d033b60349ba68023a8c689a79e48078bcb5c58564",
    DIAGNOSTICS: "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
    MAP: "RIHS01_8d348150c12913a31ee0ec170fbf25089e4745d17035792a1ba94d6f0bc0cfc7",
    MAP_UPDATE: "RIHS01_c4095b0be2e4363f8978a1570e0293ee093436f1e1c61d99b48502ac317025e8",
    MARKERS: "RIHS01_86cb8800b6fb05b5eff1abd7a56f62a5641d3ae9a1c29e78e67e704f1d067dcf",
    POSE: "RIHS01_26432f9803e43727d3c8f668d1fdb3c630f548af631e2f4e31382371bfea3b6e",
    POSES: "RIHS01_af0cc36d190e104d546d168d6b39df04fa4b4ccecf59cb4c9ed328d3d5004aa0",
    TEXT: "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    TF: "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
    WHOLE_NUMBER: "RIHS01_fbdc52018fc13755dce18024d1a671c856aa8b4aaf63adfb095b608f98e8c943",
}
"""Type -> hash (REP 2011). Equal in Jazzy, Kilted and Lyrical; Humble has none."""

MAP_UPDATE_TEXT = """\
std_msgs/Header header
int32 x
int32 y
uint32 width
uint32 height
int8[] data
"""
"""map_msgs is in no store of rosbags."""

MAX_MESSAGE_BYTES = MAX_CELLS + 4096
"""The largest grid, and all that stands before its cells."""
MAX_SMALL_BYTES = 4 << 20
"""All other messages: of many small parts, they take a dozen times as much once they are read."""

MAX_NS = (2**31 - 1) * 10**9 + 10**9 - 1
CDR_HEADERS = (b"\x00\x00", b"\x00\x01")
"""Plain CDR, big and little endian; two bytes of options follow."""


@functools.cache
def typestore() -> Typestore:
    """All types that are spoken here.

    Raises
    ------
    ConfigError : rosbags is not installed
    """
    try:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError:
        raise missing("rosbags") from None
    store = get_typestore(Stores.ROS2_KILTED)
    store.register(get_types_from_msg(MAP_UPDATE_TEXT, MAP_UPDATE))
    return store


def missing(package: str) -> ConfigError:
    """The error for a package that isn't installed."""
    return ConfigError(option="ros", value=package, reason="missing: pip install 'fleetmap[ros]'")


def make(type_name: str, **fields: Any) -> Any:
    """A message, or part of one: ``make("geometry_msgs/msg/Point", x=1.0, y=2.0, z=0.0)``."""
    return typestore().types[type_name](**fields)


def encode(message: Any, type_name: str) -> bytes:
    """The message as little-endian CDR, with the four bytes that say so."""
    return bytes(typestore().serialize_cdr(message, type_name))


def decode(data: bytes, type_name: str, *, topic: str) -> Any:
    """The message in some bytes of anybody. Arrays of numbers are views of ``data``.

    Raises
    ------
    WireError : these are no such message; nothing else leaves
    """
    most = MAX_MESSAGE_BYTES if type_name in (MAP, MAP_UPDATE) else MAX_SMALL_BYTES
    if len(data) > most:
        raise WireError(robot=topic, size_bytes=len(data), reason=f"longer than {most} B")
    if data[:2] not in CDR_HEADERS:
        raise WireError(robot=topic, size_bytes=len(data), reason=f"no plain CDR: it begins with {data[:4].hex()}")
    try:
        return typestore().deserialize_cdr(data, type_name)
    except Exception as error:  # whatever rosbags has against bytes that may be anything
        reason = f"no {type_name}: {type(error).__name__} {error}".strip()
        raise WireError(robot=topic, size_bytes=len(data), reason=reason) from None


def time_of(stamp_ns: int) -> Any:
    """A time of ROS; what doesn't fit is the last one that does."""
    stamp_ns = min(max(stamp_ns, 0), MAX_NS)
    return make("builtin_interfaces/msg/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)


def ns_of(stamp: Any) -> int:
    """Nanoseconds of a time of ROS."""
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def header(frame_id: str, stamp_ns: int) -> Any:
    """A header."""
    return make("std_msgs/msg/Header", stamp=time_of(stamp_ns), frame_id=frame_id)
