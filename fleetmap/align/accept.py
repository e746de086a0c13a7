"""Step 4: whether the best hypothesis is true. All thresholds, chosen on generated pairs (``benchmarks/align.py``)."""

from __future__ import annotations

from collections.abc import Iterable

from fleetmap.align.evidence import Evidence

LEAST_M = 12.0
"""Less wall than that may meet by chance."""
LEAST_SHARE = 0.97
"""Of walls that are explained or contradicted: sights of one place hardly contradict each other."""
LEAST_SEEN = 0.7
"""Of the walls that both should have."""
LEAST_FIXED_M = 1.5
"""Wall across the direction in which the map would slide."""
MOST_RIVAL = 0.35
"""Of what the best place explains: another one that explains as much and isn't contradicted may as well be true."""


def rival(elsewhere: Iterable[Evidence]) -> Evidence | None:
    """The best of those that could be true, too."""
    possible = [evidence for evidence in elsewhere if evidence.share >= LEAST_SHARE]
    return max(possible, key=lambda evidence: evidence.explained_m, default=None)


def judge(best: Evidence, second: Evidence | None) -> tuple[str, str]:
    """The outcome, and why."""
    found = f"{best.explained_m:.1f} m of wall explained, {best.conflict_m:.1f} m contradicted"
    other_m = 0.0 if second is None else second.explained_m
    if best.explained_m < LEAST_M:
        return "too_small", f"too little in common: {found}; {LEAST_M:.0f} m are asked for"
    if best.share < LEAST_SHARE or best.explained_m < LEAST_SEEN * best.visible_m:
        return "conflict", f"the best place is contradicted: {found}, of {best.visible_m:.1f} m that both should have"
    if other_m > MOST_RIVAL * best.explained_m:
        return "ambiguous", f"two places fit: {best.explained_m:.1f} m and {other_m:.1f} m explained"
    if best.fixed_m < LEAST_FIXED_M:
        return "ambiguous", f"it slides along its walls: of {found}, {best.fixed_m:.1f} m hold it"
    return "committed", f"{found}; the next best place explains {other_m:.1f} m"
