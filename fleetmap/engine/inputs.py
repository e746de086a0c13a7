"""What goes into the engine from the link: written down here, and nowhere else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True, slots=True)
class Message:
    """A sample under ``robot/kind/life``."""

    robot: str
    life: int
    kind: str
    payload: bytes


@dataclass(frozen=True, slots=True)
class Alive:
    """The liveliness token of a life appeared."""

    robot: str
    life: int


@dataclass(frozen=True, slots=True)
class Foreign:
    """The token of a robot appeared or vanished that this version can't read."""

    robot: str
    alive: bool


@dataclass(frozen=True, slots=True)
class Gone:
    """The liveliness token of a life vanished."""

    robot: str
    life: int


class Replying(Protocol):
    """Answers a question: once for good, also with nothing, and before that as often as one likes."""

    def __call__(self, payloads: Sequence[bytes], *, last: bool = True) -> None:
        """Send these."""


@dataclass(frozen=True, slots=True)
class Query:
    """A question under the own key ``kind``."""

    kind: str
    payload: bytes
    reply: Replying


@dataclass(frozen=True, slots=True)
class Reply:
    """A reply to an ``Ask``."""

    ask_id: int
    payload: bytes


@dataclass(frozen=True, slots=True)
class ReplyEnd:
    """No more replies to an ``Ask`` will come."""

    ask_id: int


Input = Message | Alive | Foreign | Gone | Query | Reply | ReplyEnd
