"""``ZenohPort``: a ROS node without ROS, a Zenoh session of its own.

Its session is a client of the router that stands beside the robot (nodes of rmw_zenoh listen on localhost alone), or
that router itself. The fleet's session is another one: nothing of ROS goes over the radio.
"""

from __future__ import annotations

import asyncio
import logging
import secrets
import threading
import time
from dataclasses import dataclass, field
from typing import Any

import zenoh

from fleetmap.bridges import cdr
from fleetmap.bridges.dialect import Dialect, Endpoint
from fleetmap.bridges.names import resolve
from fleetmap.bridges.port import Say, Take
from fleetmap.bridges.qos import LATEST, Qos
from fleetmap.model.errors import LinkError, WireError
from fleetmap.model.threads import in_thread
from fleetmap.peer import endings
from fleetmap.peer.keys import direct, living_keys, zenoh_config

logger = logging.getLogger(__name__)

RETRY_S = 1.0
"""Between two looks for a router that isn't there."""
LOOK_S = 0.5
"""How long a question for tokens waits."""
HEARTBEAT_MS = 500
"""How often a latched publisher says how far it is, as rmw_zenoh's do: who missed the last message asks for it."""


@dataclass(slots=True)
class _Publisher:
    """One topic that is offered."""

    endpoint: Endpoint
    key: str
    gid: bytes = field(default_factory=lambda: secrets.token_bytes(16))
    publisher: Any = None
    sequence: int = 0
    waiting: bytes | None = None
    """A latched message that was said before there was a session."""


