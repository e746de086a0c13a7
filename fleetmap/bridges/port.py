"""``Port``: the ROS side, whichever way it is reached. Bytes in and out are CDR."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from fleetmap.bridges.qos import Qos

Take = Callable[[bytes], None]
"""Takes a message that came in, on any thread; doesn't raise and doesn't wait."""
Say = Callable[[bytes], None]
"""Publishes a message; doesn't raise and doesn't wait."""


class Port(Protocol):
    """A node of a ROS graph. Topics are relative to its namespace unless they begin with ``/``."""

    def subscribe(self, topic: str, type_name: str, qos: Qos, take: Take) -> None:
        """Have ``take`` called with each message of a topic, from ``open`` on."""

    def advertise(self, topic: str, type_name: str, qos: Qos) -> Say:
        """Offer a topic, from ``open`` on; returns what publishes on it. Latched messages may be said before."""

    async def open(self) -> None:
        """Be there; waits for whatever has to be there first."""

    async def close(self) -> None:
        """Be gone. May be called twice."""

    def now_ns(self) -> int:
        """ROS time: the clock on the wall, or the simulation's; 0 while that hasn't been heard."""

    def resolve(self, topic: str) -> str:
        """The whole name of a topic."""

    def topics_of(self, type_name: str) -> list[str]:
        """Topics of that type that somebody else offers now."""

    def problems(self) -> dict[str, str]:
        """What keeps it from ROS, by whom it is about."""

    def is_reached(self) -> bool:
        """Whether nodes of ROS can be heard at all."""

    def where(self) -> str:
        """In words, which graph it is in, for those who look for it in another one."""
