"""``Watcher``: asks the robots of a fleet what they have counted, and is none of them.

It shows no liveliness token, subscribes to nothing and holds no map, so that no robot sends it a map, and nothing of it
stays. What it costs a robot is a link and an answer to each question; robots count these answers apart, and the
watcher counts them, too.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Self

import zenoh

from fleetmap.accounting import Count
from fleetmap.codecs import envelope
from fleetmap.codecs.messages import StatsMessage
from fleetmap.codecs.names import NAME, check_name
from fleetmap.model.errors import LinkError, WireError
from fleetmap.peer.endings import enter_zenoh
from fleetmap.peer.keys import living_keys, parse_key, parse_token, robot_of_token, zenoh_config
from fleetmap.peer.profiles import zenoh_settings

ASK_TIMEOUT_S = 2.0
MAX_ROBOTS = 512
"""More than that are not shown."""


@dataclass(frozen=True, slots=True)
class Seen:
    """One robot as of one look.

    Parameters
    ----------
    robot : its name
    alive : whether it shows a token
    endpoint : of the link to it; None if it is not linked or didn't answer
    figures : its answer; None if there was none in time
    life : whose answer it is
    version : of the protocol that it speaks, if that is another one; 0 where it isn't said
    lives : how many tokens it shows
    """

    robot: str
    alive: bool
    endpoint: str | None
    figures: StatsMessage | None
    life: int = 0
    version: int | None = None
    lives: int = 0


class Watcher:
    """A Zenoh session that asks; use it as ``async with``.

    Parameters
    ----------
    fleet : its name
    profile, connect, listen, config : see ``fleetmap.join``

    Attributes
    ----------
    questions, answers : what it has caused

    Raises
    ------
    ConfigError : an option has an impossible value
    LinkError : on entering: the transport could not be opened
    """

    def __init__(
        self,
        fleet: str,
        *,
        profile: str,
        connect: Sequence[str] = (),
        listen: Sequence[str] = (),
        config: Mapping[str, object] | None = None,
    ) -> None:
        self.fleet, self.dialled = check_name("fleet", fleet), tuple(connect)
        self.settings = zenoh_settings(profile, listen=listen, connect=connect, config=config)
        self.endpoint = ", ".join([*connect, *listen]) or ("multicast" if profile == "lan" else "nowhere")
        self.questions, self.answers = Count(), Count()
        self._session: zenoh.Session | None = None

    async def __aenter__(self) -> Self:
        enter_zenoh(self.endpoint)
        config = zenoh_config(self.settings)
        try:
            self._session = await asyncio.to_thread(zenoh.open, config)
        except zenoh.ZError as error:
            raise LinkError(endpoint=self.endpoint, reason=str(error).partition(" at /")[0]) from None
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        session, self._session = self._session, None
        if session is not None:
            await asyncio.to_thread(session.close)

    async def look(self) -> list[Seen]:
        """Ask all robots; returns those that live or answer, by name.

        Raises
        ------
        LinkError : the watcher is closed
        """
        session = self._session
        if session is None:
            raise LinkError(endpoint=self.endpoint, reason="the watcher is closed")
        try:
            return await asyncio.to_thread(self._look, session)
        except zenoh.ZError as error:
            raise LinkError(endpoint=self.endpoint, reason=str(error)) from None

    async def links(self) -> tuple[list[str], bool]:
        """Endpoints that this session is linked to, and whether a router is among them."""
        session = self._session
        if session is None:
            return [], False
        links, routers = await asyncio.to_thread(lambda: (session.info.links(), session.info.routers_zid()))
        return sorted({link.dst for link in links}), bool(routers)

    async def surroundings(self) -> tuple[list[str], list[str]]:
        """Endpoints that this session is linked to, and the fleets that have robots there."""
        session = self._session
        if session is None:
            return [], []

        def ask() -> tuple[list[str], list[str]]:
            keys = living_keys(session, "fleetmap/*/*/alive/**", timeout_s=ASK_TIMEOUT_S)
            fleets = {key.split("/")[1] for key in keys}
            named = sorted(name for name in fleets if NAME.fullmatch(name))
            return sorted({link.dst for link in session.info.links()}), named[:MAX_ROBOTS]

        try:
            return await asyncio.to_thread(ask)
        except zenoh.ZError:
            return [], []

    def _look(self, session: zenoh.Session) -> list[Seen]:
        keys = living_keys(session, f"fleetmap/{self.fleet}/*/alive/**", timeout_s=ASK_TIMEOUT_S)
        living = Counter(token[0] for token in map(parse_token, keys) if token is not None)
        versions = dict.fromkeys(filter(None, (robot_of_token(key) for key in keys if parse_token(key) is None)), 0)
        told: dict[str, tuple[StatsMessage | None, str, int]] = {}
        self.questions.add(0)
        replies = session.get(
            f"fleetmap/{self.fleet}/*/stats/*",
            timeout=ASK_TIMEOUT_S,
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
        )
        for reply in replies:
            if reply.ok is None:
                continue
            parsed, payload = parse_key(str(reply.ok.key_expr)), reply.ok.payload.to_bytes()
            if parsed is None:
                continue
            robot, _, life = parsed
            self.answers.add(len(payload))
            try:
                message = envelope.decode(payload, robot=robot)
            except WireError as error:
                if error.version is not None:
                    versions[robot] = error.version
                continue
            if isinstance(message, StatsMessage):
                told[robot] = (message, "" if reply.replier_id is None else str(reply.replier_id.zid), life)
        endpoints = {str(link.zid): link.dst for link in session.info.links()}
        seen = []
        for robot in sorted(living.keys() | told.keys() | versions.keys())[:MAX_ROBOTS]:
            figures, zid, life = told.get(robot, (None, "", 0))
            version = None if figures else versions.get(robot)
            alive = robot in living or robot in versions
            seen.append(Seen(robot, alive, endpoints.get(zid), figures, life, version, living[robot]))
        return seen
