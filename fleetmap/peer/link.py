"""What a peer needs of a transport. ``zenoh_link`` and ``memory_link`` provide it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Protocol

from fleetmap.engine import Input
from fleetmap.peer.health import Problem

Token = tuple[str, int]
"""(robot, life) of a peer that is there."""


@dataclass(frozen=True, slots=True)
class Network:
    """What a link is connected to.

    Parameters
    ----------
    reached : somebody was, since it was opened; or nobody was to be dialled
    problems : what is wrong
    addresses : where others reach it; empty while that isn't known
    """

    reached: bool = True
    problems: tuple[Problem, ...] = ()
    addresses: tuple[str, ...] = ()


class Receiver(Protocol):
    """Where a link delivers."""

    def deliver(self, item: Input) -> None:
        """A sample, a token that appeared or vanished, or a question. From any thread; must neither block nor raise."""


class Link(Protocol):
    """A transport. ``open`` comes first and ``close`` last; the others may be called from any thread."""

    async def open(self, receiver: Receiver) -> list[Token]:
        """Connect; returns the peers that are there. Raises ``LinkError`` if that fails for good."""
        ...

    async def show(self, life: int) -> None:
        """Show the own token, and be asked and publish under this life, instead of the one before."""
        ...

    def put(self, life: int, kind: str, payload: bytes) -> None:
        """Publish under the own key, as the word of a life. Never blocks; may lose the payload."""
        ...

    def ask(
        self,
        peer: Token,
        kind: str,
        payload: bytes,
        *,
        on_reply: Callable[[bytes], None],
        on_end: Callable[[], None],
    ) -> None:
        """Query a key of a peer; ``on_end`` is called once, after the last reply."""
        ...

    async def tokens(self) -> list[Token]:
        """The peers that are there now."""
        ...

    async def look(self, seen: Collection[str], heard: Sequence[str]) -> Network:
        """What it is connected to now, and why not to more. To be called each second or so.

        Parameters
        ----------
        seen : names of robots that are there, or heard by way of others
        heard : where others have said that they listen; dialled, too, where nobody else is reached
        """
        ...

    async def close(self) -> None:
        """Disconnect; nothing is delivered after it. May be called twice."""
        ...
