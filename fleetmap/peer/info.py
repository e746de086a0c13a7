"""What a peer knows of the others: who they are, and where."""

from __future__ import annotations

from dataclasses import dataclass

from fleetmap.engine import Engine
from fleetmap.model.errors import ConfigError
from fleetmap.model.pose import Pose2
from fleetmap.model.vectormap import VectorMap


@dataclass(frozen=True, slots=True)
class PeerInfo:
    """A robot that is known.

    Parameters
    ----------
    robot : its name
    alive : False for an absent one, whose map stays
    epoch, seq : its latest revision that is held; 0 if none is
    edges : edges of its maps
    level, T_fleet_robot : as it announced them; None while its place in the fleet's frame is unknown
    """

    robot: str
    alive: bool
    epoch: int
    seq: int
    edges: int
    level: str
    T_fleet_robot: Pose2 | None


@dataclass(frozen=True, slots=True)
class TeammateInfo:
    """A living robot's last pose and goal, None where it announced none; ``age_s`` since it last did."""

    robot: str
    pose: Pose2 | None
    goal_xy: tuple[float, float] | None
    age_s: float


def peer_infos(engine: Engine) -> list[PeerInfo]:
    """All other robots that are known, by name, each with its latest epoch."""
    latest = {s.robot: s for s in engine.holdings.streams() if s.robot != engine.robot}
    infos = []
    for robot in sorted({*latest, *list(engine.alive)}):
        stream, alive = latest.get(robot), robot in engine.alive
        if stream is None:
            infos.append(PeerInfo(robot, alive, 0, 0, 0, "", None))
            continue
        start = stream.header.start
        T_fleet_robot = None if start is None else start.to_pose()
        infos.append(PeerInfo(robot, alive, stream.epoch, stream.seq, stream.edges, stream.header.level, T_fleet_robot))
    return infos


def maps_of(engine: Engine) -> dict[str, dict[str, VectorMap]]:
    """By robot, the submaps of all others, of their latest epoch."""
    latest = {s.robot: s for s in engine.holdings.streams() if s.robot != engine.robot}
    return {robot: {name: s.vector_map for name, s in stream.submaps.items()} for robot, stream in latest.items()}


def teammate_infos(engine: Engine, *, frame: str, now_s: float) -> list[TeammateInfo]:
    """Robots of the own level whose place in ``frame`` is known, by name."""
    T_frame_fleet = frame_of(engine, frame)
    infos = []
    for robot, mate in sorted(dict(engine.teammates.by_name).items()):
        replica = engine.holdings.replicas.get((robot, mate.epoch))
        header = replica.stream.header if replica else None
        if T_frame_fleet is None or header is None or header.start is None or header.level != engine.own.header.level:
            continue
        T_frame_mate = T_frame_fleet @ header.start.to_pose()
        pose = goal_xy = None
        if mate.pose is not None:
            pose = T_frame_mate @ Pose2(mate.pose.x_mm * 1e-3, mate.pose.y_mm * 1e-3, mate.pose.yaw_mrad * 1e-3)
        if mate.goal_mm is not None:
            x, y = T_frame_mate.apply((mate.goal_mm[0] * 1e-3, mate.goal_mm[1] * 1e-3))
            goal_xy = (float(x), float(y))
        infos.append(TeammateInfo(robot, pose, goal_xy, max(0.0, now_s - mate.heard_s)))
    return infos


def frame_of(engine: Engine, frame: str) -> Pose2 | None:
    """``T_frame_fleet`` of a frame that a user names; None if it is not known yet.

    Raises
    ------
    ConfigError : the frame is neither ``robot`` nor ``fleet``
    """
    if frame == "fleet":
        return Pose2()
    if frame != "robot":
        raise ConfigError(option="frame", value=frame, reason="expected robot or fleet")
    start = engine.own.header.start
    return None if start is None else start.to_pose().inverse()
