"""Kind 5: a former life of the author's robot that the author's own maps replace, as it was then.

A revision is named, not a life for ever: one that turns out to go on is back with its next word.
"""

from __future__ import annotations

from collections.abc import Mapping

from fleetmap.codecs.facts.facts import Facts, FactsStep
from fleetmap.codecs.facts.state import State, pack_state, unpack_state

KIND = 5
LIFE_BYTES = 8


def superseded_lives(facts: Facts) -> dict[int, State]:
    """Life -> its (seq, link) that is superseded."""
    return {int.from_bytes(subject, "big"): unpack_state(value) for subject, value in facts.of(KIND).items()}


def supersede(lives: Mapping[int, State]) -> FactsStep:
    """The step that says that these are superseded."""
    return {bytes([KIND]) + life.to_bytes(LIFE_BYTES, "big"): pack_state(state) for life, state in lives.items()}


def check(subject: bytes, value: bytes) -> None:
    """``ValueError`` if this is no such fact."""
    if len(subject) != LIFE_BYTES:
        raise ValueError("expected a life")
    unpack_state(value)
