"""The options of ``join``: named, typed, given defaults and checked here, and nowhere else."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import ParamSpec, TypeVar

from fleetmap.codecs.names import check_name
from fleetmap.engine.holdings import MAX_EDGES_HELD
from fleetmap.engine.stream import Limits
from fleetmap.model.checks import check_count, check_number, check_type
from fleetmap.model.density import MAX_EDGES, MAX_EDGES_IN_SQUARE
from fleetmap.model.errors import ConfigError
from fleetmap.model.pose import FixedPose, Pose2
from fleetmap.peer.link import Link
from fleetmap.peer.profiles import zenoh_settings

P = ParamSpec("P")
R = TypeVar("R")

IF_TAKEN = ("refuse", "join")
HOW_TO_POSE = "write Pose2(x_m, y_m, yaw_rad)"


@dataclass(frozen=True, slots=True)
class JoinOptions:
    """What a robot may say when it joins.

    Parameters
    ----------
    robot : own name, 1 to 64 of A-Z a-z 0-9 _ . -; each living robot of the fleet should have one of its own
    fleet : robots of one fleet share their maps
    level : storey; frames of different levels are never merged
    start : T_fleet_robot, where the robot's map frame lies in the fleet's, up to 17592 km from its origin; None if that
        is unknown; a ``FixedPose`` counts to the last bit. Whether the maps of the others are near is checked when this
        robot publishes
    start_sigma : how exact the start is: standard deviations along each axis, in metres, and of the yaw, in radians.
        Where maps that overlap say otherwise, they are believed; with (0, 0) of both robots they aren't asked
    connect, listen : Zenoh endpoints, as ``tcp/10.0.0.2:7447``
    profile : ``lan`` finds peers by multicast and by ``connect``; ``local`` by ``connect`` alone; ``narrow``, for slow
        radios, too, and says as little as it can while nothing changes
    config : further Zenoh settings, configuration key -> value; they override the profile's
    budget_Bps : payload bytes a second that updates of the own map may take, on average. Who publishes more often than
        that allows sends the difference to the last update that went, once it may; never a queue of old ones
    max_rate_hz : at most so many updates a second
    heartbeat_s : how often the own revision is announced while nothing changes; None: 10 s, or 60 s with ``narrow``. A
        pose or a goal that changes is announced up to 20 times as often
    fold_interval_s : at least so long between two folds that nobody waits for
    baselines : count at each publish what the grid would have cost, gzipped
    if_taken : what to do if a living peer has this name and answers: ``refuse`` raises ``NameInUse``; ``join`` is
        another life beside it, as for a robot whose hung former process still answers
    allow : names that are listened to; None: all
    max_edges, max_edges_in_square : what a robot's map may hold, in all and in any square of 256 cells; maps that hold
        more are refused, the own ones too. The defaults are far above what real maps hold
    link : another transport than Zenoh, for tests

    Raises
    ------
    ConfigError : an option has an impossible value
    """

    robot: str
    _: KW_ONLY
    fleet: str = "default"
    level: str = "0"
    start: Pose2 | FixedPose | None = None
    start_sigma: tuple[float, float] = (0.03, 0.002)
    connect: Sequence[str] = ()
    listen: Sequence[str] = ()
    profile: str = "lan"
    config: Mapping[str, object] | None = None
    budget_Bps: float | None = None
    max_rate_hz: float | None = None
    heartbeat_s: float | None = None
    fold_interval_s: float = 0.2
    baselines: bool = True
    if_taken: str = "refuse"
    allow: Collection[str] | None = None
    max_edges: int = MAX_EDGES
    max_edges_in_square: int = MAX_EDGES_IN_SQUARE
    link: Link | None = None

    @property
    def limits(self) -> Limits:
        """What a robot's map may hold."""
        return Limits(self.max_edges, self.max_edges_in_square)

    @property
    def start_sigma_micro(self) -> tuple[int, int]:
        """Whole micrometres and microradians; ConfigError if they are none."""
        return micro("start_sigma", self.start_sigma)

    def __post_init__(self) -> None:
        for option, name in (("robot", self.robot), ("fleet", self.fleet), ("level", self.level)):
            check_name(option, name)
        fixed_pose("start", self.start)
        _ = self.start_sigma_micro
        # Refuses what can't be, whatever the link.
        zenoh_settings(self.profile, listen=self.listen, connect=self.connect, config=self.config)
        if self.heartbeat_s is not None:
            check_number("heartbeat_s", self.heartbeat_s, expected="seconds, more than 0", fits=lambda s: s > 0)
        check_number("fold_interval_s", self.fold_interval_s, expected="seconds, 0 or more", fits=lambda s: s >= 0)
        check_type("baselines", self.baselines, bool)
        if self.if_taken not in IF_TAKEN:
            raise ConfigError(option="if_taken", value=self.if_taken, reason=f"expected one of {', '.join(IF_TAKEN)}")
        if self.allow is not None:
            if isinstance(self.allow, str) or not isinstance(self.allow, Collection):
                raise ConfigError(option="allow", value=self.allow, reason='expected names, as ["r1", "r2"]')
            for name in self.allow:
                check_name("allow", name)
        check_count("max_edges", self.max_edges, least=1, most=MAX_EDGES_HELD)
        check_count("max_edges_in_square", self.max_edges_in_square, least=1, most=MAX_EDGES_HELD)
        if self.link is not None and not callable(getattr(self.link, "open", None)):
            reason = "expected a fleetmap.peer.link.Link; None is Zenoh's"
            raise ConfigError(option="link", value=self.link, reason=reason)


def micro(option: str, sigma: tuple[float, float]) -> tuple[int, int]:
    """Standard deviations in whole micrometres and microradians; ConfigError if they are none."""
    expected = "two numbers: metres and radians, 0 or more, at most 1000"
    if not isinstance(sigma, Sequence) or len(sigma) != 2:
        raise ConfigError(option=option, value=sigma, reason=f"expected {expected}")
    for each in sigma:
        check_number(option, each, expected=expected, fits=lambda s: 0 <= s <= 1000)
    return round(sigma[0] * 1e6), round(sigma[1] * 1e6)


def fixed_pose(option: str, pose: Pose2 | FixedPose | None) -> FixedPose | None:
    """The pose in whole numbers; ConfigError if it is none. One that is in whole numbers stays as it is."""
    if isinstance(pose, FixedPose):
        return pose
    return None if pose is None else FixedPose.from_pose(check_type(option, pose, Pose2, hint=HOW_TO_POSE))


def taking(options: Callable[P, JoinOptions]) -> Callable[[Callable[[JoinOptions], R]], Callable[P, R]]:
    """Have a function of ``JoinOptions`` take each option as an argument: checkers, editors and ``help`` see them."""

    def spread(function: Callable[[JoinOptions], R]) -> Callable[P, R]:
        @functools.wraps(function)
        def spread_function(*args: P.args, **kwargs: P.kwargs) -> R:
            return function(options(*args, **kwargs))

        signature = inspect.signature(options).replace(return_annotation=inspect.signature(function).return_annotation)
        spread_function.__signature__ = signature  # type: ignore[attr-defined]
        return spread_function

    return spread
