"""Facts: what an author says beside edges. A kind is one file, and a line in ``CHECKS``."""

from collections.abc import Callable, Mapping

from fleetmap.codecs.facts import (
    addresses,
    alignment,
    anchor,
    forgotten,
    level,
    lives,
    seen,
    sigma,
    start,
    superseded,
    verdict,
)
from fleetmap.codecs.facts.addresses import addresses_of, set_addresses
from fleetmap.codecs.facts.alignment import (
    AlignmentFact,
    Weight,
    alignment_of,
    alignments_of,
    drop_alignment,
    set_alignment,
)
from fleetmap.codecs.facts.anchor import anchor_of, set_anchor
from fleetmap.codecs.facts.facts import Facts, FactsStep, check_bounds
from fleetmap.codecs.facts.forgotten import forget, forgotten_streams
from fleetmap.codecs.facts.level import level_of, set_level
from fleetmap.codecs.facts.lives import name_lives, named_lives
from fleetmap.codecs.facts.seen import Seen, landmarks_of, set_landmark, set_sighting, sightings_of
from fleetmap.codecs.facts.sigma import set_start_sigma, start_sigma_of
from fleetmap.codecs.facts.start import set_start, start_of
from fleetmap.codecs.facts.state import State
from fleetmap.codecs.facts.superseded import supersede, superseded_lives
from fleetmap.codecs.facts.verdict import About, Verdict, drop_verdict, set_verdict, verdicts_of

CHECKS: dict[int, Callable[[bytes, bytes], None]] = {
    kind.KIND: kind.check
    for kind in (level, start, anchor, lives, superseded, forgotten, addresses, alignment, verdict, sigma, seen)
}


def check_facts(facts: Mapping[bytes, bytes]) -> None:
    """``ValueError`` (or ``ConfigError``) if there are too many facts, or one of a known kind isn't what it must be."""
    check_bounds(facts)
    for key, value in facts.items():
        if key[0] in CHECKS:
            CHECKS[key[0]](key[1:], value)


__all__ = [
    "CHECKS",
    "About",
    "AlignmentFact",
    "Facts",
    "FactsStep",
    "Seen",
    "State",
    "Verdict",
    "Weight",
    "addresses_of",
    "alignment_of",
    "alignments_of",
    "anchor_of",
    "check_facts",
    "drop_alignment",
    "drop_verdict",
    "forget",
    "forgotten_streams",
    "landmarks_of",
    "level_of",
    "name_lives",
    "named_lives",
    "set_addresses",
    "set_alignment",
    "set_anchor",
    "set_landmark",
    "set_level",
    "set_sighting",
    "set_start",
    "set_start_sigma",
    "set_verdict",
    "sightings_of",
    "start_of",
    "start_sigma_of",
    "supersede",
    "superseded_lives",
    "verdicts_of",
]
