"""Step 4: whether the best hypothesis is true. All thresholds, chosen on generated pairs (``benchmarks/align.py``)."""

from __future__ import annotations

from collections.abc import Iterable

from fleetmap.align.evidence import Evidence

LEAST_M, LEAST_LINES = 6.0, 5
"""Less wall than that, or on fewer lines, may meet by chance."""
LITTLE_M, LITTLE_LINES, LITTLE_LONG_M = 12.0, 6, 4.5
"""Of less wall than the first more lines are asked for, and that they don't lie in one heap."""
CONFLICT_M, CONFLICT_SHARE = 0.1, 0.01
"""So much may be contradicted in any case, and so much of what is explained: sights of one place hardly contradict each
other, and lookalikes do."""
LEAST_SEEN = 0.7
"""Of the walls that both should have."""
LEAST_FIXED_M = 1.2
"""Wall across the direction in which the map would slide."""
MOST_RIVAL = 0.45
"""Of what the best place explains: another one that explains as much, and could be true, may as well be."""
RIVAL_SHARE, RIVAL_SEEN = 0.95, 0.6
"""Of walls that are explained or contradicted, and of those that both should have: what could be true."""
ROOM_M, MORE_SEEN = 7.0, 1.5
"""What both have is no larger than a room, and the maps show hardly more: other rooms may be alike."""


def is_enough(evidence: Evidence) -> bool:
    """Whether so much doesn't meet by chance."""
    if evidence.explained_m < LITTLE_M:
        heap = evidence.lines < LITTLE_LINES or evidence.long_m < LITTLE_LONG_M
        return evidence.explained_m >= LEAST_M and not heap
    return evidence.lines >= LEAST_LINES


def is_contradicted(evidence: Evidence) -> bool:
    """Whether what was seen speaks against it."""
    conflict = evidence.conflict_m > CONFLICT_M + CONFLICT_SHARE * evidence.explained_m
    return conflict or evidence.explained_m < LEAST_SEEN * evidence.visible_m


def order(evidence: Evidence) -> tuple[bool, float]:
    """The best comes first: what may be true by itself, then what has the most left of what it explains.

    A true place that explains little is hardly contradicted; false ones that explain more are.
    """
    return not is_enough(evidence) or is_contradicted(evidence), -evidence.score_m


def rival(elsewhere: Iterable[Evidence]) -> Evidence | None:
    """The best of those that could be true, too."""
    possible = [
        evidence
        for evidence in elsewhere
        if evidence.explained_m >= RIVAL_SHARE * (evidence.explained_m + evidence.conflict_m)
        and evidence.explained_m >= RIVAL_SEEN * evidence.visible_m
    ]
    return max(possible, key=lambda evidence: evidence.explained_m, default=None)


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
    if second is not None and second.explained_m > MOST_RIVAL * best.explained_m:
        return "ambiguous"
    if best.long_m < ROOM_M and best.beside < MORE_SEEN:
        return "ambiguous"
    return "committed"


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
        case "ambiguous" if second_m > MOST_RIVAL * explained_m:
            return f"two places fit: {explained_m:.1f} m and {second_m:.1f} m explained"
        case "ambiguous" if fixed_m < LEAST_FIXED_M:
            return f"it slides along its walls: of {found}, {fixed_m:.1f} m hold it"
        case "ambiguous":
            return f"both show one room, and hardly more: others may be alike ({found})"
        case "provisional":
            return f"{found}; counts once it is found again in maps that have grown"
        case _:
            return f"{found}; the next best place explains {second_m:.1f} m"
