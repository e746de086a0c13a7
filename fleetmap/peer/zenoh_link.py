"""The link over Zenoh. What of Zenoh is marked unstable is used here, and in ``watcher``, and nowhere else.

Samples are plain ones, and may be lost where a queue is full: what is missing the engine sees by its own revisions.
Callbacks run on Zenoh's threads, and only hand over: so a session has no thread of Python, however many questions are
under way. What declares them runs in a daemon thread all the same, so that sessions are always closed: see ``endings``.
"""

from __future__ import annotations

import asyncio
import functools
import logging
import re
import threading
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Concatenate, ParamSpec, Protocol, TypeVar

import zenoh

from fleetmap.codecs.names import NAME
from fleetmap.engine import RELAY_S, Alive, Foreign, Gone, Message, Query
from fleetmap.model.errors import LinkError
from fleetmap.model.threads import in_thread
from fleetmap.peer import endings
from fleetmap.peer.endpoints import is_endpoint, split
from fleetmap.peer.keys import direct, living_keys, parse_key, parse_token, robot_of_token, zenoh_config
from fleetmap.peer.link import Network, Receiver, Token
from fleetmap.peer.outlook import Outlook
from fleetmap.peer.ports import at_free_port
from fleetmap.peer.profiles import zenoh_settings

# The stubs of zenoh 1.10 mark optional arguments as required, and leave some methods without types.

log = logging.getLogger(__name__)

ASK_TIMEOUT_S = 20.0
"""The engine waits less; over a slow link an answer may still come."""
DISCOVERY_TIMEOUT_S = 1.0
FIRST_RETRY_S, LONGEST_RETRY_S = 0.2, 10.0
SAID_KINDS = ("delta", "digest")
ASKED_KINDS = ("snapshot", "mirror", "revisions", "relay")
TRIES = 3
"""To find a port that is free, and still is when Zenoh takes it."""
MAX_SEEN = 4096
"""Tokens that are remembered, to say that they vanished when the session is opened anew."""


P = ParamSpec("P")
R = TypeVar("R")


def _entering_zenoh(method: Callable[Concatenate[ZenohLink, P], R]) -> Callable[Concatenate[ZenohLink, P], R]:
    """Let one thread in at a time, so that who closes the session knows that no other one is inside, or comes.

    A thread that comes back from Zenoh's code while Python is taken down ends the process with 134.
    """

    @functools.wraps(method)
    def enter(link: ZenohLink, /, *args: P.args, **kwargs: P.kwargs) -> R:
        with link._entering:
            return method(link, *args, **kwargs)

    return enter


