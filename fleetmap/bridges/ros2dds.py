"""The wire of zenoh-bridge-ros2dds, which most teams on Humble or DDS run beside their robots.

Data goes under the topic's name alone, behind the bridge's own namespace if it has one; no type, no hash, no domain, no
attachment. From the bridge's sources (1.10): ``liveliness_mgt.rs`` for tokens, ``qos_helpers.rs`` for numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

from fleetmap.bridges.dialect import Endpoint, Offer
from fleetmap.bridges.qos import Qos

SLASH = "§"
"""What stands for a slash within a chunk."""


@dataclass(frozen=True, slots=True)
class Ros2Dds:
    """The dialect of zenoh-bridge-ros2dds. Its ``--namespace`` is the ``namespace`` here."""

    name = "ros2dds"
    where = "the topics that zenoh-bridge-ros2dds lets pass"
    router = "zenoh-bridge-ros2dds"
    tokens = "@/*/@ros2_lv/**"

    def said(self, topic: str, type_name: str) -> str:
        """Where a message is published."""
        return topic.lstrip("/")

    heard = said

    def refusal(self, key: str, type_name: str) -> str | None:
        """A key says nothing of the type."""
        return None

    def attachment(self, sequence: int, stamp_ns: int, gid: bytes) -> bytes | None:
        """Topics have none."""
        return None

    def fits_attachment(self, data: bytes | None) -> bool:
        """Whatever comes is as good as nothing."""
        return True

    def node_token(self, zid: str, namespace: str, node: str) -> str | None:
        """Nodes have none."""
        return None

    def endpoint_token(self, zid: str, endpoint: Endpoint) -> str:
        """What shows one of the own publishers or subscribers."""
        kind = "MP" if endpoint.publishes else "MS"
        topic, type_name = (name.replace("/", SLASH) for name in (endpoint.topic.lstrip("/"), endpoint.type_name))
        return f"@/{zid}/@ros2_lv/{kind}/{topic}/{type_name}/{qos_text(endpoint.qos)}"

    def offer(self, token: str) -> Offer | None:
        """What a token offers; None if it is no publisher's."""
        chunks = token.split("/")
        if len(chunks) < 7 or chunks[2] != "@ros2_lv" or chunks[3] != "MP":
            return None
        return Offer(chunks[1], "/" + chunks[4].replace(SLASH, "/"), chunks[5].replace(SLASH, "/"))


def qos_text(qos: Qos) -> str:
    """Keyless; reliability, durability, history (keep last) and depth in the numbers of DDS."""
    return f":{int(qos.reliable)}:{int(qos.latched)}:0,{qos.depth}"
