"""The wire of rmw_zenoh: which keys its nodes speak under, and which tokens show them to each other.

Data goes under ``<domain>/<topic>/<type>/<hash>``, each sample with an attachment; a node and each of its publishers
and subscribers show a liveliness token, and tools such as ``ros2 topic list`` read nothing else. From the design page
of rmw_zenoh (``docs/design.md``) and its releases for Jazzy (0.2.5 and later), Kilted and Lyrical.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from fleetmap.bridges.cdr import HASHES
from fleetmap.bridges.dialect import Endpoint, Offer
from fleetmap.bridges.qos import Qos

NO_HASH = "TypeHashNotSupported"
"""What Humble's nodes write in place of a hash."""
ATTACHMENT = struct.Struct("<qqB16s")
ENDPOINT_CHUNKS = 13
"""Lyrical may add more of them behind."""


@dataclass(frozen=True, slots=True)
class RmwZenoh:
    """The dialect of the nodes of one domain.

    Parameters
    ----------
    domain : ROS_DOMAIN_ID
    humble : speak to nodes of Humble, which know no hashes, instead of those of all later distributions
    """

    domain: int = 0
    humble: bool = False

    name = "rmw_zenoh"
    router = "ros2 run rmw_zenoh_cpp rmw_zenohd"

    @property
    def where(self) -> str:
        """The domain."""
        return f"ROS_DOMAIN_ID {self.domain}"

    @property
    def tokens(self) -> str:
        """Where the tokens of all nodes are."""
        return f"@ros2_lv/{self.domain}/**"

    def said(self, topic: str, type_name: str) -> str:
        """Where a message is published."""
        return f"{self.domain}/{topic.lstrip('/')}/{dds_type(type_name)}/{self._hash(type_name)}"

    def heard(self, topic: str, type_name: str) -> str:
        """Where messages of a topic are, of all distributions."""
        return f"{self.domain}/{topic.lstrip('/')}/{dds_type(type_name)}/*"

    def refusal(self, key: str, type_name: str) -> str | None:
        """Why a message under that key is none of this type; None if it may be one."""
        given = key.rsplit("/", 1)[-1]
        return None if given in (HASHES[type_name], NO_HASH) else "hash"

    def attachment(self, sequence: int, stamp_ns: int, gid: bytes) -> bytes | None:
        """What goes with each sample: without it, rmw_zenoh drops the sample."""
        return ATTACHMENT.pack(sequence, stamp_ns, 16, gid)

    def fits_attachment(self, data: bytes | None) -> bool:
        """Whether a sample comes from a version that this one can talk to."""
        return data is not None and len(data) == ATTACHMENT.size and data[16] == 16

    def node_token(self, zid: str, namespace: str, node: str) -> str | None:
        """What shows the node, number 0 of its session."""
        return f"@ros2_lv/{self.domain}/{zid}/0/0/NN/%/{mangled(namespace)}/{node}"

    def endpoint_token(self, zid: str, endpoint: Endpoint) -> str:
        """What shows one of its publishers or subscribers."""
        kind = "MP" if endpoint.publishes else "MS"
        node = f"{mangled(endpoint.namespace)}/{endpoint.node}"
        what = f"{mangled(endpoint.topic)}/{dds_type(endpoint.type_name)}/{self._hash(endpoint.type_name)}"
        return f"@ros2_lv/{self.domain}/{zid}/0/{endpoint.number}/{kind}/%/{node}/{what}/{qos_text(endpoint.qos)}"

    def offer(self, token: str) -> Offer | None:
        """What a token offers; None if it is no publisher's."""
        chunks = token.split("/")
        if len(chunks) < ENDPOINT_CHUNKS or chunks[0] != "@ros2_lv" or chunks[5] != "MP":
            return None
        return Offer(chunks[2], chunks[9].replace("%", "/"), ros_type(chunks[10]))

    def _hash(self, type_name: str) -> str:
        return NO_HASH if self.humble else HASHES[type_name]


def mangled(name: str) -> str:
    """A name as one chunk of a key."""
    return name.replace("/", "%") or "%"


def dds_type(type_name: str) -> str:
    """``nav_msgs/msg/OccupancyGrid`` as DDS has it."""
    package, kind, name = type_name.split("/")
    return f"{package}::{kind}::dds_::{name}_"


def ros_type(dds_name: str) -> str:
    """The other way round; what is no such name stays as it is."""
    parts = dds_name.split("::")
    return f"{parts[0]}/{parts[1]}/{parts[3].removesuffix('_')}" if len(parts) == 4 else dds_name


def qos_text(qos: Qos) -> str:
    """Reliability, durability, history and depth, deadline, lifespan, liveliness; empty where it is the default."""
    reliability, durability = "" if qos.reliable else "2", "1" if qos.latched else ""
    return f"{reliability}:{durability}:,{qos.depth}:,:,:,,"
