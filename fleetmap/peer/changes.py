"""What ``Peer.changes()`` yields: one value per merged map that is new, however many records led to it."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from dataclasses import dataclass

from fleetmap.codecs.messages import Revision
from fleetmap.engine import MapChanged

RevisionVector = tuple[tuple[str, Revision], ...]
"""(robot, revision) of every stream that the merged map was made of, ascending."""


@dataclass(frozen=True, slots=True)
class Change:
    """What changed between two merged maps that a reader saw.

    Parameters
    ----------
    frames : (robot, life, submap) of all that changed, ascending
    box_m : (x_min, y_min, x_max, y_max) in metres in each frame's robot map frame, one for each of ``frames``;
        None where no edge changed
    edges_added, edges_removed : edges of the replicas, summed
    revisions : what the merged map is made of now
    """

    frames: tuple[tuple[str, int, str], ...]
    boxes_m: tuple[tuple[float, float, float, float] | None, ...]
    edges_added: int
    edges_removed: int
    revisions: RevisionVector


class ChangeQueue:
    """Events for one reader, merged by frame until it takes them: bounded by the number of frames."""

    def __init__(self) -> None:
        self._waiting: dict[tuple[str, int, str], MapChanged] = {}
        self._revisions: RevisionVector = ()
        self._filled = asyncio.Event()
        self.closed = False

    def add(self, events: Iterable[MapChanged], revisions: RevisionVector) -> None:
        """Events that are in the merged map now."""
        for event in events:
            before = self._waiting.get(event.frame)
            self._waiting[event.frame] = event if before is None else _joined(before, event)
        self._revisions = revisions
        if self._waiting:
            self._filled.set()

    def close(self) -> None:
        """No more will come."""
        self.closed = True
        self._filled.set()

    async def take(self) -> Change | None:
        """The changes since the last call, as soon as there are any; None when the peer is closed."""
        await self._filled.wait()
        if not self._waiting:
            return None
        if not self.closed:
            self._filled.clear()
        events = [self._waiting[frame] for frame in sorted(self._waiting)]
        self._waiting = {}
        return Change(
            tuple(e.frame for e in events),
            tuple(e.box_m for e in events),
            sum(e.edges_added for e in events),
            sum(e.edges_removed for e in events),
            self._revisions,
        )


def _joined(a: MapChanged, b: MapChanged) -> MapChanged:
    boxes = [box for box in (a.box_m, b.box_m) if box is not None]
    box = None
    if boxes:
        box = (
            min(x[0] for x in boxes),
            min(x[1] for x in boxes),
            max(x[2] for x in boxes),
            max(x[3] for x in boxes),
        )
    return MapChanged(a.frame, box, a.edges_added + b.edges_added, a.edges_removed + b.edges_removed, b.revision)
