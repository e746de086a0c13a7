"""Facts: what an author says beside edges. A kind is one file, and a line in ``CHECKS``."""

from collections.abc import Callable, Mapping

from fleetmap.codecs.facts import addresses, anchor, forgotten, level, lives, start, superseded
from fleetmap.codecs.facts.addresses import addresses_of, set_addresses
from fleetmap.codecs.facts.anchor import anchor_of, set_anchor
from fleetmap.codecs.facts.facts import Facts, FactsStep, check_bounds
from fleetmap.codecs.facts.forgotten import forget, forgotten_streams
from fleetmap.codecs.facts.level import level_of, set_level
from fleetmap.codecs.facts.lives import name_lives, named_lives
from fleetmap.codecs.facts.start import set_start, start_of
from fleetmap.codecs.facts.state import State
from fleetmap.codecs.facts.superseded import supersede, superseded_lives

CHECKS: dict[int, Callable[[bytes, bytes], None]] = {
    kind.KIND: kind.check for kind in (level, start, anchor, lives, superseded, forgotten, addresses)
}


def check_facts(facts: Mapping[bytes, bytes]) -> None:
    """``ValueError`` (or ``ConfigError``) if there are too many facts, or one of a known kind isn't what it must be."""
    check_bounds(facts)
    for key, value in facts.items():
        if key[0] in CHECKS:
            CHECKS[key[0]](key[1:], value)


__all__ = [
    "CHECKS",
    "Facts",
    "FactsStep",
    "State",
    "addresses_of",
    "anchor_of",
    "check_facts",
    "forget",
    "forgotten_streams",
    "level_of",
    "name_lives",
    "named_lives",
    "set_addresses",
    "set_anchor",
    "set_level",
    "set_start",
    "start_of",
    "supersede",
    "superseded_lives",
]
