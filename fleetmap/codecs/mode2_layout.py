"""Which context of payload mode 2 is for what. Each has a start probability in ``mode2_start``."""

from __future__ import annotations

UNARY = 13
"""Contexts of a number's length."""

LENGTHS = 14
"""Lengths, in bits, whose lower bits have contexts of their own."""

TREE = 39
"""Of the bits below a number's leading one: seven for the first three, then one for each position; each three times: if
nothing is expected, and if a 0 or a 1 is."""

GROUPS = 5
"""Edges of the three classes, and the first and second edge of a triangle."""

# How many walks, least x and width, way to the next root's row; then by field.
LOOPS, WIDTH, ROW = 0, UNARY, 2 * UNARY
TRIANGLE = 3 * UNARY  # whether the walk before was one
CLOSE = TRIANGLE + 2  # 12 distances, 5 kinds of way to the root, 4 counts of edges
CLASS = CLOSE + 12 * 5 * 4  # 4 classes before, 4 runs, 6 lengths; of triangles 3 edges, 4 classes; 2 decisions
TURN = CLASS + (4 * 4 * 6 + 3 * 4) * 2  # 6 and 5 lengths, 4 turns; 3 decisions
LENGTH = TURN + GROUPS * 6 * 5 * 4 * 3  # 3 turns, 6 lengths
LOWER = LENGTH + GROUPS * 3 * 6 * UNARY
ASIDE = LOWER + GROUPS * LENGTHS * TREE  # 7 lengths, 4 turns, 3 signs; whether, and to which side
OFF = ASIDE + GROUPS * 7 * 4 * 3 * 2  # 16 lengths
OFF_LOWER = OFF + 16 * UNARY
SAME = OFF_LOWER + LENGTHS * TREE  # whether the edge before had one, whether it is an island
THICKNESS = SAME + 4  # 9 shapes
LARGE = THICKNESS + 9 * 32
CONTEXTS = LARGE + UNARY
