"""From payload bytes to bytes on the wire: an estimate of what Zenoh, TCP and IP add."""

from __future__ import annotations

from math import ceil

ZENOH_BYTES = 26
"""A message's share: batch length (2), frame header and sequence number (4), Push with a declared key and its suffix
(some 16), encoding and length of the payload (4)."""

TCP_IP_BYTES = 52
"""Headers of a segment: IPv4 (20), and TCP with time stamps (32)."""

SEGMENT_BYTES = 1448
"""What a segment carries in Ethernet's 1500 bytes."""


def estimate_wire_bytes(messages: int, size_bytes: int) -> int:
    """Bytes on an IP link for so many messages of so many payload bytes in all, to one receiver.

    Each message is sent by itself, as robots that speak every few seconds do. Acknowledgements, link layer headers and
    lost segments are not in it.
    """
    if messages == 0:
        return 0
    segments = messages * ceil((size_bytes / messages + ZENOH_BYTES) / SEGMENT_BYTES)
    return size_bytes + messages * ZENOH_BYTES + segments * TCP_IP_BYTES


def required_bandwidth_kbps(size_bytes: int, time_s: float) -> float | None:
    """The paper's ``size / time``, in kilobits (1000 bits) a second; None without any time."""
    return size_bytes * 8 / 1000 / time_s if time_s > 0 else None
