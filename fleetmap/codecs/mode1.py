"""Mode 1: the numbers of a small delta through a range coder that knows from the start what deltas look like.

Deflate pays for its tables in each message, and a delta is hardly longer than they are. Here the tables are part of
the format (``mode1_start``). One procedure, ``code_fields``, both writes and reads; ``docs/format.md`` is its page.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from itertools import repeat

import numpy as np
from numpy.typing import NDArray

from fleetmap.codecs.fields import DeltaFields, edges_per_chain
from fleetmap.codecs.mode1_start import START
from fleetmap.codecs.range_coder import Coder, Reader, Writer
from fleetmap.model.arcs import flip
from fleetmap.model.errors import ConfigError
from fleetmap.model.vectormap import VectorMap

MODE = 1
THICK_FRONTIERS = 0x20
"""Flag: the thickness of frontiers is written too; without it they have none."""

MAX_NUMBERS = 4096
NUMBERS_PER_BYTE = 64
"""Most numbers of a payload, and most for each of its bytes: what hostile bytes can cost."""

MAX_BASE_EDGES = 1 << 14
"""Largest base: there is a decision for each of its edges. Others are for mode 0."""

MAX_LENGTH = 34
"""Longest number, in bits."""

WIDTH = 24
"""Contexts of a number: 12 for its length, 12 for the bit below its leading one."""

MAX_TARGETS = 64
"""Most places where a walk is expected to end; they are sorted for each walk."""

Point = tuple[int, int]

_MOST_LENGTHS = 12

# Numbers: the first context of each kind, times WIDTH.
_COUNT, _WALKS, _ROOT, _EDGES, _STEP_Y, _STEP_X, _VALUE, _LENGTH, _GAP, _RETHICKENED, _TARGET, _NUMBERS = (
    WIDTH * n for n in (0, 6, 9, 10, 13, 14, 21, 30, 31, 32, 33, 34)
)
# Single decisions.
_REMOVED, _CONTINUES, _CLASS, _SIGN_Y, _SIGN_X, _CLOSES, CONTEXTS = (_NUMBERS + n for n in (0, 32, 36, 44, 53, 62, 63))


def encode(fields: DeltaFields, base: VectorMap) -> bytes:
    """The numbers of a delta as bytes; the first one is the mode and its flags.

    Raises
    ------
    ConfigError : the delta or its base are too large for this mode
    """
    size = _size(fields.counts, len(fields.steps))
    if size <= MAX_NUMBERS and len(base) <= MAX_BASE_EDGES:
        coder = Writer(START)
        code_fields(coder, fields, base)
        payload = bytes([MODE | (THICK_FRONTIERS if fields.thick_frontiers else 0)]) + coder.finish()
        if size <= NUMBERS_PER_BYTE * len(payload):
            return payload
    raise ConfigError(option="mode", value=MODE, reason=f"{size} numbers against {len(base)} edges are for mode 0")


def decode(payload: bytes, base: VectorMap) -> DeltaFields:
    """The numbers in a payload.

    Raises
    ------
    ValueError : anything about the bytes is not as it must be
    """
    if payload[0] & ~(MODE | THICK_FRONTIERS):
        raise ValueError(f"unknown flags {payload[0]:#x}")
    if len(base) > MAX_BASE_EDGES:
        raise ValueError(f"mode 1 against a base of {len(base)} edges")
    coder = Reader(START, payload[1:])
    most = min(MAX_NUMBERS, NUMBERS_PER_BYTE * len(payload))
    fields = code_fields(coder, _nothing(bool(payload[0] & THICK_FRONTIERS)), base, most=most)
    coder.finish()
    return fields


def code_fields(coder: Coder, known: DeltaFields, base: VectorMap, *, most: int = MAX_NUMBERS) -> DeltaFields:
    """Write the fields, or read them: a writer returns what goes in; a reader is given nothing, and fills it.

    Raises
    ------
    ValueError : there are more than ``most`` numbers, or they don't fit the base
    """
    counts = [_number(coder, _COUNT + WIDTH * i, value) for i, value in enumerate(known.counts)]
    n_removed, n_known, n_absolute, n_chains, n_runs, n_rethickened = counts
    _refuse_above(most, _size(counts, 0))
    removed = _code_removed(coder, known.removed, base, n_removed)
    surplus = _surplus(base.edges[removed])
    known_roots = _code_known_roots(coder, known.known_roots, surplus, n_known)
    absolute_roots = [_signed(coder, _ROOT, value) for value in _values(known.absolute_roots, 2 * n_absolute)]
    heads = _code_heads(coder, _values(known.heads, n_chains))
    n_steps = int(edges_per_chain(heads).sum())
    _refuse_above(most, _size(counts, n_steps))
    roots = _roots(base.edges[removed], surplus, known_roots, absolute_roots)
    targets = [point for point in sorted(surplus) for _ in range(-surplus[point])][:MAX_TARGETS]
    steps = _code_steps(coder, _pairs(known.steps, n_steps), heads, roots, targets)
    runs, before = [], 4
    for value, length in _pairs(known.runs, n_runs):
        before = _number(coder, _VALUE + WIDTH * min(before, 8), value)
        runs.append((before, _number(coder, _LENGTH, length - 1) + 1))
    rethickened, place = [], -1
    for to, value in _pairs(known.rethickened, n_rethickened):
        place += _number(coder, _GAP, to - place - 1) + 1
        rethickened.append((place, _number(coder, _RETHICKENED, value)))
    return DeltaFields(
        removed,
        known_roots,
        np.array(absolute_roots, np.int64).reshape(-1, 2),
        heads,
        steps,
        np.array(runs, np.int64).reshape(-1, 2),
        np.array(rethickened, np.int64).reshape(-1, 2),
        known.thick_frontiers,
    )


def _code_removed(coder: Coder, places: NDArray[np.int64], base: VectorMap, count: int) -> NDArray[np.int64]:
    """A decision for each edge of the base, until all are found: edges go with those that they touch."""
    gone = set(places.tolist())
    found: list[int] = []
    seen: defaultdict[tuple[int, int], int] = defaultdict(int)  # 1: an edge here stays, 2: one goes, 3: both
    last = 0
    for place, (y0, x0, y1, x1, _) in enumerate(base.edges.tolist()):
        if len(found) == count:
            break
        a, b = seen[y0, x0], seen[y1, x1]
        last = coder.bit(_REMOVED + 16 * (last if a == b == 0 else 0) + 4 * a + b, int(place in gone))
        if last:
            found.append(place)
        seen[y0, x0] |= 1 + last
        seen[y1, x1] |= 1 + last
    if len(found) < count:
        raise ValueError(f"expected {count} removed edges; the base has no more than {len(found)} of them")
    return np.array(found, np.int64)


def _surplus(removed: NDArray[np.int32]) -> dict[Point, int]:
    """How many more of the removed edges left each of their endpoints, as walked, than arrived."""
    surplus: defaultdict[Point, int] = defaultdict(int)
    for y0, x0, y1, x1, label in removed.tolist():
        forwards = 1 if label < flip(label) else -1
        surplus[y0, x0] += forwards
        surplus[y1, x1] -= forwards
    return dict(sorted(surplus.items()))


def _code_known_roots(
    coder: Coder, ranks: NDArray[np.int64], surplus: dict[Point, int], count: int
) -> NDArray[np.int64]:
    """How many walks start at each endpoint of the removed edges: mostly as many as used to."""
    starts = np.bincount(ranks, minlength=len(surplus)).tolist() if len(ranks) else repeat(0)
    result: list[int] = []
    for rank, (more, walks) in enumerate(zip(surplus.values(), starts, strict=False)):
        if len(result) == count:
            break
        walks = _number(coder, _WALKS + WIDTH * (1 + _sign(more)), walks)
        if walks > count - len(result):
            raise ValueError(f"more than {count} walks start at known roots")
        result += [rank] * walks
    if len(result) < count:
        raise ValueError(f"fewer than {count} walks start at known roots")
    return np.array(result, np.int64)


def _code_heads(coder: Coder, heads: Iterable[int]) -> NDArray[np.int64]:
    result, before = [], 3
    for head in heads:
        continues = coder.bit(_CONTINUES + before, head & 1)
        label = head // 2 % 3
        context = _CLASS + 2 * (before if continues else 3)
        label = coder.bit(context, int(label > 0)) and 1 + coder.bit(context + 1, int(label > 1))
        edges = _number(coder, _EDGES + WIDTH * label, head // 6)
        result.append(continues + 2 * (label + 3 * edges))
        before = label
    return np.array(result, np.int64)


def _code_steps(
    coder: Coder,
    pairs: Iterable[tuple[int, int]],
    heads: NDArray[np.int64],
    roots: list[Point],
    targets: list[Point],
) -> NDArray[np.int64]:
    """The steps of all walks; the last one of a walk mostly leads to a target, where removed edges led to."""
    counts = edges_per_chain(heads)
    starts = (np.cumsum(counts) - counts)[heads & 1 == 0]
    if len(starts) != len(roots) or starts[:1].any():
        raise ValueError("the number of roots is not the number of walks")
    root_at = dict(zip(starts.tolist(), roots, strict=True))
    last = {*(starts - 1).tolist(), int(counts.sum()) - 1}
    result: list[Point] = []
    y = x = sign_y = sign_x = 0
    for i, (dy, dx) in enumerate(pairs):
        if i in root_at:
            (y, x), sign_y, sign_x = root_at[i], 0, 0
        closed = _code_target(coder, (y, x), (y + dy, x + dx), targets) if i in last and targets else None
        if closed:
            dy, dx = closed[0] - y, closed[1] - x
        else:
            dy = _signed(coder, _STEP_Y, dy, sign=_SIGN_Y + 3 * (1 + sign_y) + 1 + sign_x)
            sign_y = _sign(dy)
            size = min(abs(dy).bit_length(), 6)
            dx = _signed(coder, _STEP_X + WIDTH * size, dx, sign=_SIGN_X + 3 * (1 + sign_x) + 1 + sign_y)
            sign_x = _sign(dx)
        y, x = y + dy, x + dx
        result.append((dy, dx))
    return np.array(result, np.int64).reshape(-1, 2)


def _code_target(coder: Coder, here: Point, end: Point, targets: list[Point]) -> Point | None:
    """Whether a walk ends at one of the targets, and at which one, counted from the nearest; it is used up."""
    if not coder.bit(_CLOSES, int(end in targets)):
        return None
    targets.sort(key=lambda p: (abs(p[0] - here[0]) + abs(p[1] - here[1]), p))
    nearness = _number(coder, _TARGET, targets.index(end) if end in targets else 0)
    if nearness >= len(targets):
        raise ValueError(f"there are {len(targets)} targets, and not {nearness + 1}")
    return targets.pop(nearness)


def _roots(
    removed: NDArray[np.int32], surplus: dict[Point, int], known_roots: NDArray[np.int64], steps: list[int]
) -> list[Point]:
    """Where the walks start."""
    points = list(surplus)
    roots = [points[rank] for rank in known_roots.tolist()]
    y, x = removed[0, :2].tolist() if len(removed) else (0, 0)
    for dy, dx in zip(steps[::2], steps[1::2], strict=True):
        y, x = y + dy, x + dx
        roots.append((y, x))
    return roots


def _number(coder: Coder, context: int, value: int) -> int:
    """A number >= 0: its length in bits as ones and a zero, then the bits below the leading one."""
    length = 0
    while coder.bit(context + min(length, _MOST_LENGTHS - 1), int(value >> length > 0)):
        length += 1
        if length > MAX_LENGTH:
            raise ValueError(f"a number is longer than {MAX_LENGTH} bits")
    if length < 2:
        return length
    place = length - 2
    result = 2 + coder.bit(context + _MOST_LENGTHS + min(place, WIDTH - _MOST_LENGTHS - 1), value >> place & 1)
    while place:
        place -= 1
        result = 2 * result + coder.even(value >> place & 1)
    return result


def _signed(coder: Coder, context: int, value: int, *, sign: int | None = None) -> int:
    """The magnitude, and unless it is 0 the sign (in the context ``sign``; None: as likely as not)."""
    size = _number(coder, context, abs(value))
    if size == 0:
        return 0
    negative = int(value < 0)
    return -size if (coder.even(negative) if sign is None else coder.bit(sign, negative)) else size


def _sign(value: int) -> int:
    return (value > 0) - (value < 0)


def _size(counts: Sequence[int], n_steps: int) -> int:
    """How many numbers the fields hold."""
    return counts[0] + counts[1] + 2 * counts[2] + counts[3] + 2 * n_steps + 2 * counts[4] + 2 * counts[5]


def _refuse_above(most: int, size: int) -> None:
    if size > most:
        raise ValueError(f"{size} numbers; a payload of this size may hold {most}")


def _nothing(thick_frontiers: bool) -> DeltaFields:
    none, pairs = np.zeros(0, np.int64), np.zeros((0, 2), np.int64)
    return DeltaFields(none, none, pairs, none, pairs, pairs, pairs, thick_frontiers)


def _values(numbers: NDArray[np.int64], count: int) -> Iterable[int]:
    """The numbers to write; ``count`` zeros where they are to be read."""
    return numbers.ravel().tolist() if len(numbers) else repeat(0, count)


def _pairs(rows: NDArray[np.int64], count: int) -> Iterable[tuple[int, int]]:
    values = iter(_values(rows, 2 * count))
    return zip(values, values, strict=True)
