"""What a peer knows of the others: who they are, and where."""

from __future__ import annotations

from dataclasses import dataclass

from fleetmap.engine import Engine, Stream
from fleetmap.engine.stream import Key
from fleetmap.engine.view import alone
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
    life, seq : its revision that is held, of the life that runs, or of an absent robot the one with the most edges; 0
        if none is
    edges : edges of the maps of all its lives that are held
    lives : how many lives of it are held
    level, T_fleet_robot : as it announced them; None while its place in the fleet's frame is unknown
    """

    robot: str
    alive: bool
    life: int
    seq: int
    edges: int
    lives: int
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
    """All other robots that are known, by name."""
    living = engine.living() - {engine.robot}
    held, placed = streams_of(engine), placed_in(engine)
    infos = []
    for robot in sorted({*held, *living}):
        alive = robot in living
        if robot not in held:
            infos.append(PeerInfo(robot, alive, 0, 0, 0, 0, "", None))
            continue
        stream, *others = held[robot]
        edges = sum(s.edges for s in held[robot])
        T_fleet_robot = placed.get(stream.key)
        life, seq = stream.life, stream.seq
        infos.append(PeerInfo(robot, alive, life, seq, edges, 1 + len(others), stream.level, T_fleet_robot))
    return infos


def streams_of(engine: Engine) -> dict[str, list[Stream]]:
    """By robot, the streams of all others: first the life that runs, then those with more edges."""
    found: dict[str, list[Stream]] = {}
    for stream in engine.holdings.streams():
        if stream.robot != engine.robot:
            found.setdefault(stream.robot, []).append(stream)

    def rank(stream: Stream) -> tuple[bool, int, int]:
        return engine.is_there(stream.key), stream.edges, stream.life

    return {robot: sorted(streams, key=rank, reverse=True) for robot, streams in found.items()}


def maps_of(engine: Engine) -> dict[str, dict[str, VectorMap]]:
    """By robot, the submaps of all others, of the life that runs, or of an absent robot the one with the most edges."""
    return {robot: dict(streams[0].submaps) for robot, streams in streams_of(engine).items()}


def teammate_infos(engine: Engine, *, frame: str, now_s: float) -> list[TeammateInfo]:
    """Robots of the own level whose place in ``frame`` is known, by name."""
    T_frame_fleet, placed = frame_of(engine, frame), placed_in(engine)
    infos = []
    for robot, mate in sorted(dict(engine.teammates.by_name).items()):
        T_fleet_mate = placed.get((robot, mate.life))
        if T_frame_fleet is None or T_fleet_mate is None:
            continue
        T_frame_mate = T_frame_fleet @ T_fleet_mate
        pose = goal_xy = None
        if mate.pose is not None:
            pose = T_frame_mate @ Pose2(*(value * 1e-3 for value in mate.pose))
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
    if is_fleet(frame):
        return Pose2()
    own = placed_in(engine).get(engine.own.key)
    return None if own is None else own.inverse()


def is_fleet(frame: str) -> bool:
    """Whether a user means the fleet's frame, and not the own robot's.

    Raises
    ------
    ConfigError : it is neither
    """
    if frame not in ("robot", "fleet"):
        raise ConfigError(option="frame", value=frame, reason="expected robot or fleet")
    return frame == "fleet"


def placed_in(engine: Engine) -> dict[Key, Pose2]:
    """T_fleet_robot of all streams of the own component; empty while nothing says where that lies, and it has no other.

    The fleet's frame is that of the starts; without any that of the component (``engine.components``).
    """
    components, own = engine.components(), engine.own
    members = components.members(own.key)
    if alone(own, components):
        return {}
    return {key: pose.to_pose() for key in members if (pose := components.pose(key)) is not None}
