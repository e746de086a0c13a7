"""Which lives of a robot are kept: a function of what its streams say, whoever is alive, in whatever order they came.

A robot that starts anew begins another life, and its former ones stay in the merged map. Once it has heard of them it
names them, and of those that are named four stay: so a fleet doesn't fill up with the lives of a robot that starts
each hour, and whoever was out of reach loses nothing.
"""

from __future__ import annotations

from collections.abc import Iterable

from fleetmap.engine.stream import Stream

NAMED_KEPT = 4
"""Lives kept of those that another life names: the ones with the most edges."""


def kept_lives(streams: Iterable[Stream]) -> set[int]:
    """The lives to be kept of one robot.

    Notes
    -----
    All that no other one names, and of the named ones the four with the most edges; of equally many, the greater life.
    One that another supersedes, as it is, is not kept. Two that name (or supersede) each other live at the same time,
    and neither counts.

    A life that is dropped stays dropped when it is offered again: who names it is still there, and the four that have
    more edges, too. For that, an author names what the lives that it names have named (``all_named``).
    """
    lives = [s for s in streams if s.seq > 0]
    supersedes = {s.life: s.supersedes for s in lives}
    states = {s.life: s.state for s in lives}

    def replaces(a: int, b: int) -> bool:
        return a != b and supersedes[a].get(b) == states[b]

    ended = {b for b in states if any(replaces(a, b) and not replaces(b, a) for a in states)}
    rest = [s for s in lives if s.life not in ended]
    names = {s.life: s.names for s in rest}
    named = {b for a, those in names.items() for b in those if b in names and b != a and a not in names[b]}
    order = sorted((s for s in rest if s.life in named), key=lambda s: (s.edges, s.life), reverse=True)
    return (names.keys() - named) | {s.life for s in order[:NAMED_KEPT]}


def all_named(own: Stream, former: Iterable[Stream]) -> set[int]:
    """What the own stream should name: the former lives that are held, what it and they named, and what they replaced.

    ``former`` are the streams of the own name that nobody goes on with.
    """
    named = set(own.names)
    for stream in former:
        named |= {stream.life, *stream.names}
    return named - {own.life}
