"""What the fold reads: the streams of one component, placed by integers alone."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from fleetmap.codecs.messages import Header, Revision
from fleetmap.engine.stream import Stream
from fleetmap.merge.protocol import Frame, Source
from fleetmap.model.errors import ConfigError

if TYPE_CHECKING:
    from fleetmap.engine.engine import Engine


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """What belongs to the component that holds the own robot.

    Parameters
    ----------
    sources : its maps
    revisions : (robot, revision) of the streams that they come from
    left_out : (frame, reason) of maps whose start and anchor are each in their bounds, and both together beyond them
    """

    sources: tuple[Source, ...]
    revisions: tuple[tuple[str, Revision], ...]
    left_out: tuple[tuple[Frame, str], ...]


def view(engine: Engine) -> View:
    """All streams of the own level whose start is known; the own one alone while its start is not.

    A stream without a start is a component of its own, in its robot's map frame.
    """
    own = engine.own
    streams = sorted([own, *others(own.header, engine.holdings.streams(), own)], key=lambda s: (s.robot, s.epoch))
    sources, left_out = sources_of(streams)
    return View(tuple(sources), tuple((s.robot, s.revision) for s in streams), tuple(left_out))


def others(header: Header, held: Iterable[Stream], own: Stream) -> list[Stream]:
    """The streams that are in one component with the own one, if that has this header."""
    if header.start is None:
        return []
    return [s for s in held if s is not own and s.header.start is not None and s.header.level == header.level]


def sources_of(streams: Iterable[Stream]) -> tuple[list[Source], list[tuple[Frame, str]]]:
    """Their submaps where start and anchor put them, and (frame, reason) of those that no pose can put there."""
    sources, left_out = [], []
    for stream in streams:
        for name, submap in sorted(stream.submaps.items()):
            start, frame = stream.header.start, (stream.robot, stream.epoch, name)
            try:
                T_fleet_frame = submap.anchor if start is None else start @ submap.anchor
            except ConfigError as error:
                left_out.append((frame, f"start and anchor together: {error}"))
            else:
                sources.append(Source(frame, T_fleet_frame, submap.vector_map))
    return sources, left_out
