"""The bounded queue between a link's threads and the event loop."""

from __future__ import annotations

import asyncio
import threading
from collections import deque
from collections.abc import Callable

from fleetmap.accounting import Ledger
from fleetmap.engine import Input, Message, Query, Reply

MAX_ITEMS = 4096
MAX_BYTES = 16 << 20
"""Beyond these, samples, replies and questions are dropped and counted; the engine asks again for what it misses."""


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
        self._items: deque[Input] = deque()
        self._size_bytes = 0
        self._lock = threading.Lock()
        self._filled = asyncio.Event()
        self._closed = False

    def deliver(self, item: Input) -> None:
        """Something came."""
        match item:
            case Query("stats", _, reply):
                reply([] if self._closed else [self._figures()])
            case Message(robot, _, kind, payload):
                if not self._put(item, len(payload)):
                    self._ledger.dropped(robot, kind, len(payload), reason="queue_full")
            case Query(kind, payload, reply):
                if not self._put(item, len(payload)):
                    self._ledger.dropped("?", f"{kind}?", len(payload), reason="queue_full")
                    reply([])
            case Reply(_, payload):
                if not self._put(item, len(payload)):
                    self._ledger.dropped("?", "reply", len(payload), reason="queue_full")
            case _:
                self._put(item, 0)

    async def take(self, timeout_s: float) -> list[Input]:
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

    def _put(self, item: Input, size_bytes: int) -> bool:
        with self._lock:
            full = len(self._items) >= MAX_ITEMS or self._size_bytes + size_bytes > MAX_BYTES
            if self._closed or (full and isinstance(item, Message | Query | Reply)):
                return False
            self._items.append(item)
            self._size_bytes += size_bytes
            if len(self._items) == 1:
                try:
                    self._loop.call_soon_threadsafe(self._filled.set)
                except RuntimeError:  # the loop is closed, and nobody closed this peer before
                    self._closed = True
                    return False
            return True
