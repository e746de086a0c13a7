"""Between steps 1 and 2: which sources the fold has room for, so that nobody's map holds up the maps of all others.

What a fold costs is known before it is done, from three numbers:

- *entries*: how often an edge passes a tile; little more than there are edges, unless these are long
- *tests*: the sum over all tiles of the square of the number of edges in each. Every search of the fold looks into a
  few tiles, and compares what it finds there, so this bounds its work, whatever shape the edges have
- *crossings*: each makes a vertex, and two more pieces

Sources are taken one after the other, the one with the fewest tests of its own first, while there is room. Who comes
earlier can't make a later one dear beyond measure: two sources have at most as many tests with each other as the later
one has by itself (Cauchy and Schwarz: the sum of a b over the tiles is at most the root of that of a^2 times that of
b^2). So to push a map out, one has to say many maps that are as light as it is.

Which those are follows from the contents of the sources alone, never from names, order or what is remembered.
"""

from __future__ import annotations

import hashlib
import threading
import weakref
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fleetmap.merge.arrange import lower_end_first
from fleetmap.merge.origin import Box
from fleetmap.merge.place import Placed, place
from fleetmap.merge.protocol import Source
from fleetmap.merge.tiles import tiles_of_edges
from fleetmap.model.errors import MapFormatError
from fleetmap.model.frame import Frame
from fleetmap.model.pose import FixedPose
from fleetmap.model.vectormap import VectorMap

SOURCE, ENTRY, CROSSING = 1 << 14, 64, 128
"""What a source, an entry and a crossing cost, in tests: these take 15 to 70 ns each, in all steps together."""

ROOM, MOST_ROOM = 1 << 25, 3 << 28
"""Room of a fold, in tests: so many always, and never more, see ``room_for``. The second bound is for memory: what
takes all of it needs more than 1 GB."""

MOST_ENTRIES = 1 << 21
"""Entries in all: they are written down."""

KEPT_ENTRIES = 1 << 18
"""What was placed to be weighed is kept for the fold up to here, so that sources left out don't take memory at once."""

CROSSED, FEW_CROSSINGS = 2, 1 << 12
"""A source may have so many crossings for each of its edges and each source before it, and some anyway. Two sights of
one building cross 0.5 times for each edge at most."""

TESTS_AN_EDGE, FEW_TESTS = 64, 1 << 20
"""A source may have so many tests by itself for each of its edges, and some anyway. Real maps have up to 17 (35 in the
profile ``exact``)."""

TOO_DENSE = "edges: a hundred lie within 32 cm of each other nearly everywhere; no real map is so dense"
TOO_MUCH = "edges: so many, so dense or crossed so often that the merged map has no room for them beside the others"
CROSSES_ITSELF = "edges: they cross each other; those of a vector map meet at vertices only"

POSES_KEPT = 4
"""Weights of one map are remembered for so many poses."""


@dataclass(frozen=True, slots=True)
class Weight:
    """What the fold knows of a source before it takes it; ``reason`` says why it can't, or is empty.

    Parameters
    ----------
    content : a hash of all that the fold reads of it; two sources are the same to it if these are
    entries, tests : of the source by itself
    box : where its edges lie; None if there are none
    """

    reason: str
    content: bytes = b""
    entries: int = 0
    tests: int = 0
    box: Box | None = None

    @property
    def alone(self) -> int:
        """What the fold of this source alone would cost, in tests."""
        return SOURCE + ENTRY * self.entries + self.tests


@dataclass(slots=True, eq=False)
class Candidate:
    """A source that can be placed, the frames that say it, and what was placed already to find its weight."""

    source: Source
    weight: Weight
    frames: list[Frame]
    placed: Placed | None

    def place(self) -> Placed:
        """Its edges on the fleet lattice, from (0, 0)."""
        if self.placed is None:
            self.placed = place(self.source)
        return self.placed


_known: weakref.WeakKeyDictionary[VectorMap, dict[FixedPose, Weight]] = weakref.WeakKeyDictionary()
"""A map never changes: its weight is found once for as long as somebody holds it, not once a fold."""
_turn = threading.Lock()


