"""Step 4: whether the best hypothesis is true. All thresholds, chosen on generated pairs (``benchmarks/align.py``)."""

from __future__ import annotations

from collections.abc import Iterable

from fleetmap.align.evidence import Evidence

LEAST_M, LEAST_LINES = 8.0, 4
"""Less wall than that, or on fewer lines, may meet by chance."""
LEAST_STRENGTH = 18.0
LINES_PER_M, LINES_PER_CONFLICT_M = 0.5, 15.0
"""A line of wall counts as two metres of it, and a tenth of a metre that is contradicted takes one and a half off. Of
11 000 generated pairs with nothing, or hardly anything, in common four came to 15 to 17.9, of those that nothing else
speaks against."""
CONFLICT_M, CONFLICT_SHARE = 0.1, 0.045
"""So much may be contradicted in any case, and so much of what is explained: things are moved between two visits."""
LEAST_SEEN = 0.7
"""Of the walls that both should have."""
LEAST_FIXED_M = 1.2
"""Wall across the direction in which the map would slide."""
MOST_RIVAL = 0.4
"""Of what the best place explains: another one that explains as much, and could be true, may as well be."""
RIVAL_SHARE, RIVAL_SEEN, RIVAL_CONFLICT_M = 0.95, 0.6, 1.0
"""Of walls that are explained or contradicted, of those that both should have, and how much more than of the best place
may be contradicted: what could be true."""
MOST_CHANCE = 10.0
"""Strength. Where two places fit better than that the building repeats itself, and the one that explains less may be
true: of two robots in wings that are alike, each knows its own wing, and both a part of what lies between."""
ROOM_M, MOST_RIVAL_OF_A_ROOM, MORE_SEEN = 9.0, 0.3, 1.5
"""What both have is hardly larger than a room. Others may be alike: if the maps show hardly more than that room, or a
part of another one that fits."""
PLAIN_LINES = 10
"""What both have has fewer lines of wall: then others may be alike as well, however large it is."""

MOST_MIRRORED = 0.7
"""Of what the best place explains. Buildings have wings that mirror each other, and what looks the same in a mirror
doesn't tell in which of both it is."""


def strength(evidence: Evidence) -> float:
    """How little it may be chance, in lines of wall."""
    against = LINES_PER_CONFLICT_M * evidence.conflict_m
    return evidence.lines + LINES_PER_M * evidence.explained_m - against


def is_enough(evidence: Evidence, least: float = LEAST_STRENGTH) -> bool:
    """Whether so much doesn't meet by chance."""
    many = evidence.explained_m >= LEAST_M and evidence.lines >= LEAST_LINES
    return many and strength(evidence) >= least


def is_contradicted(evidence: Evidence) -> bool:
    """Whether what was seen speaks against it."""
    conflict = evidence.conflict_m > CONFLICT_M + CONFLICT_SHARE * evidence.explained_m
    return conflict or evidence.explained_m < LEAST_SEEN * evidence.visible_m


def order(evidence: Evidence) -> tuple[bool, float]:
    """The best comes first: what may be true by itself, then what has the most left of what it explains.

    A true place that explains little is hardly contradicted; false ones that explain more are.
    """
    return not is_enough(evidence) or is_contradicted(evidence), -evidence.score_m


def rival(best: Evidence, elsewhere: Iterable[Evidence]) -> Evidence | None:
    """The best of those that could be true, too: what is hardly chance first, then what explains most."""
    possible = [
        evidence
        for evidence in elsewhere
        if evidence.explained_m >= RIVAL_SHARE * (evidence.explained_m + evidence.conflict_m)
        and evidence.explained_m >= RIVAL_SEEN * evidence.visible_m
        and evidence.conflict_m <= best.conflict_m + RIVAL_CONFLICT_M
    ]
    return max(possible, key=lambda evidence: (is_hardly_chance(evidence), evidence.explained_m), default=None)


def is_hardly_chance(evidence: Evidence) -> bool:
    """Whether another place fits so well that the building must repeat itself."""
    return is_enough(evidence, MOST_CHANCE)


def judge(best: Evidence, second: Evidence | None) -> str:
    """The outcome."""
    if best.explained_m < LEAST_M:
        return "too_small"
    if is_contradicted(best):
        return "conflict"
    if best.fixed_m < LEAST_FIXED_M:
        return "ambiguous"
    if not is_enough(best):
        return "too_small"
    room = best.long_m < ROOM_M
    if second is not None:
        share = MOST_RIVAL_OF_A_ROOM if room else MOST_RIVAL
        if is_hardly_chance(second) or second.explained_m > share * best.explained_m:
            return "ambiguous"
    plain = room or best.lines < PLAIN_LINES
    return "ambiguous" if plain and best.beside < MORE_SEEN else "committed"


def is_mirrored(best: Evidence, image: Evidence) -> bool:
    """Whether the mirror image of the second map fits as well as the map itself."""
    return image.explained_m > MOST_MIRRORED * best.explained_m


def sentence(
    outcome: str, *, explained_m: float, conflict_m: float, visible_m: float, fixed_m: float, second_m: float
) -> str:
    """An outcome and its numbers in words."""
    found = f"{explained_m:.1f} m of wall explained, {conflict_m:.1f} m contradicted"
    match outcome:
        case "too_small":
            return f"too little in common: {found}"
        case "conflict":
            return f"the best place is contradicted: {found}, of {visible_m:.1f} m that both should have"
        case "ambiguous" if fixed_m < LEAST_FIXED_M:
            return f"it slides along its walls: of {found}, {fixed_m:.1f} m hold it"
        case "ambiguous" if second_m > min(LEAST_M, MOST_RIVAL_OF_A_ROOM * explained_m):
            return f"two places fit: {explained_m:.1f} m and {second_m:.1f} m explained"
        case "ambiguous":
            return f"both show one room, and hardly more: others may be alike ({found})"
        case "provisional":
            return (
                f"{found}; counts once it is found again in maps that have grown, or a landmark or sighting confirms it"
            )
        case _:
            return f"{found}; the next best place explains {second_m:.1f} m"
