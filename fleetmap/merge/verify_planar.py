"""Checks of the verifier that need no sources: canonical rows, crossings, faces. Exact, in Python integers."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from fractions import Fraction
from functools import cmp_to_key

from fleetmap.model.lattice import FREE, UNKNOWN

Row = tuple[int, ...]
Found = tuple[str, float, float, str]
Point = tuple[int, int]
Leaving = tuple[Point, bool, bool]


def check_canonical(rows: list[Row]) -> Iterator[Found]:
    """Rows in range and in canonical order, without repetition; a boundary has exactly one free side."""
    ends = [row[:4] for row in rows]
    for previous, row in zip([None, *ends[:-1]], rows, strict=True):
        y0, x0, y1, x1, left, right, wall, thickness = row
        if previous is not None and not previous < row[:4]:
            yield "canonical", y0, x0, f"{row[:4]} after {previous}"
        if (y0, x0) >= (y1, x1):
            yield "canonical", y0, x0, f"{row[:4]} doesn't start at its lower end"
        if not (FREE <= left <= UNKNOWN and FREE <= right <= UNKNOWN and wall in (0, 1) and thickness >= 0):
            yield "canonical", y0, x0, f"sides {left}, {right}, obstacle {wall}, thickness {thickness}"
        if not wall and (left == FREE) == (right == FREE):
            yield "canonical", y0, x0, f"no wall, and its sides are {left} and {right}"


def check_crossings(rows: list[Row]) -> Iterator[Found]:
    """Two edges have at most an end in common."""
    import shapely

    boxes = shapely.box(
        [min(r[1], r[3]) for r in rows], [r[0] for r in rows], [max(r[1], r[3]) for r in rows], [r[2] for r in rows]
    )
    first, second = shapely.STRtree(boxes).query(boxes)
    for i, j in zip(first.tolist(), second.tolist(), strict=True):
        if i < j and _improper(rows[i], rows[j]):
            yield "crossing", rows[i][0], rows[i][1], f"{rows[i][:4]} and {rows[j][:4]} meet beside their ends"


def _improper(e: Row, f: Row) -> bool:
    a, b, c, d = (e[0], e[1]), (e[2], e[3]), (f[0], f[1]), (f[2], f[3])
    if any(_between(p, c, d) for p in (a, b)) or any(_between(p, a, b) for p in (c, d)) or (a, b) == (c, d):
        return True
    return _turn(a, b, c) * _turn(a, b, d) < 0 and _turn(c, d, a) * _turn(c, d, b) < 0


def _turn(a: Point, b: Point, p: Point) -> int:
    """Positive if p lies left of a to b."""
    return (b[1] - a[1]) * (p[0] - a[0]) - (b[0] - a[0]) * (p[1] - a[1])


def _between(p: Point, a: Point, b: Point) -> bool:
    """Whether p lies on the edge a to b, ends excluded."""
    inside = min(a[0], b[0]) <= p[0] <= max(a[0], b[0]) and min(a[1], b[1]) <= p[1] <= max(a[1], b[1])
    return p not in (a, b) and inside and _turn(a, b, p) == 0


def check_faces(rows: list[Row]) -> Iterator[Found]:
    """Neighbouring edges around each vertex agree on what lies between them, and so do nested components."""
    around: defaultdict[Point, list[Leaving]] = defaultdict(list)
    for y0, x0, y1, x1, left, right, *_ in rows:
        # Per vertex: the direction in which the edge leaves, and whether its left and right are free, seen so.
        around[y0, x0].append(((y1 - y0, x1 - x0), left == FREE, right == FREE))
        around[y1, x1].append(((y0 - y1, x0 - x1), right == FREE, left == FREE))
    for (y, x), leaving in around.items():
        leaving.sort(key=cmp_to_key(_angle_order))
        for (_, left, _), (_, _, right) in zip(leaving, leaving[1:] + leaving[:1], strict=True):
            if left != right:
                yield "face", y, x, "two edges around a vertex disagree on the space between them"

    for y, x in _lowest_vertices(rows):
        # Just below the lowest vertex of a component, and left of it, is what surrounds the component: left of
        # the first edge in angular order, counted from +x, seen towards the vertex's right.
        first = min(around[y, x], key=cmp_to_key(_angle_order))
        if first[2] != _free_below(rows, y, x):
            yield "face", y, x, "a part of the map disagrees with the face that holds it"


def _angle_order(first: Leaving, second: Leaving) -> int:
    """Order of directions (dy, dx) counter-clockwise from +x."""
    d, e = first[0], second[0]
    upper_d, upper_e = (d[0] < 0 or (d[0] == 0 and d[1] < 0)), (e[0] < 0 or (e[0] == 0 and e[1] < 0))
    if upper_d != upper_e:
        return 1 if upper_d else -1
    cross = d[1] * e[0] - d[0] * e[1]
    return -1 if cross > 0 else (1 if cross < 0 else 0)


def _lowest_vertices(rows: list[Row]) -> list[Point]:
    """The least vertex (y, x) of each connected component."""
    parent: dict[Point, Point] = {}

    def root(p: Point) -> Point:
        parent.setdefault(p, p)
        while parent[p] != p:
            parent[p] = parent[parent[p]]
            p = parent[p]
        return p

    for y0, x0, y1, x1, *_ in rows:
        a, b = sorted([root((y0, x0)), root((y1, x1))])
        parent[b] = a  # the lesser one stays: a root is the least vertex of its component
    return sorted({root(p) for p in list(parent)})


def _free_below(rows: list[Row], y: int, x: int) -> bool:
    """Whether the space just below vertex (y, x) is free, by the first edge that a ray from there to -x meets."""
    nearest: tuple[Fraction, Fraction] | None = None
    free = False
    for y0, x0, y1, x1, _, right, *_ in rows:
        if y0 < y <= y1:  # at height y - 0
            slope = Fraction(x1 - x0, y1 - y0)
            at = slope * (y - y0) + x0
            # Edges that end in one point at height y are told apart by their slopes, just below it.
            if at < x and (nearest is None or (at, -slope) > nearest):
                nearest = (at, -slope)
                free = right == FREE
    return free
