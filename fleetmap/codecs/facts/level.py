"""Kind 1: the level (storey) of a stream's maps; ``0`` unless it is said."""

from __future__ import annotations

from fleetmap.codecs.facts.facts import Facts, FactsStep
from fleetmap.codecs.names import check_name

KIND = 1
USUAL = "0"
_KEY = bytes([KIND])


def level_of(facts: Facts) -> str:
    """The level of a stream."""
    return facts.get(_KEY, USUAL.encode()).decode()


def set_level(level: str) -> FactsStep:
    """The step that says a level.

    Raises
    ------
    ConfigError : it is no name
    """
    check_name("level", level)
    return {_KEY: None if level == USUAL else level.encode()}


def check(subject: bytes, value: bytes) -> None:
    """``ValueError`` (or ``ConfigError``) if this is no such fact."""
    if subject:
        raise ValueError("a stream has one level")
    check_name("level", value.decode())
