"""Kind 4: former lives of the author's robot that the author holds.

Which lives are kept follows from it (``engine.lives``).
"""

from __future__ import annotations

from collections.abc import Iterable

from fleetmap.codecs.facts.facts import Facts, FactsStep

KIND = 4
MAX_NAMED = 256
LIFE_BYTES = 8


def named_lives(facts: Facts) -> frozenset[int]:
    """The lives that a stream names."""
    return frozenset(int.from_bytes(subject, "big") for subject in facts.of(KIND))


def name_lives(facts: Facts, lives: Iterable[int]) -> FactsStep:
    """The step after which these facts name these lives; of too many the greatest numbers."""
    wanted = set(sorted(lives)[-MAX_NAMED:])
    step: dict[bytes, bytes | None] = {_key(life): b"" for life in wanted}
    return step | {_key(life): None for life in named_lives(facts) - wanted}


def check(subject: bytes, value: bytes) -> None:
    """``ValueError`` if this is no such fact."""
    if len(subject) != LIFE_BYTES or value:
        raise ValueError("expected a life, and no value")


def _key(life: int) -> bytes:
    return bytes([KIND]) + life.to_bytes(LIFE_BYTES, "big")
