"""Keeps the merged map of what the engine holds, and tells the readers of ``changes()``."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import replace
from functools import partial

import numpy as np

from fleetmap.engine import MapChanged
from fleetmap.engine.view import View
from fleetmap.model.frame import Frame
from fleetmap.model.mergedmap import MergedMap
from fleetmap.model.threads import in_thread
from fleetmap.peer.changes import ChangeQueue, RevisionVector

LOOK_S = 0.05
LONGEST_PAUSE_S = 30.0
"""Where nobody looks at the merged map, each fold is followed by a pause twice as long, up to this one."""
FOLD_SHARE = 3.0
"""After a fold that took t, the next one that nobody waits for starts at least this many times t later."""


class Folder:
    """Folds in a thread, one fold at a time, and never twice for the same revisions.

    Parameters
    ----------
    robot : whose the merged map is, for the log
    look : gives what is to be folded now
    interval_s : at least so long between two folds that nobody waits for
    clock : seconds, only ever growing
    """

    def __init__(
        self, robot: str, look: Callable[[], Awaitable[View]], *, interval_s: float, clock: Callable[[], float]
    ) -> None:
        self._merged, self._looked_at = MergedMap(np.zeros((0, 8), np.int32)), False
        self.view = View((), (), ())
        """What ``merged`` was made of, but for the maps."""
        self.folded = False
        """Whether ``merged`` was ever brought up to date."""
        self.readers: set[ChangeQueue] = set()
        self._look, self._interval_s, self._clock = look, interval_s, clock
        self._robot = robot
        self._events: list[MapChanged] = []
        self._turn, self._dirty = asyncio.Lock(), asyncio.Event()

    @property
    def merged(self) -> MergedMap:
        """The last one. Any thread may look at it."""
        self._looked_at = True
        return self._merged

    def is_of(self, view: View) -> bool:
        """Whether ``merged`` was made of what is seen there."""
        return (self.view.revisions, self.view.poses) == (view.revisions, view.poses)

    @property
    def revisions(self) -> RevisionVector:
        """Of the streams that ``merged`` was made of."""
        return self.view.revisions

    def add(self, events: Iterable[MapChanged]) -> None:
        """Streams changed. Of the own one its robot wants to know whether it is merged."""
        events = list(events)
        self._looked_at |= any(event.frame[0] == self._robot for event in events)
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
                if not self.is_of(view):
                    from fleetmap.merge import fold

                    merged = await in_thread(partial(fold, view.sources))
                    if view.left_out:
                        merged = replace(merged, left_out=tuple(sorted({*merged.left_out, *view.left_out})))
                    self._merged, self.view = merged, replace(view, sources=())
                self.folded = True
            except BaseException:
                # Who waited gave up: the readers still want to know.
                self._events = events + self._events
                self._dirty.set()
                raise
            for reader in self.readers:
                reader.add(events, view.revisions)
            return self._merged

    async def run(self) -> None:
        """Refresh whenever something changed, leave most of the time to others, and nearly all if nobody looks."""
        unseen_s = 0.0
        while True:
            await self._dirty.wait()
            began_s = self._clock()
            await self.refresh()
            self._looked_at = False
            pause_s = max(self._interval_s, FOLD_SHARE * (self._clock() - began_s))
            await asyncio.sleep(pause_s)
            unseen_s = min(LONGEST_PAUSE_S, 2 * max(unseen_s, pause_s))
            until_s = self._clock() + unseen_s - pause_s
            while not (self._looked_at or self.readers) and self._clock() < until_s:  # noqa: ASYNC110 - any thread looks
                await asyncio.sleep(max(pause_s, LOOK_S))
            if self._looked_at or self.readers:
                unseen_s = 0.0

    @property
    def left_out(self) -> tuple[tuple[Frame, str], ...]:
        """(frame, reason) of what the last fold left out. Any thread may ask."""
        return self._merged.left_out

    def close(self) -> None:
        """Tell the readers that no more will come."""
        for reader in self.readers:
            reader.close()
