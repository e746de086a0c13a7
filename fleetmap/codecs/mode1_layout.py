"""Which context of payload mode 1 is for what. Each has its start in ``mode1_start``."""

from __future__ import annotations

from itertools import accumulate

from fleetmap.codecs.contexts import GROUP, LENGTHS, TREE, UNARY
from fleetmap.codecs.contexts import STEP as ANY_STEP

STEP_GROUPS = 8
"""Steps of the three classes; the first and the second one of a triangle; the first one of a walk that looks back to a
removed edge of the same class."""

_SIZES = {
    # Numbers: how many windows; of a window first band, bands, first column, columns, removed edges; walks from an
    # endpoint; absolute roots, the least place of them, their width, the way to the next one's row; which target; how
    # many rethickened edges, the way to the first one, to the next one; a large thickness.
    "WINDOWS": UNARY,
    "FIRST_BAND": UNARY,
    "BANDS": UNARY,
    "FIRST_COLUMN": UNARY,
    "COLUMNS": UNARY,
    "REMOVED": UNARY,
    "WALKS": 3 * UNARY,
    "ROOTS": UNARY,
    "LEAST": UNARY,
    "WIDTH": UNARY,
    "ROW": UNARY,
    "TARGET": UNARY,
    "RETHICKENED": UNARY,
    "FIRST_GAP": UNARY,
    "GAP": UNARY,
    "VALUE": UNARY,
    # Their lower bits.
    "LOWER": LENGTHS * TREE,
    # Whether an edge of the base goes.
    "GOES": 96,
    # Whether a walk is a triangle, by whether the one before was.
    "TRIANGLE": 2,
    # The class of an edge: classes before, runs, lengths; in a triangle edges, classes before; two decisions.
    "CLASS": 2 * (7 * 4 * 6 + 3 * 7),
    # Whether an edge leads to a target: distances, kinds of ways, edges of a closed walk before, classes.
    "HITS": 12 * 5 * 5 * 3,
    # Whether a walk ends, by whether it may close and whether there are targets.
    "ENDS": 4,
    "STEP": ANY_STEP + STEP_GROUPS * GROUP,
    # Whether a thickness is the one before: what that was, islands; a thickness, by shapes; one of a rethickened edge.
    "SAME": 3 * 2,
    "THICKNESS": 10 * 32,
    "THICKNESS_TO": 32,
}
(
    WINDOWS,
    FIRST_BAND,
    BANDS,
    FIRST_COLUMN,
    COLUMNS,
    REMOVED,
    WALKS,
    ROOTS,
    LEAST,
    WIDTH,
    ROW,
    TARGET,
    RETHICKENED,
    FIRST_GAP,
    GAP,
    VALUE,
    LOWER,
    GOES,
    TRIANGLE,
    CLASS,
    HITS,
    ENDS,
    STEP,
    SAME,
    THICKNESS,
    THICKNESS_TO,
    CONTEXTS,
) = accumulate(_SIZES.values(), initial=0)
