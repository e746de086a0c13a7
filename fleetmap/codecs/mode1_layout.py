"""Which context of payload mode 1 is for what. Each has its start probability in ``mode1_start``."""

from __future__ import annotations

WIDTH = 24
"""Contexts of a number: 12 for its length, 12 for the bit below its leading one."""

# Numbers, WIDTH contexts each: how many windows; of a window first band, bands, first column, columns, removed edges;
# walks from an endpoint (3); absolute roots and their steps; dy (15) and dx (21) of a step; which target; how many
# rethickened edges, the way to the first one, to the next one; a large thickness.
WINDOWS, FIRST_BAND, BANDS, FIRST_COLUMN, COLUMNS, REMOVED, WALKS, ROOTS, ROOT, STEP_Y, STEP_X = (
    WIDTH * n for n in (0, 1, 2, 3, 4, 5, 6, 9, 10, 11, 26)
)
TARGET, RETHICKENED, FIRST_GAP, GAP, VALUE, _NUMBERS = (WIDTH * n for n in (47, 48, 49, 50, 51, 52))

# Single decisions: whether an edge of the base goes (96), an edge's class (42), whether a step leads to a target (27),
# signs of dy (135) and dx (405), whether a walk ends (2), thickness of an added edge (384), of a rethickened one (16).
GOES, CLASS, HITS, SIGN_Y, SIGN_X, ENDS, THICKNESS, THICKNESS_TO, CONTEXTS = (
    _NUMBERS + n for n in (0, 96, 138, 165, 300, 705, 707, 1091, 1107)
)
