"""From messages to bytes on an IP link: what Zenoh, TCP and IP add, written down from their protocols.

Counted is one link and what one robot causes on it: its messages and keep-alives, and the acknowledgements that these
bring from the other side. Two robots' shares add up to all that their link carries. Nothing here is fitted;
``benchmarks/wire.py`` holds the sum against the kernel's own counters.

Left out: link layer headers, lost segments, and what is said once when a link opens (4 to 5 kB both ways). Two robots
whose heartbeats happen to fall within 40 ms of each other acknowledge with what they say anyway: on an idle link the
sum is then up to a fifth too high.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from fleetmap.accounting.ledger import Count

TCP_IP_BYTES = 52
"""Headers of a segment, and all of an acknowledgement: IPv4 (20), and TCP with time stamps (32)."""
SEGMENT_BYTES = 1448
"""What a segment carries in Ethernet's 1500 bytes."""
SEGMENTS_AN_ACK = 2
"""A receiver acknowledges each second full segment (RFC 9293, 3.8.6.3), and the rest when 40 ms have passed."""

BATCH_BYTES = 2 + 1 + 4
"""Length of the batch, header of a frame, its sequence number (28 bits, 7 to a byte)."""
KEEP_ALIVE_BYTES = 2 + 1
"""Length of the batch, and a header."""
KEEP_ALIVES_A_LEASE = 4
"""Zenoh's own default; one is sent when a link has carried nothing else this way for a quarter of the lease."""
PUSH_BYTES = 1 + 1 + 1 + 1 + 1
"""Headers of push and put, number of the declared prefix ``fleetmap/<fleet>``, lengths of suffix and payload."""
LIFE_BYTES = 1 + 16
"""The end of each key, as text: Zenoh has numbers only for what the receiver has declared, which holds no life."""
QUERY_BYTES = BATCH_BYTES + 1 + 1 + 1 + 2 + 2 + 3 + 5
"""Header, number, declared key, priority, target, timeout; header, consolidation and payload's extension."""
REPLY_BYTES = BATCH_BYTES + 1 + 1 + 1 + 1 + 2 + 20 + 2 + 1 + 4
"""Header, question's number, key's scope and length, priority, who answers; headers of reply and put; length; and the
end of the replies, which goes in the same batch."""
LONG_PAYLOAD_BYTES = 1
"""Lengths take one byte below 128, and two for what is longer."""

QUERIES = ("want",)
REPLIES = ("repair", "list", "relay")
ALIKE = ("digest",)
"""What a fleet that shares grids would say just as well: heartbeats, with poses and goals. They count on both sides."""


@dataclass(frozen=True, slots=True)
class Transport:
    """What a link costs is decided by these, beside the messages.

    Parameters
    ----------
    robot, fleet : names; they stand in keys
    lease_s : Zenoh's lease; keep-alives follow each quarter of it
    """

    robot: str = "r0"
    fleet: str = "sim"
    lease_s: float = 12.0


class WireBytes(NamedTuple):
    """Bytes on an IP link, by what they are for."""

    payload: int = 0
    zenoh: int = 0
    """Zenoh's framing."""
    tcp_ip: int = 0
    """Headers of the segments of payload and framing."""
    acknowledgements: int = 0
    """What the other side sends back for them."""
    keep_alives: int = 0
    """With headers and acknowledgements."""

    @property
    def total(self) -> int:
        """All of it."""
        return sum(self)


def segments(size_bytes: int) -> int:
    """TCP segments of a message with so much payload; some 50 bytes of framing come with it."""
    return math.ceil((size_bytes + BATCH_BYTES + PUSH_BYTES + 40) / SEGMENT_BYTES)


