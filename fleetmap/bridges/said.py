"""What the bridge says to ROS beside grids: walls and frontiers, teammates, the fleet's frame, and what is wrong."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fleetmap.bridges import cdr
from fleetmap.bridges.grids import pose_message, quaternion
from fleetmap.model.mergedmap import MergedMap
from fleetmap.model.pose import Pose2
from fleetmap.peer import TeammateInfo
from fleetmap.peer.health import Problem

ADD, LINE_LIST, TEXT = 0, 5, 9
"""Of visualization_msgs/Marker."""
OK, WARN = 0, 1
"""Of diagnostic_msgs/DiagnosticStatus."""

WALL_RGBA, FRONTIER_RGBA, NAME_RGBA = (0.1, 0.12, 0.15, 1.0), (0.94, 0.63, 0.23, 1.0), (0.18, 0.44, 0.69, 1.0)
LINE_M = 0.03
LETTER_M = 0.3
NAME_S = 3
"""How long a viewer shows a name that isn't said again."""


def walls(merged: MergedMap, *, frame_id: str, stamp_ns: int) -> Any:
    """The merged map's walls and frontiers as lines."""
    parts = [
        _lines("walls", merged.segments_xy[merged.obstacle], WALL_RGBA, frame_id, stamp_ns),
        _lines("frontiers", merged.segments_xy[merged.frontier], FRONTIER_RGBA, frame_id, stamp_ns),
    ]
    return cdr.make(cdr.MARKERS, markers=parts)


def names(teammates: Iterable[TeammateInfo], *, frame_id: str, stamp_ns: int) -> Any:
    """The teammates' names where they are, for some seconds."""
    parts = []
    for number, mate in enumerate(teammates):
        if mate.pose is not None:
            name = _marker("robots", number, TEXT, frame_id, stamp_ns, NAME_RGBA, scale=(0.0, 0.0, LETTER_M))
            name.pose, name.text = pose_message(mate.pose), mate.robot
            name.lifetime = cdr.make("builtin_interfaces/msg/Duration", sec=NAME_S, nanosec=0)
            parts.append(name)
    return cdr.make(cdr.MARKERS, markers=parts)


def poses(teammates: Iterable[TeammateInfo], *, frame_id: str, stamp_ns: int) -> Any:
    """Where the teammates are."""
    there = [pose_message(mate.pose) for mate in teammates if mate.pose is not None]
    return cdr.make(cdr.POSES, header=cdr.header(frame_id, stamp_ns), poses=there)


def transform(T_parent_child: Pose2, *, parent: str, child: str, stamp_ns: int) -> Any:
    """One transform, as ``/tf`` carries it."""
    shift = cdr.make("geometry_msgs/msg/Vector3", x=T_parent_child.x_m, y=T_parent_child.y_m, z=0.0)
    turn = quaternion(T_parent_child.yaw_rad)
    stamped = cdr.make(
        "geometry_msgs/msg/TransformStamped",
        header=cdr.header(parent, stamp_ns),
        child_frame_id=child,
        transform=cdr.make("geometry_msgs/msg/Transform", translation=shift, rotation=turn),
    )
    return cdr.make(cdr.TF, transforms=[stamped])


def diagnostics(
    robot: str, fleet: str, problems: Sequence[Problem], values: Mapping[str, object], *, stamp_ns: int
) -> Any:
    """One status: OK, or a warning that says what is wrong; with figures beside it."""
    first = (
        f"{problems[0].text}" + (f" (and {len(problems) - 1} more)" if len(problems) > 1 else "") if problems else ""
    )
    pairs = {**{f"{problem.kind} {problem.robot}".strip(): problem.text for problem in problems}, **values}
    status = cdr.make(
        "diagnostic_msgs/msg/DiagnosticStatus",
        level=WARN if problems else OK,
        name=f"fleetmap: {robot} in {fleet}",
        message=first or "in the fleet",
        hardware_id=robot,
        values=[cdr.make("diagnostic_msgs/msg/KeyValue", key=key, value=str(value)) for key, value in pairs.items()],
    )
    return cdr.make(cdr.DIAGNOSTICS, header=cdr.header("", stamp_ns), status=[status])


def _lines(
    namespace: str, segments_xy: NDArray[np.float64], rgba: tuple[float, ...], frame_id: str, stamp_ns: int
) -> Any:
    marker = _marker(namespace, 0, LINE_LIST, frame_id, stamp_ns, rgba, scale=(LINE_M, 0.0, 0.0))
    point = cdr.typestore().types["geometry_msgs/msg/Point"]
    marker.points = [point(x=x, y=y, z=0.0) for x, y in segments_xy.reshape(-1, 2).tolist()]
    return marker


def _marker(
    namespace: str,
    number: int,
    kind: int,
    frame_id: str,
    stamp_ns: int,
    rgba: tuple[float, ...],
    *,
    scale: tuple[float, float, float],
) -> Any:
    (x, y, z), (r, g, b, a) = scale, rgba
    nothing = np.zeros(0, np.uint8)
    return cdr.make(
        "visualization_msgs/msg/Marker",
        header=cdr.header(frame_id, stamp_ns),
        ns=namespace,
        id=number,
        type=kind,
        action=ADD,
        pose=pose_message(Pose2()),
        scale=cdr.make("geometry_msgs/msg/Vector3", x=x, y=y, z=z),
        color=cdr.make("std_msgs/msg/ColorRGBA", r=r, g=g, b=b, a=a),
        lifetime=cdr.make("builtin_interfaces/msg/Duration", sec=0, nanosec=0),
        frame_locked=False,
        points=[],
        colors=[],
        texture_resource="",
        texture=cdr.make("sensor_msgs/msg/CompressedImage", header=cdr.header("", 0), format="", data=nothing),
        uv_coordinates=[],
        text="",
        mesh_resource="",
        mesh_file=cdr.make("visualization_msgs/msg/MeshFile", filename="", data=nothing),
        mesh_use_embedded_materials=False,
    )
