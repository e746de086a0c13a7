"""Find the few of many streams that two peers hold differently, without listing all.

Range-based set reconciliation (Meyer 2023, arXiv 2212.13567): a stream has a place, a hash of its robot and life, and
whoever asks sends a hash for each range of places. Who is asked answers for the ranges that differ: with all that it
holds there, if that is little, else with a hash for each of some smaller ranges. Ranges are cut where they hold equally
many, not where places are equally far apart: nobody who chooses lives can crowd one of them.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache
from itertools import accumulate

from fleetmap.codecs.messages import MAX_LIFE, Range, Revision, Row
from fleetmap.engine.stream import Key
from fleetmap.model.hashing import hash_ints, hash_text

SALT_HELD, SALT_PLACE = 18, 19
MASK = (1 << 64) - 1
FEW = 8
"""So many streams are listed rather than hashed: a row takes twice the bytes of a range."""
MOST_PIECES = 32
MOST_RANGES = 256
"""In a question."""
MOST_ROWS = 512
"""In an answer: 16 KiB. Of what is left the hash is said, and it is asked for again."""


@lru_cache(8192)
def revision_hash(robot: str, revision: Revision) -> int:
    """One of the terms of the hash over all that a peer holds."""
    return hash_ints((revision.life, revision.seq, revision.digest), hash_text(robot, SALT_HELD))


@lru_cache(8192)
def place(key: Key) -> int:
    """Where a stream stands among all."""
    return hash_ints((key[1],), hash_text(key[0], SALT_PLACE))


class Index:
    """What a peer holds, in the order of places.

    Parameters
    ----------
    rows : of all streams that it keeps
    """

    def __init__(self, rows: Iterable[Row]) -> None:
        placed = sorted((place((robot, revision.life)), robot, revision) for robot, revision in rows)
        self._places = [at for at, _, _ in placed]
        self._rows: list[Row] = [(robot, revision) for _, robot, revision in placed]
        self._sums = [0, *accumulate(revision_hash(*row) for row in self._rows)]

    def held(self, first: int = 0, last: int = MAX_LIFE) -> int:
        """A hash over the revisions of the streams from one place to another."""
        low, high = self._span(first, last)
        return (self._sums[high] - self._sums[low]) & MASK

    def rows(self, first: int, last: int) -> tuple[Row, ...]:
        """These streams."""
        low, high = self._span(first, last)
        return tuple(self._rows[low:high])

    def describe(self, first: int = 0, last: int = MAX_LIFE, *, rows: bool = True) -> list[Range]:
        """One range as rows, if there are few (or as one hash, without ``rows``); else as hashes of smaller ones."""
        low, high = self._span(first, last)
        count = high - low
        if count <= FEW:
            held = self.held(first, last)
            return [Range(first, last, rows=self.rows(first, last)) if rows else Range(first, last, held)]
        pieces = min(MOST_PIECES, -(-count // FEW))
        starts = [first, *(self._places[low + count * k // pieces] for k in range(1, pieces))]
        ends = [*(start - 1 for start in starts[1:]), last]
        # Two streams of one place would make an empty range.
        return [Range(a, b, self.held(a, b)) for a, b in zip(starts, ends, strict=True) if a <= b]

    def answer(self, asked: Sequence[Range]) -> list[Range]:
        """What is held here of the ranges that differ; of those that are left out it is the same."""
        found: list[Range] = []
        left = MOST_ROWS
        for of in asked[:MOST_RANGES]:
            if of.held is None or self.held(of.first, of.last) == of.held:
                continue
            parts = self.describe(of.first, of.last)
            # A hash takes as much as half a row.
            cost = sum(len(part.rows) if part.rows is not None else 1 for part in parts)
            if cost > left:
                parts = [Range(of.first, of.last, self.held(of.first, of.last))]
            left -= cost
            found += parts
        return found

    def ask_further(self, answered: Sequence[Range]) -> list[Range]:
        """What to ask next, where an answer has hashes that differ from what is held here."""
        return [
            part
            for of in answered
            if of.held is not None and self.held(of.first, of.last) != of.held
            for part in self.describe(of.first, of.last, rows=False)
        ]

    def differences(self, of: Range) -> dict[Key, Revision]:
        """Where the rows of a range say something else than is held here; seq 0 where they lack a stream."""
        theirs: Mapping[Key, Revision] = {(robot, revision.life): revision for robot, revision in of.rows or ()}
        ours = {(robot, revision.life): revision for robot, revision in self.rows(of.first, of.last)}
        inside = {key: revision for key, revision in theirs.items() if of.first <= place(key) <= of.last}
        lacking = {key: Revision(key[1], 0, 0) for key in ours.keys() - inside.keys()}
        return {key: r for key, r in inside.items() if ours.get(key) != r} | lacking

    def _span(self, first: int, last: int) -> tuple[int, int]:
        return bisect_left(self._places, first), bisect_right(self._places, last)


def spans(ranges: Iterable[Range]) -> Callable[[int], bool]:
    """Whether a place is in any of them; of two that overlap the one that begins last is looked at."""
    ordered = sorted((of.first, of.last) for of in ranges)
    starts = [first for first, _ in ordered]

    def inside(at: int) -> bool:
        k = bisect_right(starts, at) - 1
        return k >= 0 and at <= ordered[k][1]

    return inside
