"""What the fold reads: the streams of one component, placed by integers alone."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from fleetmap.codecs.messages import Revision
from fleetmap.engine.components import Components
from fleetmap.engine.stream import Key, Stream
from fleetmap.merge.protocol import Source
from fleetmap.model.errors import ConfigError
from fleetmap.model.frame import Frame
from fleetmap.model.pose import FixedPose

if TYPE_CHECKING:
    from fleetmap.engine.engine import Engine


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """What belongs to one component: the own robot's, or who has no map and no start sees that of the most robots.

    Parameters
    ----------
    sources : its maps
    revisions : (robot, revision) of the streams that they come from
    left_out : (frame, reason) of maps whose start and anchor are each in their bounds, and both together beyond them
    poses : T_component_robot of each of these streams
    T_merged_robot : where the own map frame lies in the component's; None: it is that, and nothing says where it lies
    frame : whose map frame the component's is; None: it is the fleet's, in which starts are given
    """

    sources: tuple[Source, ...]
    revisions: tuple[tuple[str, Revision], ...]
    left_out: tuple[tuple[Frame, str], ...]
    poses: tuple[FixedPose, ...] = ()
    T_merged_robot: FixedPose | None = None
    frame: str | None = None


def view(engine: Engine) -> View:
    """All streams of the own component: those that alignments connect with the own one, and those that have a start.

    A stream that nothing connects is a component of its own, in its robot's map frame. Who has neither a map nor a
    start, an operator's computer, sees what most robots have become; of equal ones that of the smallest name.
    """
    streams, components = engine.placed_streams(), engine.components()
    seen = engine.own.key
    if alone(engine.own, components) and not engine.own.edges:
        seen = most_robots(streams, components) or seen
    members = set(components.members(seen))
    mine = [stream for stream in streams if stream.key in members]
    sources, unplaced = sources_of(mine, components)
    revisions = tuple((s.robot, s.revision) for s in mine)
    own = None if alone(engine.own, components) else components.pose(engine.own.key)
    name, _ = components.poses[seen]
    started = any(stream.key == name and stream.start is not None for stream in mine)
    return View(
        tuple(sources), revisions, tuple(unplaced), poses_of(mine, components), own, None if started else name[0]
    )


def alone(own: Stream, components: Components) -> bool:
    """Whether nothing says where a stream lies."""
    return own.start is None and components.members(own.key) == [own.key]


def most_robots(streams: Iterable[Stream], components: Components) -> Key | None:
    """The name of the component with the most robots that have a map; None if there is none."""
    robots: dict[Key, set[str]] = {}
    for stream in streams:
        if stream.edges:
            robots.setdefault(components.poses[stream.key][0], set()).add(stream.robot)
    return min(robots, key=lambda name: (-len(robots[name]), name), default=None)


def poses_of(streams: Iterable[Stream], components: Components) -> tuple[FixedPose, ...]:
    """T_component_robot of each: with equal revisions they may differ, as what somebody else says may move them."""
    return tuple(components.pose(stream.key) or FixedPose() for stream in streams)


def sources_of(streams: Iterable[Stream], components: Components) -> tuple[list[Source], list[tuple[Frame, str]]]:
    """Their submaps where they lie in their component, and (frame, reason) of those that no pose can put there."""
    sources, left_out = [], []
    for stream in streams:
        T_component_robot = components.pose(stream.key) or FixedPose()
        for name, vector_map in sorted(stream.submaps.items()):
            frame, anchor = (stream.robot, stream.life, name), stream.anchor(name)
            try:
                T_fleet_frame = T_component_robot @ anchor
            except ConfigError as error:
                left_out.append((frame, f"start and anchor together: {error}"))
            else:
                sources.append(Source(frame, T_fleet_frame, vector_map))
    return sources, left_out
