"""What a peer needs of a transport. ``zenoh_link`` and ``memory_link`` provide it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True, slots=True)
class Token:
    """A living peer: its name, its epoch, and what tells it from another one of that name."""

    robot: str
    epoch: int
    instance: str


class Receiver(Protocol):
    """Where a link delivers. May be called from any thread; must neither block nor raise."""

    def message(self, robot: str, suffix: str, payload: bytes) -> None:
        """A sample under the key of another robot."""

    def alive(self, token: Token) -> None:
        """A peer's token appeared."""

    def gone(self, token: Token) -> None:
        """A peer's token vanished."""

    def query(self, suffix: str, payload: bytes, reply: Callable[[Sequence[bytes]], None]) -> None:
        """A question under the own key; ``reply`` must be called once, also with nothing."""


class Link(Protocol):
    """A transport. ``open`` comes first and ``close`` last; the others may be called from any thread."""

    async def open(self, receiver: Receiver) -> list[Token]:
        """Connect; returns the peers that are alive. Raises ``LinkError`` if that fails for good."""
        ...

    async def declare_alive(self, epoch: int, instance: str) -> None:
        """Show the own token, instead of the one before."""
        ...

    def put(self, suffix: str, payload: bytes) -> None:
        """Publish under the own key. Never blocks; may lose the payload."""
        ...

    def ask(
        self, robot: str, suffix: str, payload: bytes, *, on_reply: Callable[[bytes], None], on_end: Callable[[], None]
    ) -> None:
        """Query the key of another robot (``*``: of all); ``on_end`` is called once, after the last reply."""
        ...

    async def reopen(self) -> None:
        """Connect anew, with the token shown last; each peer's token is seen to vanish, and to appear if it lives."""
        ...

    async def close(self) -> None:
        """Disconnect; nothing is delivered after it. May be called twice."""
        ...
