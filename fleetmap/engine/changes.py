"""What a step from one revision to the next did, for the user: one event for each submap that changed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.engine.outputs import Changed
from fleetmap.engine.stream import Stream, Submap
from fleetmap.model.delta import diff
from fleetmap.model.vectormap import VectorMap


def changed_events(old: Stream, new: Stream) -> list[Changed]:
    """One event a changed submap, in order of their names; one with submap "" where only the header changed."""
    events = []
    for name, submap in sorted(new.submaps.items()):
        before = old.submaps.get(name)
        if before is None or before.vector_map is not submap.vector_map or before.anchor != submap.anchor:
            events.append(_event(new, name, before, submap))
    if not events:
        events.append(Changed((new.robot, new.epoch, ""), None, 0, 0, new.revision))
    return events


def _event(new: Stream, name: str, before: Submap | None, submap: Submap) -> Changed:
    frame = (new.robot, new.epoch, name)
    vector_map = submap.vector_map
    if before is None or before.vector_map.lattice != vector_map.lattice:
        base = VectorMap.empty(vector_map.lattice)
    else:
        base = before.vector_map
    delta = diff(base, vector_map)
    # A moved anchor moves every edge.
    moved = before is not None and before.anchor != submap.anchor
    touched = vector_map.edges if moved else np.concatenate([delta.removed, delta.added, delta.rethickened])
    return Changed(frame, _box_m(touched, submap), len(delta.added), len(delta.removed), new.revision)


def _box_m(edges: NDArray[np.int32], submap: Submap) -> tuple[float, float, float, float] | None:
    if len(edges) == 0:
        return None
    points_xy = submap.vector_map.lattice.to_metres(edges[:, :4].reshape(-1, 2))
    points_xy = submap.anchor.to_pose().apply(points_xy)
    (x0, y0), (x1, y1) = points_xy.min(axis=0), points_xy.max(axis=0)
    return (float(x0), float(y0), float(x1), float(y1))
