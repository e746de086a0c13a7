"""From the maps of all robots to the one merged map, and the independent check of it.

``fold`` keeps these laws; ``verify`` and the tests hold it to them.

0. Equal sources give equal bytes, on every machine.
1. The order of the sources, and how often each is given, don't matter.
2. Copies of one map in one frame fold to the bytes of one copy. A merged map is never a source.
3. A wall of any source stays a wall, within the tolerance; free space never paints over it.
4. No gap closes that was seen as free and is wider than the tolerance.
5. Every wall of a source lies within the tolerance of a merged one, and the reverse.
"""

from fleetmap.merge.fold import fold
from fleetmap.merge.protocol import Merger, Source
from fleetmap.merge.verify import Violation, verify

MERGERS: dict[str, Merger] = {"arrangement": fold}
"""By name. A new way to merge is one new file and one line here."""

__all__ = ["MERGERS", "Merger", "Source", "Violation", "fold", "verify"]
