"""What a robot tells a watcher of itself, and what the watcher makes of it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from fleetmap.accounting import Count
from fleetmap.codecs import envelope
from fleetmap.codecs.messages import MAX_PROBLEM_BYTES, MAX_PROBLEMS, MAX_TALLIES, StatsMessage, Tally
from fleetmap.engine import Engine

DM2_A_M2 = 100


def own_figures(engine: Engine, problems: Iterable[str], *, age_s: float) -> bytes:
    """The answer to a watcher, from the ledger; it is counted apart from all that the robot says by itself.

    May be called from any thread, beside an engine at work: the ledger has a lock, and a stream never changes.
    """
    sent, grids, watched, explored_m2 = engine.ledger.said()
    message = StatsMessage(
        max(0, round(1000 * age_s)),
        len(engine.neighbours.robots()),
        engine.own.edges,
        round(explored_m2 * DM2_A_M2),
        _tally(watched),
        _tallies(sent),
        _tallies(grids),
        tuple(shortened(text) for text in problems)[:MAX_PROBLEMS],
    )
    payload = envelope.encode(message)
    engine.ledger.watched(len(payload))
    return payload


def shortened(text: str) -> str:
    """As much of a text as a message takes."""
    return text.encode()[:MAX_PROBLEM_BYTES].decode(errors="ignore")


def counts(tallies: Mapping[str, Tally]) -> dict[str, Count]:
    """What a message tells, as the ledger holds it."""
    return {name: Count(*tally) for name, tally in tallies.items()}


def _tally(count: Count) -> Tally:
    return count.messages, count.size_bytes, count.segments


def _tallies(counts: Mapping[str, Count]) -> dict[str, Tally]:
    return {name: _tally(count) for name, count in sorted(counts.items())[:MAX_TALLIES]}