def weighed(sources: Iterable[Source]) -> tuple[list[Candidate], list[tuple[Frame, str]]]:
    """The sources that can be placed, and (frame, reason) of the others."""
    candidates, left_out, entries = [], [], 0
    for source in sources:
        weight, placed = weigh(source)
        if weight.reason:
            left_out.append((source.frame, weight.reason))
        else:
            entries += weight.entries
            kept = placed if entries <= KEPT_ENTRIES else None
            candidates.append(Candidate(source, weight, [source.frame], kept))
    return candidates, left_out


def weigh(source: Source) -> tuple[Weight, Placed | None]:
    """The weight of a source, and the source placed if that had to be done to find it."""
    vector_map, pose = source.vector_map, source.T_fleet_frame
    with _turn:
        known = _known.get(vector_map, {}).get(pose)
    if known is not None:
        return known, None
    placed = None
    try:
        placed = place(source)
        weight = _weigh(placed)
    except MapFormatError as error:
        weight = Weight(f"{error.field}: {error.reason}")
    with _turn:
        poses = _known.setdefault(vector_map, {})
        if len(poses) >= POSES_KEPT:
            poses.clear()
        poses[pose] = weight
    return weight, placed


def room_for(candidates: list[Candidate]) -> int:
    """How much the fold of these may cost.

    Beside ``ROOM``, twice what all of them would cost one by one, and half of that more for each source, since they may
    all lie in one place. Eight robots that each hold all of a real map take up to 44 % of that, thirty 76 %
    (``benchmarks/hostile_fold.py``).
    """
    alone = sum(candidate.weight.alone for candidate in candidates)
    return min(MOST_ROOM, ROOM + alone * (len(candidates) + 4) // 2)


class Choice(NamedTuple):
    """Which candidates the fold takes, and how much of its room (both in tests) that needs."""

    taken: list[Candidate]
    spent: int
    room: int


def choose(candidates: list[Candidate]) -> Choice:
    """Take what the fold has room for, of candidates that each have another content."""
    from fleetmap.merge.afford_kernels import take
    from fleetmap.model.sort_kernels import order_of

    room = room_for(candidates)
    fit, entries, spent = [], 0, 0
    for candidate in sorted(candidates, key=lambda c: (c.weight.tests, c.weight.content)):
        # Before any of them is put into tiles: what each takes by itself, which is the least that it can.
        weight = candidate.weight
        if spent + weight.alone <= room and entries + weight.entries <= MOST_ENTRIES:
            fit.append(candidate)
            entries, spent = entries + weight.entries, spent + weight.alone
    if not fit:
        return Choice([], 0, room)
    each = [lower_end_first(candidate.place().ends)[0] for candidate in fit]
    first_edge = np.cumsum([0, *map(len, each)])
    ends = np.concatenate(each)
    tiles = tiles_of_edges(ends)
    # The entries by source instead, and of each by tile.
    tile = np.repeat(np.arange(len(tiles.keys)), np.diff(tiles.start))
    source = np.searchsorted(first_edge, tiles.items, side="right") - 1
    order = order_of(source)
    first = np.searchsorted(source[order], np.arange(len(fit) + 1))
    tile, items = tile[order], tiles.items[order]
    costs = room, SOURCE, ENTRY, CROSSING, CROSSED, FEW_CROSSINGS
    taken, needed = take(ends, first_edge, first, tile, tiles.keys, items, *costs)
    return Choice([candidate for candidate, yes in zip(fit, taken.tolist(), strict=True) if yes], needed, room)


def _weigh(placed: Placed) -> Weight:
    from fleetmap.merge.afford_kernels import count_crossings

    content, n = hashlib.sha256(placed.content()).digest(), len(placed.ends)
    if n == 0:
        return Weight("", content)
    ends, _ = lower_end_first(placed.ends)
    tiles = tiles_of_edges(ends)
    tests = int((np.diff(tiles.start) ** 2).sum())
    if tests > FEW_TESTS + TESTS_AN_EDGE * n:
        return Weight(TOO_DENSE)
    most = n // 4 + FEW_CROSSINGS
    if count_crossings(ends, *tiles, most) > most:
        return Weight(CROSSES_ITSELF)
    return Weight("", content, len(tiles.items), tests, placed.box())
