"""The bounded queue between a link's threads and the event loop."""

from __future__ import annotations

import asyncio
import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from fleetmap.accounting import Ledger
from fleetmap.peer.link import Token

MAX_ITEMS = 4096
MAX_BYTES = 64 << 20
"""Beyond these, samples, replies and questions are dropped and counted; the engine asks again for what it misses."""


@dataclass(frozen=True, slots=True)
class Message:
    """A sample under ``robot/suffix``."""

    robot: str
    suffix: str
    payload: bytes


@dataclass(frozen=True, slots=True)
class Alive:
    """A token appeared."""

    token: Token


@dataclass(frozen=True, slots=True)
class Gone:
    """A token vanished."""

    token: Token


@dataclass(frozen=True, slots=True)
class Query:
    """A question under the own key."""

    suffix: str
    payload: bytes
    reply: Callable[[Sequence[bytes]], None]


@dataclass(frozen=True, slots=True)
class Reply:
    """A reply to a question of ours."""

    ask_id: int
    payload: bytes


@dataclass(frozen=True, slots=True)
class ReplyEnd:
    """No more replies to a question of ours."""

    ask_id: int


Item = Message | Alive | Gone | Query | Reply | ReplyEnd


class Inbox:
    """Takes items from any thread without blocking; the loop takes them out in batches.

    Tokens and ends of replies are small, bounded by peers and questions, and never dropped.

    Parameters
    ----------
    loop : takes the items out
    ledger : counts what is dropped
    figures : what a watcher is answered. At once, from the link's thread: a robot that is busy is watched, too
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, ledger: Ledger, figures: Callable[[], bytes]) -> None:
        self._loop, self._ledger, self._figures = loop, ledger, figures
        self._items: deque[Item] = deque()
        self._size_bytes = 0
        self._lock = threading.Lock()
        self._filled = asyncio.Event()
        self._closed = False

    def message(self, robot: str, suffix: str, payload: bytes) -> None:
        """A sample came."""
        if not self._put(Message(robot, suffix, payload), len(payload)):
            self._ledger.dropped(robot, suffix.partition("/")[0], len(payload), reason="queue_full")

    def alive(self, token: Token) -> None:
        """A token appeared."""
        self._put(Alive(token), 0)

    def gone(self, token: Token) -> None:
        """A token vanished."""
        self._put(Gone(token), 0)

    def query(self, suffix: str, payload: bytes, reply: Callable[[Sequence[bytes]], None]) -> None:
        """A question came."""
        if suffix == "stats":
            reply([] if self._closed else [self._figures()])
        elif not self._put(Query(suffix, payload, reply), len(payload)):
            self._ledger.dropped("?", suffix.partition("/")[0], len(payload), reason="queue_full")
            reply([])

    def reply(self, ask_id: int, payload: bytes) -> None:
        """A reply came."""
        if not self._put(Reply(ask_id, payload), len(payload)):
            self._ledger.dropped("?", "reply", len(payload), reason="queue_full")

    def reply_end(self, ask_id: int) -> None:
        """The replies to a question are over."""
        self._put(ReplyEnd(ask_id), 0)

    async def take(self, timeout_s: float) -> list[Item]:
        """All items, as soon as there is one; none after the timeout."""
        try:
            # wait_for of Python 3.11 swallows a cancellation that meets the event.
            async with asyncio.timeout(timeout_s):
                await self._filled.wait()
        except TimeoutError:
            return []
        with self._lock:
            self._filled.clear()
            items, self._items, self._size_bytes = list(self._items), deque(), 0
        return items

    def close(self) -> None:
        """Take nothing more; unanswered questions are answered with nothing."""
        with self._lock:
            self._closed = True
            items, self._items = list(self._items), deque()
        for item in items:
            if isinstance(item, Query):
                item.reply([])

    def _put(self, item: Item, size_bytes: int) -> bool:
        with self._lock:
            full = len(self._items) >= MAX_ITEMS or self._size_bytes + size_bytes > MAX_BYTES
            if self._closed or (full and isinstance(item, Message | Query | Reply)):
                return False
            self._items.append(item)
            self._size_bytes += size_bytes
            if len(self._items) == 1:
                # Under the lock: ``close`` comes before the loop's own end.
                self._loop.call_soon_threadsafe(self._filled.set)
            return True
