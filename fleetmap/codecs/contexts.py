"""How many contexts a number and a step take: plain numbers, for the layouts of the modes and for their kernels."""

from __future__ import annotations

UNARY = 13
"""Contexts of a number's length."""

LENGTHS = 14
"""Lengths, in bits, whose lower bits may have contexts of their own."""

TREE = 39
"""Of the bits below a number's leading one: seven for the first three, then one for each position; each three times: if
nothing is expected, and if a 0 or a 1 is."""

OFF, OFF_LOWER = 0, 16 * UNARY
STEP = OFF_LOWER + LENGTHS * TREE
"""Of steps of any group: how far to the side a step of a length goes; the groups follow."""

# Of a group: 6 and 5 lengths, 4 turns, 3 decisions; 3 turns, 6 lengths; lower bits; 7 lengths, 4 turns, 3 signs, 2.
TURNS, ALONG = 0, 6 * 5 * 4 * 3
LOWER = ALONG + 3 * 6 * UNARY
SLANT = LOWER + LENGTHS * TREE
GROUP = SLANT + 7 * 4 * 3 * 2
