"""``Dialect``: how ROS 2 speaks over Zenoh. A new one is a new file, and a line in ``options``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from fleetmap.bridges.qos import Qos


@dataclass(frozen=True, slots=True)
class Endpoint:
    """A publisher or subscriber of the own node; ``number`` is its own in the session, from 1 on."""

    publishes: bool
    number: int
    namespace: str
    node: str
    topic: str
    type_name: str
    qos: Qos


@dataclass(frozen=True, slots=True)
class Offer:
    """A publisher that somebody shows; ``zid`` is the session's."""

    zid: str
    topic: str
    type_name: str


class Dialect(Protocol):
    """Keys, tokens and attachments. Topics are whole names, with their leading slash."""

    @property
    def name(self) -> str:
        """How users call it."""

    @property
    def where(self) -> str:
        """In words, which nodes are heard."""

    @property
    def router(self) -> str:
        """What has to run on the ROS side."""

    @property
    def tokens(self) -> str:
        """A key expression for the tokens of all nodes."""

    def said(self, topic: str, type_name: str) -> str:
        """The key that a message is published under."""

    def heard(self, topic: str, type_name: str) -> str:
        """A key expression for the messages of a topic."""

    def refusal(self, key: str, type_name: str) -> str | None:
        """In a word, why a message under that key is none of this type; None if it may be one."""

    def attachment(self, sequence: int, stamp_ns: int, gid: bytes) -> bytes | None:
        """What goes with each sample; ``gid`` is 16 bytes, the publisher's own."""

    def fits_attachment(self, data: bytes | None) -> bool:
        """Whether a sample's attachment is what this dialect has."""

    def node_token(self, zid: str, namespace: str, node: str) -> str | None:
        """The liveliness token of a node; None if the dialect has none."""

    def endpoint_token(self, zid: str, endpoint: Endpoint) -> str:
        """The liveliness token of an endpoint."""

    def offer(self, token: str) -> Offer | None:
        """The publisher behind a token; None if it is none."""