class ZenohLink:
    """A Zenoh session in peer mode. Its keys: ``fleetmap/<fleet>/<robot>/<kind>/<life>``, the life in 16 hex digits.

    Parameters
    ----------
    robot, fleet : names
    profile, listen, connect, config : see ``peer.profiles``

    Raises
    ------
    ConfigError : an option has an impossible value
    """

    def __init__(
        self,
        robot: str,
        *,
        fleet: str,
        profile: str = "lan",
        listen: Sequence[str] = (),
        connect: Sequence[str] = (),
        config: Mapping[str, object] | None = None,
    ) -> None:
        self._robot, self._fleet = robot, f"fleetmap/{fleet}"
        self._settings = zenoh_settings(profile, listen=listen, connect=connect, config=config)
        self._heard, self._listening = list[str](), list[str]()
        self._config()  # refuses settings that Zenoh doesn't know, here and not when the link is opened
        self._endpoint = ", ".join([*connect, *listen]) or profile
        self._outlook = Outlook(robot, self._fleet, self._settings, connect, self._fleets)
        self._session: zenoh.Session | None = None
        self._declared: list[object] = []
        self._shown: Shown | None = None
        self._life: int | None = None
        self._seen: set[Token] = set()
        self._receiver: Receiver | None = None
        self._closed = threading.Event()
        self._opening, self._entering = threading.Lock(), threading.Lock()
        self._loop: asyncio.AbstractEventLoop | None = None

    async def open(self, receiver: Receiver) -> list[Token]:
        """Connect; returns the peers that are alive."""
        endings.enter_zenoh(self._endpoint)
        self._loop = asyncio.get_running_loop()
        endings.opened(self)
        try:
            return await in_thread(partial(self._open, receiver))
        except zenoh.ZError as error:
            await self.close()
            # Without the place in Zenoh's source.
            reason = re.sub(r" at /\S+", "", str(error))
            if "Address already in use" in reason:
                listen = ", ".join(map(str, self._settings["listen/endpoints"]))  # type: ignore[call-overload]
                reason = f"something listens at {listen} already: expected a free port for listen="
            raise LinkError(endpoint=self._endpoint, reason=reason) from None

    async def show(self, life: int) -> None:
        """Show the own token, and be asked and publish under this life, instead of the one before."""
        await in_thread(partial(self._show, life))

    @_entering_zenoh
    def put(self, life: int, kind: str, payload: bytes) -> None:
        """Publish under the own key; dropped when a peer's queue is full."""
        session, shown = self._session, self._shown
        if session is None or self._closed.is_set():
            return
        try:
            if shown is not None and shown.life == life and kind in shown.publishers:
                shown.publishers[kind].put(payload)
            else:
                session.put(
                    self._key(self._robot, kind, life),
                    payload,
                    congestion_control=zenoh.CongestionControl.DROP,
                    allowed_destination=zenoh.Locality.REMOTE,
                )
        except zenoh.ZError as error:
            log.debug("%s: put %s: %s", self._robot, kind, error)

    @_entering_zenoh
    def ask(
        self,
        peer: Token,
        kind: str,
        payload: bytes,
        *,
        on_reply: Callable[[bytes], None],
        on_end: Callable[[], None],
    ) -> None:
        """Query another peer's key."""
        session = self._session
        if session is None or self._closed.is_set():
            on_end()
            return

        def take(reply: zenoh.Reply) -> None:
            if reply.ok is not None and not self._is_over():
                on_reply(reply.ok.payload.to_bytes())

        try:
            session.get(
                self._key(peer[0], kind, peer[1]),
                direct(take, on_end),
                payload=payload,
                timeout=RELAY_S if kind == "relay" else ASK_TIMEOUT_S,
                target=zenoh.QueryTarget.ALL,
                # Several replies carry one key: any other mode keeps the last one only.
                consolidation=zenoh.ConsolidationMode.NONE,
            )
        except zenoh.ZError as error:
            log.debug("%s: ask %s %s: %s", self._robot, peer[0], kind, error)
            on_end()

    async def look(self, seen: Collection[str], heard: Sequence[str]) -> Network:
        """What it is connected to now, and why not to more.

        Without any link for a while, a session is opened anew that dials who was heard of, too: Zenoh has no way to
        dial from a running one.
        """
        if self._closed.is_set() or self._shown is None or not self._entering.acquire(blocking=False):
            return self._outlook.network  # somebody is inside; it isn't urgent
        try:
            info = None if self._session is None else self._session.info
            links, routers = ([], []) if info is None else (info.links(), info.routers_zid())
        finally:
            self._entering.release()
        sources = [link.src for link in links]
        await self._outlook.look(sources, routers=bool(routers), listening=self._listening, seen=seen)
        further = self._outlook.dial_too(heard)
        if further and not await in_thread(self._is_linked):
            log.info("%s: no link: dialling %s, too, which it has heard of", self._robot, ", ".join(further))
            await self.reopen(further)
        return self._outlook.network

    @_entering_zenoh
    def _is_linked(self) -> bool:
        return self._session is not None and bool(self._session.info.links())

    def _fleets(self) -> set[str]:
        """Fleets that have robots where this session is linked to."""
        session = self._session
        keys = [] if session is None else living_keys(session, "fleetmap/*/*/alive/**", timeout_s=DISCOVERY_TIMEOUT_S)
        return {key.split("/")[1] for key in keys if NAME.fullmatch(key.split("/")[1])}

    async def reopen(self, further: Sequence[str] = ()) -> None:
        """Close the session and open another one, which dials these, too."""
        self._heard = list(further)
        if self._receiver is not None and not self._closed.is_set():
            await in_thread(partial(self._reopen, self._receiver))

    async def tokens(self) -> list[Token]:
        """The peers that are there now."""
        session = self._session
        return [] if session is None else await in_thread(partial(self._living, session))

    async def close(self) -> None:
        """Close the session."""
        self._closed.set()
        await in_thread(self.close_now)

    def close_now(self) -> None:
        """What ``close`` does, from any thread; waits for a session that is being opened."""
        self._closed.set()
        self._drop_session()
        with self._opening:
            self._drop_session()
        endings.closed(self)

    def _is_over(self) -> bool:
        """Whether nothing is delivered any more."""
        if self._loop is not None and self._loop.is_closed() and not self._closed.is_set():
            # Nobody can close this link any more: the robot shall not look alive.
            self._closed.set()
            endings.close_soon(self)
        return self._closed.is_set()

    @_entering_zenoh
    def _drop_session(self) -> None:
        session, self._session, self._shown = self._session, None, None
        try:
            if session is not None:
                session.close()  # type: ignore[no-untyped-call]
        except zenoh.ZError as error:
            log.debug("%s: close: %s", self._robot, error)

    def _reopen(self, receiver: Receiver) -> None:
        self._drop_session()
        for token in list(self._seen):
            receiver.deliver(Gone(*token))
        self._seen.clear()
        pause_s = FIRST_RETRY_S
        while not self._closed.is_set():
            try:
                self._open(receiver)
                if self._life is not None:
                    self._show(self._life)
                return
            except LinkError:  # closed meanwhile
                return
            except zenoh.ZError as error:
                # The port may still be taken. Without a session nothing would come in that could lead here again.
                log.warning("%s: connecting anew failed, again in %.1f s: %s", self._robot, pause_s, error)
                self._drop_session()
            self._closed.wait(pause_s)
            pause_s = min(2 * pause_s, LONGEST_RETRY_S)

    def _open(self, receiver: Receiver) -> list[Token]:
        with self._opening:
            return self._open_session(receiver)

    def _open_session(self, receiver: Receiver) -> list[Token]:
        self._receiver = receiver
        closed = LinkError(endpoint=self._endpoint, reason="closed while it was opened")
        if self._closed.is_set():
            raise closed
        session = self._session = self._new_session()
        if self._closed.is_set():
            # Whoever waited for this gave up meanwhile, and ``close`` found no session yet.
            self._drop_session()
            raise closed
        remote = zenoh.Locality.REMOTE

        def message(sample: zenoh.Sample) -> None:
            parsed = parse_key(str(sample.key_expr))
            if parsed is not None and not self._is_over():
                robot, kind, life = parsed
                receiver.deliver(Message(robot, life, kind, sample.payload.to_bytes()))

        def liveliness(sample: zenoh.Sample) -> None:
            token = parse_token(str(sample.key_expr))
            if self._is_over():
                return
            if token is None:
                robot = robot_of_token(str(sample.key_expr))
                if robot is not None:
                    receiver.deliver(Foreign(robot, sample.kind == zenoh.SampleKind.PUT))
                return
            if sample.kind == zenoh.SampleKind.PUT:
                if len(self._seen) < MAX_SEEN:
                    self._seen.add(token)
                receiver.deliver(Alive(*token))
            else:
                self._seen.discard(token)
                receiver.deliver(Gone(*token))

        self._declared = [
            *(
                session.declare_subscriber(f"{self._fleet}/*/{kind}/*", direct(message), allowed_origin=remote)
                for kind in SAID_KINDS
            ),
            session.liveliness().declare_subscriber(f"{self._fleet}/*/alive/**", direct(liveliness), history=True),
        ]
        return self._living(session)

    @_entering_zenoh
    def _show(self, life: int) -> None:
        session, receiver, before, self._life = self._session, self._receiver, self._shown, life
        if session is None or receiver is None:
            return
        remote = zenoh.Locality.REMOTE

        def query(kind: str, asked: zenoh.Query) -> None:
            payload = asked.payload.to_bytes() if asked.payload is not None else b""
            # A question to all has a * in places; the answer stands under the own key.
            own = self._key(self._robot, kind, life)
            if not self._is_over():
                receiver.deliver(Query(kind, payload, partial(self._reply, asked, own)))

        publishers = {
            kind: session.declare_publisher(
                self._key(self._robot, kind, life),
                congestion_control=zenoh.CongestionControl.DROP,
                allowed_destination=remote,
            )
            for kind in SAID_KINDS
        }
        # Figures are answered at once, which Zenoh's own thread is not for: this one is Python's.
        answers = {kind: direct(partial(query, kind)) for kind in ASKED_KINDS} | {"stats": partial(query, "stats")}
        asked = [
            session.declare_queryable(self._key(self._robot, kind, life), answer, allowed_origin=remote)
            for kind, answer in answers.items()
        ]
        # Last: who sees it asks at once. The reference must be kept: a token dies with it.
        token = session.liveliness().declare_token(self._key(self._robot, "alive", life))
        self._shown = Shown(life, publishers, [*asked, token])
        if before is not None:
            for declared in [*before.publishers.values(), *before.others]:
                declared.undeclare()

    def _key(self, robot: str, kind: str, life: int) -> str:
        return f"{self._fleet}/{robot}/{kind}/{life:016x}"

    def _new_session(self) -> zenoh.Session:
        """Open one that listens at ports which are known, so that others can be told of them."""
        told = self._settings["listen/endpoints"]
        # Whoever writes it in another form, or as something else than addresses, isn't told of.
        plain = isinstance(told, list) and "listen" not in self._settings
        endpoints = [each for each in told if is_endpoint(each)] if isinstance(told, list) and plain else []
        if isinstance(told, list) and len(endpoints) < len(told):
            endpoints = []
        free = any(split(each)[2] == 0 for each in endpoints)
        for left in reversed(range(TRIES if free else 1)):
            self._listening = [at_free_port(each) for each in endpoints]
            try:
                return zenoh.open(self._config())
            except zenoh.ZError:
                if not left:
                    raise
        raise AssertionError("unreachable")

    def _config(self) -> zenoh.Config:
        settings = dict(self._settings)
        if self._listening:
            settings["listen/endpoints"] = self._listening
        dialled = settings["connect/endpoints"]
        if self._heard and isinstance(dialled, list):
            settings["connect/endpoints"] = [*dialled, *self._heard]
        return zenoh_config(settings)

    def _living(self, session: zenoh.Session) -> list[Token]:
        keys = living_keys(session, f"{self._fleet}/*/alive/**", timeout_s=DISCOVERY_TIMEOUT_S)
        return [token for token in map(parse_token, keys) if token is not None]

    def _reply(self, asked: zenoh.Query, key: str, replies: Sequence[bytes], *, last: bool = True) -> None:
        if replies:
            self._send(asked, key, replies)
        if last and not self._closed.is_set():
            # Also from Zenoh's own thread, which mustn't wait for who closes the session.
            asked.drop()  # type: ignore[no-untyped-call]

    @_entering_zenoh
    def _send(self, asked: zenoh.Query, key: str, replies: Sequence[bytes]) -> None:
        try:
            for payload in replies:
                if not self._closed.is_set():
                    asked.reply(key, payload)
        except zenoh.ZError as error:
            log.debug("reply to %s: %s", key, error)


@dataclass(frozen=True, slots=True)
class Shown:
    """What is declared under the own keys of one life."""

    life: int
    publishers: Mapping[str, Publisher]
    others: Sequence[Declared]


class Declared(Protocol):
    """Something that a session declared."""

    def undeclare(self) -> None:
        """Take it back."""


class Publisher(Declared, Protocol):
    """Zenoh's own."""

    def put(self, payload: bytes) -> None:
        """Publish."""