class ZenohPort:
    """A node that speaks to ROS over Zenoh; see ``Port``.

    Parameters
    ----------
    dialect : who is spoken to
    endpoint : of the router, as ``tcp/127.0.0.1:7447``
    listen : be the router oneself, here, and connect to nobody
    namespace, node : its names
    use_sim_time : take the time from ``/clock``

    Attributes
    ----------
    odd : by (topic, reason), messages that were not handed on, or whose sender hears nothing from here
    """

    def __init__(
        self,
        dialect: Dialect,
        *,
        endpoint: str,
        listen: str = "",
        namespace: str = "/",
        node: str = "fleetmap",
        use_sim_time: bool = False,
    ) -> None:
        self.dialect, self.namespace, self.node = dialect, namespace, node
        self._endpoint, self._listen, self._sim_time = endpoint, listen, use_sim_time
        self._subscriptions: list[tuple[Endpoint, Take]] = []
        self._publishers: list[_Publisher] = []
        self._session: zenoh.Session | None = None
        self._declared: list[Any] = []
        self._closed, self._entering = threading.Event(), threading.Lock()
        """The lock is for calls that return at once: opening a session may take long."""
        self._wrong: dict[str, str] = {}
        """Topic -> what was wrong last."""
        self._clock_ns = 0
        self._waiting = False
        """Whether it has begun to look for a router."""
        self.odd: dict[tuple[str, str], int] = {}
        if use_sim_time:
            self.subscribe("/clock", cdr.CLOCK, LATEST, self._take_clock)

    # What it offers and hears

    def resolve(self, topic: str) -> str:
        """The whole name of a topic."""
        return resolve(topic, namespace=self.namespace, node=self.node)

    def subscribe(self, topic: str, type_name: str, qos: Qos, take: Take) -> None:
        """Have ``take`` called with each message of a topic, on Zenoh's own thread."""
        self._subscriptions.append((self._endpoint_of(topic, type_name, qos, publishes=False), take))

    def advertise(self, topic: str, type_name: str, qos: Qos) -> Say:
        """Offer a topic; returns what publishes on it."""
        endpoint = self._endpoint_of(topic, type_name, qos, publishes=True)
        publisher = _Publisher(endpoint, self.dialect.said(endpoint.topic, type_name))
        self._publishers.append(publisher)

        def say(data: bytes) -> None:
            self._say(publisher, data)

        return say

    def topics_of(self, type_name: str) -> list[str]:
        """Topics of that type that other sessions offer now."""
        session = self._session
        if session is None or self._closed.is_set():
            return []
        own = str(session.info.zid())
        offers = filter(None, map(self.dialect.offer, living_keys(session, self.dialect.tokens, timeout_s=LOOK_S)))
        return sorted({offer.topic for offer in offers if offer.type_name == type_name and offer.zid != own})

    def now_ns(self) -> int:
        """ROS time."""
        return self._clock_ns if self._sim_time else time.time_ns()

    def problems(self) -> dict[str, str]:
        """What keeps it from ROS, and who speaks another version."""
        if self._waiting and not self.is_reached():
            return {self._endpoint: self._no_router()}
        found = dict(self._wrong)
        if self._sim_time and not self._clock_ns:
            found.setdefault("/clock", "use_sim_time is set, and nobody has said a time on /clock yet")
        return found

    def is_reached(self) -> bool:
        """Whether there is a router."""
        session = self._session
        return session is not None and (bool(self._listen) or bool(session.info.routers_zid()))

    def where(self) -> str:
        """The dialect, and of rmw_zenoh the domain."""
        return self.dialect.where

    # Its life

    async def open(self) -> None:
        """Connect; waits until the router is there.

        Raises
        ------
        LinkError : it can't listen where it is told to; or it is closed
        """
        self._waiting = True
        while True:
            try:
                await in_thread(self._open)
                return
            except zenoh.ZError as error:
                reason = str(error).partition(" at /")[0]
                if self._listen:
                    taken = (
                        "something listens there already, perhaps ROS's own router: leave ros_listen out to use that"
                    )
                    raise LinkError(endpoint=f"ros_listen {self._listen}", reason=f"{taken} ({reason})") from None
            await asyncio.sleep(RETRY_S)

    async def close(self) -> None:
        """Close the session."""
        await in_thread(self.close_now)

    def close_now(self) -> None:
        """What ``close`` does, from any thread."""
        self._closed.set()
        with self._entering:
            session, self._session = self._session, None
            try:
                if session is not None:
                    session.close()  # type: ignore[no-untyped-call]
            except zenoh.ZError as error:
                logger.debug("%s: close: %s", self.node, error)
        endings.closed(self)

    # How it works

    def _no_router(self) -> str:
        return (
            f"no router at {self._endpoint}, so that no node of ROS is reached: start `{self.dialect.router}` there, "
            f"or be it oneself with --ros-listen {self._endpoint}; tried again each second"
        )

    def _endpoint_of(self, topic: str, type_name: str, qos: Qos, *, publishes: bool) -> Endpoint:
        number = 1 + len(self._subscriptions) + len(self._publishers)
        return Endpoint(publishes, number, self.namespace, self.node, self.resolve(topic), type_name, qos)

    def _settings(self) -> dict[str, object]:
        place: dict[str, object] = {"mode": "client", "connect/endpoints": [self._endpoint]}
        if self._listen:
            place = {"mode": "router", "listen/endpoints": [self._listen], "connect/endpoints": []}
        return {
            **place,
            "scouting/multicast/enabled": False,
            # What late joiners are sent is told from what they have by its time.
            "timestamping/enabled": True,
            "transport/shared_memory/enabled": False,
            "transport/link/rx/max_message_size": cdr.MAX_MESSAGE_BYTES + 4096,
        }

    def _open(self) -> None:
        endings.enter_zenoh(self._endpoint)
        endings.opened(self)
        session = zenoh.open(zenoh_config(self._settings()))
        with self._entering:
            if self._closed.is_set():  # nobody waited for this any more
                session.close()  # type: ignore[no-untyped-call]
                raise LinkError(endpoint=self._endpoint, reason="closed while it was opened")
            self._declare(session)
            self._session = session

    def _declare(self, session: zenoh.Session) -> None:
        import zenoh.ext as ext

        zid, liveliness = str(session.info.zid()), session.liveliness()
        endpoints = []
        for endpoint, take in self._subscriptions:
            key = self.dialect.heard(endpoint.topic, endpoint.type_name)
            handler = direct(self._taking(endpoint, take))
            if endpoint.qos.latched:
                latched = ext.declare_advanced_subscriber(
                    session,
                    key,
                    handler,
                    history=ext.HistoryConfig(detect_late_publishers=True, max_samples=endpoint.qos.depth),
                    recovery=ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
                    subscriber_detection=True,
                    allowed_origin=zenoh.Locality.REMOTE,
                )
                self._declared.append(latched)
            else:
                plain = session.declare_subscriber(key, handler, allowed_origin=zenoh.Locality.REMOTE)
                self._declared.append(plain)
            endpoints.append(endpoint)
        for publisher in self._publishers:
            options: dict[str, Any] = {
                "congestion_control": zenoh.CongestionControl.DROP,
                "encoding": zenoh.Encoding("application/cdr"),
            }
            if publisher.endpoint.qos.latched:
                publisher.publisher = ext.declare_advanced_publisher(
                    session,
                    publisher.key,
                    cache=ext.CacheConfig(publisher.endpoint.qos.depth),
                    sample_miss_detection=ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=HEARTBEAT_MS),
                    publisher_detection=True,
                    **options,
                )
            else:
                publisher.publisher = session.declare_publisher(publisher.key, **options)
            endpoints.append(publisher.endpoint)
        # Last: whoever sees a token may ask at once. They die with their references.
        node_token = self.dialect.node_token(zid, self.namespace, self.node)
        tokens = [node_token] if node_token else []
        tokens += [self.dialect.endpoint_token(zid, endpoint) for endpoint in endpoints]
        self._declared += [liveliness.declare_token(token) for token in tokens]
        for publisher in self._publishers:
            if publisher.waiting is not None:
                data, publisher.waiting = publisher.waiting, None
                self._put(publisher, data)

    def _say(self, publisher: _Publisher, data: bytes) -> None:
        with self._entering:
            if self._session is not None:
                self._put(publisher, data)
            elif publisher.endpoint.qos.latched:
                publisher.waiting = data

    def _put(self, publisher: _Publisher, data: bytes) -> None:
        publisher.sequence += 1
        try:
            attachment = self.dialect.attachment(publisher.sequence, time.time_ns(), publisher.gid)
            publisher.publisher.put(data, attachment=attachment)
        except zenoh.ZError as error:
            logger.debug("%s: %s: %s", self.node, publisher.endpoint.topic, error)

    def _taking(self, endpoint: Endpoint, take: Take) -> Any:
        def handle(sample: zenoh.Sample) -> None:
            if self._closed.is_set():
                return
            refusal = self.dialect.refusal(str(sample.key_expr), endpoint.type_name)
            if refusal is not None:
                where = f"{endpoint.topic} under {str(sample.key_expr)[:300]}"
                self._note(endpoint.topic, refusal, f"{where} is another {endpoint.type_name} than here: refused")
                return
            attachment = None if sample.attachment is None else sample.attachment.to_bytes()
            if not self.dialect.fits_attachment(attachment):
                # Read all the same: only what is sent the other way isn't understood there.
                text = "comes from an rmw_zenoh before 0.2.5 (Jazzy) or 0.1.2 (Humble), which hears nothing from here"
                self._note(endpoint.topic, "attachment", f"{endpoint.topic} {text}")
            take(sample.payload.to_bytes())

        return handle

    def _note(self, topic: str, reason: str, text: str) -> None:
        self.odd[topic, reason] = self.odd.get((topic, reason), 0) + 1
        self._wrong[topic] = text

    def _take_clock(self, data: bytes) -> None:
        try:
            self._clock_ns = cdr.ns_of(cdr.decode(data, cdr.CLOCK, topic="/clock").clock)
            self._wrong.pop("/clock", None)
        except WireError as error:
            self._note("/clock", "format", str(error))
