"""What a simulated run is asked for, what it tells while it runs, and what it found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from fleetmap.codecs.names import check_name
from fleetmap.model.errors import ConfigError
from fleetmap.peer.rendezvous import parse_endpoint

HEARTBEAT_S = 2.0
"""Of the robots."""


@dataclass(frozen=True, slots=True)
class SimConfig:
    """One run of a simulated fleet.

    Parameters
    ----------
    out : the run folder; made if missing
    robots : how many
    world : ``maze``, ``office``, ``unstructured``, or a map_server yaml file
    size_m : side of a generated world
    seed : of the world, the starts and all noise
    starts : ``known``: each robot knows where its map frame lies in the fleet's, and they start in one place;
        ``unknown``: none does, and they start anywhere
    hold_s : how long the robots stay joined after they have converged
    range_m, beams, range_noise_m : the lidar
    pose_noise_m : sigma of the believed pose, white, per scan
    radius_m, speed_mps : the robots
    limit_s : simulated time after which exploration ends unfinished
    fleet : its name; None: ``sim``, or where another run has the usual endpoint already, a name of its own
    listen : where others may connect, ``tcp/HOST:PORT``, port 0 for a free one; None: tcp/127.0.0.1:7447, or where that
        is taken and no ``fleet`` is named, a free port
    silent_s : a robot process that doesn't answer for this long is given up, like one that died
    """

    out: Path
    robots: int = 4
    world: str = "office"
    size_m: float = 40.0
    seed: int = 0
    starts: str = "known"
    hold_s: float = 0.0
    range_m: float = 10.0
    beams: int = 720
    range_noise_m: float = 0.02
    pose_noise_m: float = 0.01
    radius_m: float = 0.20
    speed_mps: float = 0.6
    limit_s: float = 7200.0
    silent_s: float = 60.0
    fleet: str | None = None
    listen: str | None = None

    def __post_init__(self) -> None:
        def need(option: str, fits: bool, reason: str) -> None:
            if not fits:
                raise ConfigError(option=option, value=getattr(self, option), reason=reason)

        need("robots", 1 <= self.robots <= 50, "expected 1 to 50")
        need("starts", self.starts in ("known", "unknown"), "expected known or unknown")
        need("seed", self.seed >= 0, "expected 0 or more")
        need("hold_s", 0.0 <= self.hold_s <= 86400.0, "expected 0 to 86400 s")
        need("range_m", 1.0 <= self.range_m <= 100.0, "expected 1 to 100 m")
        need("beams", 90 <= self.beams <= 7200, "expected 90 to 7200")
        need("range_noise_m", 0.0 <= self.range_noise_m <= 0.5, "expected 0 to 0.5 m")
        need("pose_noise_m", 0.0 <= self.pose_noise_m <= 0.5, "expected 0 to 0.5 m")
        need("radius_m", 0.05 <= self.radius_m <= 2.0, "expected 0.05 to 2 m")
        if self.fleet is not None:
            check_name("fleet", self.fleet)
        if self.listen is not None:
            parse_endpoint(self.listen)
        need("speed_mps", 0.05 <= self.speed_mps <= 2.0, "expected 0.05 to 2 m/s")


@dataclass(frozen=True, slots=True)
class RobotProgress:
    """One robot as of the last round.

    Parameters
    ----------
    robot, pid : its name and its process
    state : ``exploring``, ``idle`` (nothing left to do, or teammates are at it) or ``dead``
    t_s : simulated time
    x_m, y_m : where it really is (world frame)
    covered : share of the reachable cells that it knows to be free, from a sample
    distance_m, collisions, published : since the start
    bytes_vector, bytes_deltas, bytes_grid_gzip_full, bytes_grid_gzip_updates, bytes_grid_exact_updates : sent so
        far, and what grids would have cost
    sent, grids : the same by kind and by name: messages, bytes, segments
    explored_m2 : free floor in its own grid
    members : robots whose maps are in its merged one, its own among them
    trail_xy : where it has been since the round before (world frame)
    frame : whose map frame its merged map is in; None: the world's
    T_merged_robot : (x, y, yaw) of its own map frame in that
    """

    robot: str
    pid: int
    state: str = "starting"
    t_s: float = 0.0
    x_m: float = 0.0
    y_m: float = 0.0
    covered: float = 0.0
    distance_m: float = 0.0
    collisions: int = 0
    published: int = 0
    bytes_vector: int = 0
    bytes_deltas: int = 0
    bytes_grid_gzip_full: int = 0
    bytes_grid_gzip_updates: int = 0
    bytes_grid_exact_updates: int = 0
    sent: Mapping[str, Sequence[int]] = field(default_factory=dict)
    grids: Mapping[str, Sequence[int]] = field(default_factory=dict)
    explored_m2: float = 0.0
    members: int = 1
    trail_xy: tuple[tuple[float, float], ...] = ()
    frame: str | None = None
    T_merged_robot: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Progress:
    """The fleet as of the last round.

    ``phase`` is ``starting``, ``exploring``, ``converging``, ``reporting`` or ``holding``; ``fleet`` and ``endpoint``
    are what others need to join or watch it.
    """

    phase: str
    t_s: float
    endpoint: str
    robots: tuple[RobotProgress, ...]
    fleet: str = ""


@dataclass(frozen=True, slots=True)
class Death:
    """A robot process that ended or fell silent before the run was over."""

    robot: str
    t_s: float
    """Simulated time."""
    wall_s: float
    """Since the run began."""
    reason: str


@dataclass(frozen=True, slots=True)
class SimResult:
    """What a run found; ``document`` is what ``stats.json`` and ``fleetmap sim --json`` hold."""

    out: Path
    document: dict[str, object] = field(repr=False)
