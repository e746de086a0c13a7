"""Whether a map may be said: it must find its place in the merged map, and put no other robot's out of it."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable
from functools import reduce
from operator import or_
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from fleetmap.engine.components import Components
from fleetmap.engine.stream import Stream
from fleetmap.engine.view import sources_of
from fleetmap.merge.fold import canonical
from fleetmap.merge.origin import MAX_EXTENT, Box, in_metres
from fleetmap.merge.place import to_fleet
from fleetmap.merge.protocol import Source
from fleetmap.model.errors import ConfigError
from fleetmap.model.pose import FixedPose

_rough_boxes: WeakKeyDictionary[Stream, tuple[FixedPose | None, Box | None]] = WeakKeyDictionary()
"""See ``rough_box``: most streams stay as they are between two of the own steps."""

LIMIT = (
    f"the maps of a component may extend {in_metres(MAX_EXTENT)} along each axis, "
    "which is what the fleet lattice of 5 mm holds"
)


def check_reach(
    before: Stream,
    after: Stream,
    held: Iterable[Stream],
    components_with: Callable[[Stream], Components],
    *,
    submap: str | None = None,
) -> None:
    """Check the step of the own stream to ``after``: its start if ``submap`` is None, else that submap.

    Parameters
    ----------
    before : what the own stream says now
    held : all streams that are held
    components_with : where all of them lie, if the own stream were that one

    Raises
    ------
    ConfigError : a map would extend farther than ``MAX_EXTENT``, by itself or together with another of the component.
        Maps that the merged one leaves out now and would leave out then don't count: who puts one far away can't
        silence the others.
    """

    def refuse(reason: str) -> ConfigError:
        start = after.start
        if submap is not None:
            return ConfigError(option="submap", value=submap, reason=reason)
        return ConfigError(option="start", value=start and start.to_pose(), reason=reason)

    components = components_with(after)
    own, unplaced = sources_of([after], components)
    for _, reason in unplaced:
        raise refuse(reason)
    for source in own:
        try:
            source.T_fleet_frame @ source.vector_map.lattice.T_frame_lattice
        except ConfigError as error:
            raise refuse(f"start, anchor and origin together: {error}") from error

    # 1. Mostly all lies together, and no edge need be looked at.
    members = set(components.members(after.key))
    rest = [stream for stream in held if stream.key in members and stream.key != after.key]
    boxes = [box for stream in (after, *rest) if (box := rough_box(stream, components)) is not None]
    if not boxes or reduce(or_, boxes).extent <= MAX_EXTENT:
        return

    # 2. Each map of the step, by itself and with the other own ones.
    exact = {s.frame: Box.of(_points(s)) for s in own if len(s.vector_map)}
    step = {frame: box for frame, box in exact.items() if submap in (None, frame[2])}
    for frame, box in step.items():
        if box.extent > MAX_EXTENT:
            raise refuse(f"submap {frame[2]} extends {in_metres(box.extent)}; {LIMIT}")
        for other, there in exact.items():
            if (extent := (box | there).extent) > MAX_EXTENT:
                raise refuse(f"submaps {frame[2]} and {other[2]} together extend {in_metres(extent)}; {LIMIT}")

    # 3. With those that are in the merged map now, or would be.
    sources = sources_of(rest, components)[0]
    was = components_with(before)
    was_there = members <= set(was.members(before.key))
    own_now = sources_of([before], was)[0] if was_there else []
    now, then = (canonical([*sources, *those]) for those in (own_now, own))
    kept = {frame for found in (now, then) for frames in found.frames for frame in frames}
    for source in sources:
        if source.frame not in kept or not len(source.vector_map):
            continue
        there = Box.of(_points(source))
        for box in step.values():
            if (extent := (box | there).extent) > MAX_EXTENT:
                robot, life, name = source.frame
                raise refuse(
                    f"together with submap {name} of {robot} (life {life:016x}) it extends {in_metres(extent)}; "
                    f"{LIMIT}. Is the start right? If the other map is wrong, forget({robot!r}) drops it"
                )


def rough_box(stream: Stream, components: Components) -> Box | None:
    """Where the maps of a stream lie at most, by the corners around each; None if there are none."""
    pose = components.pose(stream.key)
    known = _rough_boxes.get(stream)
    if known is None or known[0] != pose:
        boxes = []
        for source in sources_of([stream], components)[0]:
            bounds = source.vector_map.bounds_yx
            if bounds is not None:
                y0, x0, y1, x1 = bounds
                corners = np.array([(y0, x0), (y0, x1), (y1, x0), (y1, x1)])
                with contextlib.suppress(ConfigError):  # nobody can place it
                    boxes.append(Box.of(to_fleet(source.T_fleet_frame, source.vector_map.lattice, corners)))
        known = _rough_boxes[stream] = pose, reduce(or_, boxes) if boxes else None
    return known[1]


def _points(source: Source) -> NDArray[np.int64]:
    points = source.vector_map.edges[:, :4].astype(np.int64).reshape(-1, 2)
    return to_fleet(source.T_fleet_frame, source.vector_map.lattice, points)
