"""Quality of service, as much of it as maps need: who is heard by whom, and what a late joiner gets."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Qos:
    """How a topic is said or heard.

    Parameters
    ----------
    reliable : else best effort
    latched : transient local: who comes later gets the last ``depth`` messages
    depth : so many are kept
    """

    reliable: bool = True
    latched: bool = False
    depth: int = 10


LATCHED = Qos(latched=True, depth=1)
"""Maps, as map_server, slam_toolbox and costmaps say them and nav2's static layer wants them."""
STREAM = Qos(depth=100)
"""/tf, and map updates: each of them counts."""
LATEST = Qos(depth=1)
"""What the next one replaces."""
