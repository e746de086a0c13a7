"""Step 4: whether the best hypothesis is true. All thresholds, chosen on generated pairs (``benchmarks/align.py``)."""

from __future__ import annotations

from fleetmap.align.evidence import Evidence

LEAST_SCORE_M = 8.0
"""Less wall than that may meet by chance."""
LEAST_SHARE = 0.93
"""Of walls that are explained or contradicted."""
LEAST_SEEN = 0.7
"""Of the walls that both should have."""
LEAST_FIXED_M = 1.5
"""Wall across the direction in which the map would slide."""
MOST_SECOND = 0.5
"""Of the score: another place that is as good as that is another place."""


def judge(best: Evidence | None, second: Evidence | None) -> tuple[str, str]:
    """The outcome, and why."""
    if best is None:
        return "too_small", "no walls to compare"
    other = 0.0 if second is None else second.score_m
    found = f"{best.explained_m:.1f} m of wall explained, {best.conflict_m:.1f} m contradicted"
    if best.explained_m < LEAST_SCORE_M:
        return "too_small", f"too little in common: {found}; {LEAST_SCORE_M:.0f} m are asked for"
    if best.share < LEAST_SHARE or best.explained_m < LEAST_SEEN * best.visible_m:
        seen = f"of {best.visible_m:.1f} m that both should have"
        return "conflict", f"the best place is contradicted: {found}, {seen}"
    if other > MOST_SECOND * best.score_m:
        assert second is not None
        places = f"{best.explained_m:.1f} m and {second.explained_m:.1f} m explained"
        return "ambiguous", f"more than one place fits: {places}"
    if best.fixed_m < LEAST_FIXED_M:
        return "ambiguous", f"it slides along its walls: only {best.fixed_m:.1f} m of {found} hold it"
    if best.score_m < LEAST_SCORE_M:
        return "too_small", f"too little in common: {found}"
    return "committed", f"{found}; the next best place explains {0.0 if second is None else second.explained_m:.1f} m"
