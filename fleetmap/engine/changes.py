"""What a step from one revision to the next did, for the user: one event for each submap that changed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.engine.outputs import MapChanged
from fleetmap.engine.stream import Step, Stream


def changed_events(step: Step) -> list[MapChanged]:
    """One event a changed submap, in order of their names; one with submap "" where only facts changed."""
    new, old = step.after, step.before
    moved = {name for name in new.submaps if name in old.submaps and new.anchor(name) != old.anchor(name)}
    names = sorted(step.deltas.keys() | moved)
    return [_event(step, name, moved=name in moved) for name in names] or [no_edge_changed(new)]


def no_edge_changed(stream: Stream) -> MapChanged:
    """The event of facts alone."""
    return MapChanged((*stream.key, ""), None, 0, 0, stream.revision)


def gone_event(stream: Stream) -> MapChanged:
    """The event of a stream that was dropped."""
    return MapChanged((*stream.key, ""), None, 0, stream.edges, stream.revision)


def _event(step: Step, name: str, *, moved: bool) -> MapChanged:
    new, delta = step.after, step.deltas.get(name)
    if delta is None:
        edges, added, removed = new.submaps[name].edges, 0, 0
    else:
        # A moved anchor moves every edge.
        parts = [delta.removed, delta.added, delta.rethickened]
        edges = new.submaps[name].edges if moved else np.concatenate(parts)
        added, removed = len(delta.added), len(delta.removed)
    return MapChanged((*new.key, name), _box_m(edges, new, name), added, removed, new.revision)


def _box_m(edges: NDArray[np.int32], stream: Stream, name: str) -> tuple[float, float, float, float] | None:
    if len(edges) == 0:
        return None
    points_xy = stream.submaps[name].lattice.to_metres(edges[:, :4].reshape(-1, 2))
    points_xy = stream.anchor(name).to_pose().apply(points_xy)
    (x0, y0), (x1, y1) = points_xy.min(axis=0), points_xy.max(axis=0)
    return (float(x0), float(y0), float(x1), float(y1))
