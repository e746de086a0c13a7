"""What goes into the engine from the link: written down here, and nowhere else."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass


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
class Gone:
    """The liveliness token of a life vanished."""

    robot: str
    life: int


@dataclass(frozen=True, slots=True)
class Query:
    """A question under the own key ``kind``; ``reply`` is to be called once, also with nothing."""

    kind: str
    payload: bytes
    reply: Callable[[Sequence[bytes]], None]


@dataclass(frozen=True, slots=True)
class Reply:
    """A reply to an ``Ask``."""

    ask_id: int
    payload: bytes


@dataclass(frozen=True, slots=True)
class ReplyEnd:
    """No more replies to an ``Ask`` will come."""

    ask_id: int


Input = Message | Alive | Gone | Query | Reply | ReplyEnd
