"""``fleetmap.join``: where a robot enters the fleet."""

from __future__ import annotations

import secrets
from collections.abc import Collection, Mapping, Sequence

from fleetmap.codecs.names import check_name
from fleetmap.engine.holdings import MAX_EDGES_HELD
from fleetmap.engine.stream import Limits
from fleetmap.model.checks import check_count, check_number, check_type
from fleetmap.model.density import MAX_EDGES, MAX_EDGES_IN_SQUARE
from fleetmap.model.errors import ConfigError
from fleetmap.model.pose import Pose2
from fleetmap.peer.link import Link
from fleetmap.peer.peer import Peer
from fleetmap.peer.profiles import zenoh_settings

IF_TAKEN = ("refuse", "join")


def join(
    robot: str,
    *,
    fleet: str = "default",
    level: str = "0",
    start: Pose2 | None = None,
    connect: Sequence[str] = (),
    listen: Sequence[str] = (),
    profile: str = "lan",
    config: Mapping[str, object] | None = None,
    budget_Bps: float | None = None,
    max_rate_hz: float | None = None,
    heartbeat_s: float = 2.0,
    fold_interval_s: float = 0.2,
    baselines: bool = True,
    if_taken: str = "refuse",
    allow: Collection[str] | None = None,
    max_edges: int = MAX_EDGES,
    max_edges_in_square: int = MAX_EDGES_IN_SQUARE,
    link: Link | None = None,
) -> Peer:
    """Join a fleet: ``async with fleetmap.join("r7", fleet="site-4") as peer: ...``.

    Parameters
    ----------
    robot : own name, 1 to 64 of A-Z a-z 0-9 _ . -; each living robot of the fleet should have one of its own
    fleet : robots of one fleet share their maps
    level : storey; frames of different levels are never merged
    start : T_fleet_robot, where the robot's map frame lies in the fleet's, up to 17592 km from its origin; None if that
        is unknown. Whether the maps of the others are near is checked when this robot publishes
    connect, listen : Zenoh endpoints, as ``tcp/10.0.0.2:7447``
    profile : ``lan`` finds peers by multicast and by ``connect``; ``local`` by ``connect`` alone
    config : further Zenoh settings, configuration key -> value; they override the profile's
    budget_Bps : payload bytes a second that updates of the own map may take, on average. Who publishes more often than
        that allows sends the difference to the last update that went, once it may; never a queue of old ones
    max_rate_hz : at most so many updates a second
    heartbeat_s : how often the own revision is announced
    fold_interval_s : at least so long between two folds that nobody waits for
    baselines : count at each publish what the grid would have cost, gzipped
    if_taken : what to do if a living peer has this name and answers: ``refuse`` raises ``NameInUse``; ``join`` is
        another life beside it, as for a robot whose hung former process still answers
    allow : names that are listened to; None: all
    max_edges, max_edges_in_square : what a robot's map may hold, in all and in any square of 256 cells; maps that hold
        more are refused, the own ones too. The defaults are far above what real maps hold
    link : another transport than Zenoh, for tests

    Returns
    -------
    Peer : not yet connected; ``async with`` connects and closes it, ``await`` connects it

    Raises
    ------
    ConfigError : an option has an impossible value
    NameInUse : on connecting: a living peer has this name
    LinkError : on connecting: the transport could not be opened
    """
    for option, name in (("robot", robot), ("fleet", fleet), ("level", level)):
        check_name(option, name)
    heartbeat_s = check_number("heartbeat_s", heartbeat_s, expected="seconds, more than 0", fits=lambda s: s > 0)
    fold_interval_s = check_number(
        "fold_interval_s", fold_interval_s, expected="seconds, 0 or more", fits=lambda s: s >= 0
    )
    check_type("baselines", baselines, bool)
    if if_taken not in IF_TAKEN:
        raise ConfigError(option="if_taken", value=if_taken, reason=f"expected one of {', '.join(IF_TAKEN)}")
    if allow is not None and (isinstance(allow, str) or not isinstance(allow, Collection)):
        raise ConfigError(option="allow", value=allow, reason='expected names, as ["r1", "r2"]')
    limits = Limits(
        check_count("max_edges", max_edges, most=MAX_EDGES_HELD),
        check_count("max_edges_in_square", max_edges_in_square, most=MAX_EDGES_HELD),
    )
    zenoh_settings(profile, listen=listen, connect=connect, config=config)  # refuses what can't be, whatever the link
    if link is not None and not callable(getattr(link, "open", None)):
        raise ConfigError(option="link", value=link, reason="expected a fleetmap.peer.link.Link; None is Zenoh's")
    if link is None:
        # Zenoh takes 33 MB; a program that only works on maps never loads it.
        from fleetmap.peer.zenoh_link import ZenohLink

        link = ZenohLink(robot, fleet=fleet, profile=profile, listen=listen, connect=connect, config=config)
    return Peer(
        robot,
        fleet=fleet,
        level=level,
        start=start,
        link=link,
        seed=secrets.token_bytes(16),
        budget_Bps=budget_Bps,
        max_rate_hz=max_rate_hz,
        heartbeat_s=heartbeat_s,
        fold_interval_s=fold_interval_s,
        baselines=baselines,
        if_taken=if_taken,
        allow=allow,
        limits=limits,
    )