def wire_bytes(sent: Mapping[str, Count], time_s: float, transport: Transport | None = None) -> WireBytes:
    """What messages take on an IP link to one receiver, with the keep-alives of ``time_s`` seconds.

    Parameters
    ----------
    sent : what one robot said, by kind as in ``Stats.sent``
    time_s : how long the link lasted, seconds
    transport : None: that of ``fleetmap.join``

    Returns
    -------
    WireBytes : both ways: acknowledgements of the receiver are counted with what they acknowledge
    """
    transport = transport or Transport()
    zenoh = pieces = acknowledgements = 0
    for kind, count in sent.items():
        long = LONG_PAYLOAD_BYTES * (count.messages > 0 and count.size_bytes >= 128 * count.messages)
        zenoh += count.messages * (_framing(kind, transport) + long)
        pieces += count.segments
        if kind not in QUERIES:  # a question is acknowledged by its answer
            acknowledgements += count.messages + max(0, count.segments - count.messages) // SEGMENTS_AN_ACK
    said = sum(count.messages for kind, count in sent.items())
    beats = sent["digest"].messages if "digest" in sent else 0
    every_s = transport.lease_s / KEEP_ALIVES_A_LEASE
    alive = keep_alives(time_s, regular=beats, others=said - beats, every_s=every_s)
    return WireBytes(
        payload=sum(count.size_bytes for count in sent.values()),
        zenoh=zenoh,
        tcp_ip=pieces * TCP_IP_BYTES,
        acknowledgements=acknowledgements * TCP_IP_BYTES,
        keep_alives=round(alive * (KEEP_ALIVE_BYTES + 2 * TCP_IP_BYTES)),
    )


def grids_instead(sent: Mapping[str, Count], grids: Count) -> dict[str, Count]:
    """What a fleet would have sent that shares grids over the same transport: the grids, and all that isn't map.

    Poses, goals and heartbeats are the same. Questions, lists and repairs are left out, in favour of the grids.
    """
    return {"delta": grids, **{kind: sent[kind] for kind in ALIKE if kind in sent}}


def keep_alives(time_s: float, *, regular: int, others: int, every_s: float) -> float:
    """Expected keep-alives: one for each ``every_s`` seconds in which nothing else is sent.

    Parameters
    ----------
    time_s : how long the link lasts
    regular : messages at equal distances, as heartbeats are
    others : messages at any time, independent of each other
    every_s : the silence that brings a keep-alive

    Notes
    -----
    Let h be the time between two regular messages, r the rate of the others. The silence has lasted j times ``every_s``
    when so long ago something was sent and nothing since: after the regular one with the chance q^j, q = exp(-r
    every_s), and after one of the others, at any moment, with r q^j a second. The sum over j up to n = h / every_s of
    q^j (1 + r (h - j every_s)) is what is returned, in closed form, for time_s / h such times.
    """
    if time_s <= 0.0:
        return 0.0
    h, r = time_s / max(regular, 1), others / time_s
    n = math.floor(h / every_s + 1e-9)
    if r == 0.0:
        return n * time_s / h
    q = math.exp(-r * every_s)
    rest = -math.expm1(-r * every_s)
    powers = q * (1 - q**n) / rest
    weighted = q * (1 - (n + 1) * q**n + n * q ** (n + 1)) / rest**2
    return ((1 + r * h) * powers - r * every_s * weighted) * time_s / h


def required_bandwidth_kbps(size_bytes: int, time_s: float) -> float | None:
    """The paper's ``size / time``, in kilobits (1000 bits) a second; None without any time."""
    return size_bytes * 8 / 1000 / time_s if time_s > 0 else None


def _framing(kind: str, transport: Transport) -> int:
    """Zenoh's bytes of a message beside its payload."""
    if kind in QUERIES:
        return QUERY_BYTES
    if kind in REPLIES:
        return REPLY_BYTES + len(f"fleetmap/{transport.fleet}/{transport.robot}/revisions") + LIFE_BYTES
    suffix = len(f"/{transport.robot}/{kind}") + LIFE_BYTES
    return BATCH_BYTES + PUSH_BYTES + suffix
