"""Keeps the merged map of what the engine holds, and tells the readers of ``changes()``."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable

import numpy as np

from fleetmap.engine import Changed
from fleetmap.engine.view import View
from fleetmap.model.mergedmap import MergedMap
from fleetmap.peer.changes import ChangeQueue, RevisionVector

FOLD_SHARE = 3.0
"""After a fold that took t, the next one that nobody waits for starts at least this many times t later."""


class Folder:
    """Folds in a thread, one fold at a time, and never twice for the same revisions.

    Parameters
    ----------
    look : gives what is to be folded now
    interval_s : at least so long between two folds that nobody waits for
    clock : seconds, only ever growing
    """

    def __init__(self, look: Callable[[], Awaitable[View]], *, interval_s: float, clock: Callable[[], float]) -> None:
        self.merged = MergedMap(np.zeros((0, 8), np.int32))
        self.revisions: RevisionVector = ()
        self.readers: set[ChangeQueue] = set()
        self._look, self._interval_s, self._clock = look, interval_s, clock
        self._events: list[Changed] = []
        self._turn, self._dirty = asyncio.Lock(), asyncio.Event()

    def add(self, events: Iterable[Changed]) -> None:
        """Streams changed."""
        self._events.extend(events)
        if self._events:
            self._dirty.set()

    async def refresh(self) -> MergedMap:
        """Fold all that is held now."""
        async with self._turn:
            self._dirty.clear()
            events, self._events = self._events, []
            try:
                view = await self._look()
                if view.revisions != self.revisions:
                    from fleetmap.merge import fold

                    self.merged = await asyncio.to_thread(fold, view.sources)
                    self.revisions = view.revisions
            except BaseException:
                # Who waited gave up: the readers still want to know.
                self._events = events + self._events
                self._dirty.set()
                raise
            for reader in self.readers:
                reader.add(events, view.revisions)
            return self.merged

    async def run(self) -> None:
        """Refresh whenever something changed, and leave most of the time to others."""
        while True:
            await self._dirty.wait()
            began_s = self._clock()
            await self.refresh()
            await asyncio.sleep(max(self._interval_s, FOLD_SHARE * (self._clock() - began_s)))

    def close(self) -> None:
        """Tell the readers that no more will come."""
        for reader in self.readers:
            reader.close()
