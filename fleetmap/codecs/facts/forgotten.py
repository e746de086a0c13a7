"""Kind 6: a stream that an operator forgets at every peer, as it was then: all leave it out of the merged map.

A revision is named, not a stream for ever: a robot that lives, or comes back, is in the map again with its next word.
"""

from __future__ import annotations

from collections.abc import Mapping

from fleetmap.codecs.facts.facts import Facts, FactsStep
from fleetmap.codecs.facts.state import State, pack_state, unpack_state
from fleetmap.codecs.names import check_name

KIND = 6
LIFE_BYTES = 8


def forgotten_streams(facts: Facts) -> dict[tuple[str, int], State]:
    """(robot, life) -> its (seq, link) that is forgotten."""
    return {
        (subject[LIFE_BYTES:].decode(), int.from_bytes(subject[:LIFE_BYTES], "big")): unpack_state(value)
        for subject, value in facts.of(KIND).items()
    }


def forget(streams: Mapping[tuple[str, int], State]) -> FactsStep:
    """The step that says that these are forgotten."""
    return {
        bytes([KIND]) + life.to_bytes(LIFE_BYTES, "big") + robot.encode(): pack_state(state)
        for (robot, life), state in streams.items()
    }


def check(subject: bytes, value: bytes) -> None:
    """``ValueError`` (or ``ConfigError``) if this is no such fact."""
    if len(subject) <= LIFE_BYTES:
        raise ValueError("expected a life and a robot")
    check_name("robot", subject[LIFE_BYTES:].decode())
    unpack_state(value)
