"""The link over Zenoh. What of Zenoh is marked unstable is used here, and in ``watcher``, and nowhere else.

Zenoh's advanced layer repairs most losses by itself; what it can't, the engine sees by its own revisions.
Callbacks run on Zenoh's threads and only hand over. Sessions are always closed: an open one with a callback
keeps the process from ending.
"""

from __future__ import annotations

import asyncio
import logging
import re
import threading
from collections.abc import Callable, Mapping, Sequence

import zenoh
from zenoh import ext

from fleetmap.model.errors import ConfigError, LinkError
from fleetmap.peer.link import Receiver, Token
from fleetmap.peer.profiles import as_json5, zenoh_settings

# The stubs of zenoh 1.10 mark optional arguments as required, and leave some methods without types.

log = logging.getLogger(__name__)

CACHE_SAMPLES = 64
"""Deltas that a publisher keeps for Zenoh's own recovery."""
HEARTBEAT_S = 0.5
"""How soon Zenoh tells subscribers of the last sample's number, while there are new ones."""
ASK_TIMEOUT_S = 3.0
DISCOVERY_TIMEOUT_S = 1.0
FIRST_RETRY_S, LONGEST_RETRY_S = 0.2, 10.0
PLAIN_SUFFIXES = ("digest", "pose", "goal")


