"""What the parent and a robot process say to each other: one JSON object a line, over the child's stdin and stdout.

The parent grants the child one piece of simulated time after the other, so that the robots of a fleet stay
in step however fast their processes run:

    parent                              child
    {"robot": ..., "world": ...}        {"ready": true}
    {"go": 4.0}                         {"t_s": 4.0, "state": ..., "bytes_vector": ..., ...}
    {"settle": true}                    {"published": true}         the last of the map goes out
    {"sync": 10.0}                      {"digest": ..., "revisions": [[robot, life, seq, digest], ...]}
    {"write": "r0.fmap"}                {"edges": ..., "stats": {...}}
    {"close": true}                     the child leaves the fleet and ends

When its stdin ends the child ends too: no robot outlives its parent.
"""

from __future__ import annotations

import json
from collections.abc import Mapping


def line(message: Mapping[str, object]) -> bytes:
    """One message as it goes over the pipe."""
    return json.dumps(message, separators=(",", ":")).encode() + b"\n"


def parse(raw: bytes) -> dict[str, object]:
    """The message in a line.

    Raises
    ------
    ValueError : no JSON object
    """
    message = json.loads(raw)
    if not isinstance(message, dict):
        raise ValueError(f"expected an object; found {raw[:80]!r}")
    return message


MAX_LINE = 16 << 20
"""Longest line that is read, bytes: the revisions and statistics of a large fleet."""
