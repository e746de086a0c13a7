"""What the fold reads: the streams of one component, placed by integers alone."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from fleetmap.codecs.messages import Revision
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
    own, left_out = engine.own, engine.left_out()
    held = [s for s in engine.holdings.streams() if s.key not in left_out]
    streams = sorted([own, *others(own, held)], key=lambda s: s.key)
    sources, unplaced = sources_of(streams)
    return View(tuple(sources), tuple((s.robot, s.revision) for s in streams), tuple(unplaced))


def others(own: Stream, held: Iterable[Stream]) -> list[Stream]:
    """The streams that are in one component with the own one."""
    if own.start is None:
        return []
    return [s for s in held if s.key != own.key and s.start is not None and s.level == own.level]


def sources_of(streams: Iterable[Stream]) -> tuple[list[Source], list[tuple[Frame, str]]]:
    """Their submaps where start and anchor put them, and (frame, reason) of those that no pose can put there."""
    sources, left_out = [], []
    for stream in streams:
        start = stream.start
        for name, vector_map in sorted(stream.submaps.items()):
            frame, anchor = (stream.robot, stream.life, name), stream.anchor(name)
            try:
                T_fleet_frame = anchor if start is None else start @ anchor
            except ConfigError as error:
                left_out.append((frame, f"start and anchor together: {error}"))
            else:
                sources.append(Source(frame, T_fleet_frame, vector_map))
    return sources, left_out