class ZenohLink:
    """A Zenoh session in peer mode under ``fleetmap/<fleet>/<robot>/``.

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
        self._config()  # refuses settings that Zenoh doesn't know, here and not when the link is opened
        self._endpoint = ", ".join([*connect, *listen]) or profile
        self._expects_peers = bool(connect)
        self._session: zenoh.Session | None = None
        self._delta: ext.AdvancedPublisher | None = None
        self._declared: list[object] = []
        self._token: zenoh.LivelinessToken | None = None
        self._shown: tuple[int, str] | None = None
        self._seen: set[Token] = set()
        self._receiver: Receiver | None = None
        self._closed = threading.Event()

    async def open(self, receiver: Receiver) -> list[Token]:
        """Connect; returns the peers that are alive."""
        try:
            return await asyncio.to_thread(self._open, receiver)
        except zenoh.ZError as error:
            await self.close()
            # Without the place in Zenoh's source.
            raise LinkError(endpoint=self._endpoint, reason=re.sub(r" at /\S+", "", str(error))) from None

    async def declare_alive(self, epoch: int, instance: str) -> None:
        """Show the own token, instead of the one before."""
        await asyncio.to_thread(self._declare_alive, epoch, instance)

    def put(self, suffix: str, payload: bytes) -> None:
        """Publish under the own key; dropped when a peer's queue is full."""
        session, delta = self._session, self._delta
        if session is None or delta is None or self._closed.is_set():
            return
        try:
            if suffix == "delta":
                delta.put(payload)
            else:
                session.put(
                    f"{self._fleet}/{self._robot}/{suffix}",
                    payload,
                    congestion_control=zenoh.CongestionControl.DROP,
                    allowed_destination=zenoh.Locality.REMOTE,
                )
        except zenoh.ZError as error:
            log.debug("%s: put %s: %s", self._robot, suffix, error)

    def ask(
        self, robot: str, suffix: str, payload: bytes, *, on_reply: Callable[[bytes], None], on_end: Callable[[], None]
    ) -> None:
        """Query another robot's key."""
        session = self._session
        if session is None or self._closed.is_set():
            on_end()
            return

        def take(reply: zenoh.Reply) -> None:
            if reply.ok is not None and not self._closed.is_set():
                on_reply(reply.ok.payload.to_bytes())

        try:
            session.get(
                f"{self._fleet}/{robot}/{suffix}",
                zenoh.handlers.Callback(take, on_end),
                payload=payload,
                timeout=ASK_TIMEOUT_S,
                target=zenoh.QueryTarget.ALL,
                # Several replies carry one key: any other mode keeps the last one only.
                consolidation=zenoh.ConsolidationMode.NONE,
            )
        except zenoh.ZError as error:
            log.debug("%s: ask %s/%s: %s", self._robot, robot, suffix, error)
            on_end()

    async def reopen(self) -> None:
        """Close the session and open another one: Zenoh has no way to connect a running one."""
        if self._receiver is not None and not self._closed.is_set():
            await asyncio.to_thread(self._reopen, self._receiver)

    async def close(self) -> None:
        """Close the session."""
        self._closed.set()
        await asyncio.to_thread(self._drop_session)

    def _drop_session(self) -> None:
        session, self._session, self._delta, self._token = self._session, None, None, None
        if session is not None:
            session.close()  # type: ignore[no-untyped-call]

    def _reopen(self, receiver: Receiver) -> None:
        self._drop_session()
        for token in list(self._seen):
            receiver.gone(token)
        self._seen.clear()
        pause_s = FIRST_RETRY_S
        while not self._closed.is_set():
            try:
                self._open(receiver)
                if self._shown is not None:
                    self._declare_alive(*self._shown)
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
        self._receiver = receiver
        session = self._session = zenoh.open(self._config())
        if self._closed.is_set():
            # Whoever waited for this gave up meanwhile, and ``close`` found no session yet.
            self._session = None
            session.close()  # type: ignore[no-untyped-call]
            raise LinkError(endpoint=self._endpoint, reason="closed while it was opened")
        own = f"{self._fleet}/{self._robot}"
        remote = zenoh.Locality.REMOTE

        def message(sample: zenoh.Sample) -> None:
            _, _, robot, suffix = str(sample.key_expr).split("/", 3)
            if not self._closed.is_set():
                receiver.message(robot, suffix, sample.payload.to_bytes())

        def liveliness(sample: zenoh.Sample) -> None:
            token = parse_token(str(sample.key_expr))
            if token is None or self._closed.is_set():
                return
            if sample.kind == zenoh.SampleKind.PUT:
                self._seen.add(token)
                receiver.alive(token)
            else:
                self._seen.discard(token)
                receiver.gone(token)

        def query(asked: zenoh.Query) -> None:
            # A question to all has a * in the robot's place; the answer stands under the own key.
            suffix = str(asked.key_expr).split("/", 3)[3]
            payload = asked.payload.to_bytes() if asked.payload is not None else b""
            if not self._closed.is_set():
                receiver.query(suffix, payload, lambda replies: _reply(asked, f"{own}/{suffix}", replies))

        self._delta = ext.declare_advanced_publisher(
            session,
            f"{own}/delta",
            congestion_control=zenoh.CongestionControl.DROP,
            allowed_destination=remote,
            cache=ext.CacheConfig(CACHE_SAMPLES),
            sample_miss_detection=ext.MissDetectionConfig(sporadic_heartbeat=HEARTBEAT_S),  # type: ignore[call-arg]
            publisher_detection=True,
        )
        self._declared = [
            ext.declare_advanced_subscriber(
                session,
                f"{self._fleet}/*/delta",
                message,
                allowed_origin=remote,
                recovery=ext.RecoveryConfig(heartbeat=True),  # type: ignore[call-arg]
            ),
            *(
                session.declare_subscriber(f"{self._fleet}/*/{suffix}", message, allowed_origin=remote)
                for suffix in PLAIN_SUFFIXES
            ),
            *(
                session.declare_queryable(f"{own}/{suffix}", query, allowed_origin=remote)
                for suffix in ("snapshot", "revisions", "mirror/*", "stats")
            ),
            session.liveliness().declare_subscriber(f"{self._fleet}/*/alive/**", liveliness, history=True),
        ]
        return self._living(session)

    def _config(self) -> zenoh.Config:
        config = zenoh.Config()
        for key, value in self._settings.items():
            try:
                config.insert_json5(key, as_json5(value))
            except zenoh.ZError as error:
                # Zenoh's own message has the place in its source, and not the key.
                reason = f"Zenoh takes no such setting as {key!r}: {str(error).partition(' at /')[0]}"
                raise ConfigError(option="config", value={key: value}, reason=reason) from None
        return config

    def _living(self, session: zenoh.Session) -> list[Token]:
        replies = session.liveliness().get(f"{self._fleet}/*/alive/**", timeout=DISCOVERY_TIMEOUT_S)
        tokens = [parse_token(str(reply.ok.key_expr)) for reply in replies if reply.ok is not None]
        return [token for token in tokens if token is not None]

    def _declare_alive(self, epoch: int, instance: str) -> None:
        session, before, self._shown = self._session, self._token, (epoch, instance)
        if session is None:
            return
        # The reference must be kept: a token dies with it.
        self._token = session.liveliness().declare_token(f"{self._fleet}/{self._robot}/alive/{epoch}/{instance}")
        if before is not None:
            before.undeclare()  # type: ignore[no-untyped-call]


def parse_token(key: str) -> Token | None:
    """The peer behind a liveliness key; None if it is none of ours."""
    parts = key.split("/")
    # isdigit() alone takes superscripts, too, and int() doesn't.
    if len(parts) != 6 or parts[3] != "alive" or not (parts[4].isascii() and parts[4].isdigit()) or len(parts[4]) > 10:
        return None
    return Token(parts[2], int(parts[4]), parts[5])


def _reply(asked: zenoh.Query, key: str, replies: Sequence[bytes]) -> None:
    try:
        for payload in replies:
            asked.reply(key, payload)
    except zenoh.ZError as error:
        log.debug("reply to %s: %s", key, error)
    finally:
        asked.drop()  # type: ignore[no-untyped-call]
