"""What the fold reads: the streams of one component, placed by integers alone."""

from __future__ import annotations

from dataclasses import dataclass

from fleetmap.codecs.messages import Revision
from fleetmap.engine.engine import Engine
from fleetmap.merge.protocol import Source
from fleetmap.model.errors import ConfigError


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """The sources of the component that holds the own robot, and the revisions that they come from."""

    sources: tuple[Source, ...]
    revisions: tuple[tuple[str, Revision], ...]


def view(engine: Engine) -> View:
    """All streams of the own level whose start is known; the own one alone while its start is not.

    A stream without a start is a component of its own, in its robot's map frame.
    """
    own = engine.own
    if own.header.start is None:
        streams = [own]
    else:
        held = engine.holdings.streams()
        streams = [s for s in held if s.header.start is not None and s.header.level == own.header.level]
    sources = []
    for stream in streams:
        for name, submap in sorted(stream.submaps.items()):
            start = stream.header.start
            try:
                T_fleet_frame = submap.anchor if start is None else start @ submap.anchor
            except ConfigError:
                continue  # each in its bounds, and both together beyond them: nobody can place it
            sources.append(Source((stream.robot, stream.epoch, name), T_fleet_frame, submap.vector_map))
    return View(tuple(sources), tuple((s.robot, s.revision) for s in streams))
