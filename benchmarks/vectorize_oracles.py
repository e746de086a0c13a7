"""How few edges there could be: plain oracles that know nothing of the vectorizer, for benchmarks and tests.

1. ``trace``: the boundary between states as arcs of unit steps.
2. ``fewest_edges``: the least number of edges of a chain along an arc whose vertices are points of the arc, each edge
   within epsilon of all points that it passes (min-#, Imai and Iri 1988).
3. ``fewest_lines``: a lower bound for any vertices at all: runs of the arc's points that fit into a strip of width
   2 epsilon each, as many as one needs.

Epsilon comes squared, in 256ths of a square cell, as an integer: 512 for sqrt(2), 63 for sqrt(63)/16. By itself the
script prints the numbers of a few shapes:

    python benchmarks/vectorize_oracles.py
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN, Lattice
from fleetmap.model.vectormap import VectorMap

STEPS = ((0, 1), (1, 0), (0, -1), (-1, 0))
"""(dy, dx) of the directions: right, up, left, down."""


@dataclass(frozen=True, eq=False)
class Arc:
    """A piece of boundary: (n, 2) lattice points (y, x), a unit apart, and its label, 3 * left + right.

    A closed one doesn't repeat its first point. Lattice point (0, 0) is the lower left corner of the grid.
    """

    points: NDArray[np.int64]
    label: int
    closed: bool


def trace(states: NDArray[np.uint8], profile: str) -> list[Arc]:
    """Trace the boundary of a grid: of free space (``share``), or between all three states.

    Arcs end where three states meet, or, on the boundary of free space, where the other state changes. Where
    states meet crosswise, occupied cells join at the corner; else free cells do if the two others are unknown. Of
    three states X, Y, X, Z around a point the X join, unless they are free: then all four arcs end there. On
    the boundary of free space these X don't join either, but two arcs change their labels there.
    """
    cells = np.pad(states, 2, constant_values=UNKNOWN).tolist()
    share = profile == "share"

    def around(y: int, x: int) -> tuple[int, int, int, int]:
        """The cells up right, up left, down left and down right of a point: right of step k is cell k - 1."""
        return cells[y][x], cells[y][x - 1], cells[y - 1][x - 1], cells[y - 1][x]

    def differ(a: int, b: int) -> bool:
        return (a == FREE) != (b == FREE) if share else a != b

    def leave(y: int, x: int, d: int) -> int | None:
        """In which direction an arc goes on that arrives in direction d; None if it ends."""
        cell = around(y, x)
        open_ = [k for k in range(4) if differ(cell[k], cell[k - 1])]
        if len(open_) == 2:
            return open_[0] if open_[1] == (d + 2) % 4 else open_[1]
        if len(open_) == 3:
            return None
        left, right = (d + 1) % 4, (d + 3) % 4
        # Behind the point: cell (d + 1) % 4 is to the left, (d + 2) % 4 to the right; those ahead are d and d - 1.
        behind_left, behind_right = cell[(d + 1) % 4], cell[(d + 2) % 4]
        ahead_left, ahead_right = cell[d], cell[d - 1]
        if share:
            # Free cells join if both others are unknown: the arc goes around one of these.
            others = (behind_left, ahead_right) if behind_left != FREE else (behind_right, ahead_left)
            around_left = (others == (UNKNOWN, UNKNOWN)) == (behind_left != FREE)
            return left if around_left else right
        if behind_left == ahead_right and behind_right == ahead_left:
            joined = OCCUPIED if OCCUPIED in (behind_left, behind_right) else FREE
        else:
            joined = behind_left if behind_left == ahead_right else behind_right
            if joined == FREE:
                return None
        return left if behind_left != joined else right

    def label_of(y: int, x: int, d: int) -> int:
        cell = around(y, x)
        return 3 * cell[d] + cell[d - 1]

    height, width = len(cells), len(cells[0])
    points = [(y, x) for y in range(1, height) for x in range(1, width)]
    done: set[tuple[int, int, int]] = set()
    arcs: list[Arc] = []

    def walk(y: int, x: int, d: int) -> tuple[list[tuple[int, int]], list[int], bool]:
        """Points from (y, x) on, the label of each step, and whether it came back to where it started."""
        found, labels, start = [(y, x)], [], (y, x, d)
        while True:
            labels.append(label_of(y, x, d))
            done.add((y, x, d))
            y, x = y + STEPS[d][0], x + STEPS[d][1]
            done.add((y, x, (d + 2) % 4))
            onward = leave(y, x, d)
            if onward is not None and (y, x, onward) == start:
                return found, labels, True
            found.append((y, x))
            if onward is None:
                return found, labels, False
            d = onward

    def add(found: list[tuple[int, int]], label: int, closed: bool) -> None:
        arcs.append(Arc(np.array(found, np.int64) - 2, label, closed))

    for closed_ones in (False, True):
        for y, x in points:
            cell = around(y, x)
            for d in range(4):
                if not differ(cell[d], cell[d - 1]) or (y, x, d) in done:
                    continue
                if not closed_ones and leave(y, x, (d + 2) % 4) is not None:
                    continue
                found, labels, closed = walk(y, x, d)
                changes = [k for k in range(len(labels)) if labels[k] != labels[k - 1]] if closed else []
                if not changes:
                    add(found, labels[0], closed)
                for k, change in enumerate(changes):
                    end = changes[(k + 1) % len(changes)] + (len(found) if k + 1 == len(changes) else 0)
                    add([found[i % len(found)] for i in range(change, end + 1)], labels[change], False)
    return arcs


def hidden_outlines(states: NDArray[np.uint8]) -> list[Arc]:
    """Trace the outlines of the obstacles, 8-connected, that have no free cell at a side."""
    from scipy.ndimage import binary_dilation, label

    labels, _ = label(states == OCCUPIED, np.ones((3, 3)))
    seen = np.unique(labels[binary_dilation(states == FREE)])
    hidden = (labels > 0) & ~np.isin(labels, seen)
    arcs = trace(np.where(hidden, FREE, UNKNOWN).astype(np.uint8), "share")
    swap = {3 * FREE + UNKNOWN: 3 * OCCUPIED + UNKNOWN, 3 * UNKNOWN + FREE: 3 * UNKNOWN + OCCUPIED}
    return [Arc(arc.points, swap[arc.label], arc.closed) for arc in arcs]


def corner_map(states: NDArray[np.uint8], lattice: Lattice, profile: str, epsilon_cells: float) -> VectorMap:
    """Make a vector map of the boundary as it is: an edge from each corner to the next."""
    edges = []
    for arc in trace(states, profile) + (hidden_outlines(states) if profile == "share" else []):
        points = np.concatenate([arc.points, arc.points[:2]]) if arc.closed else arc.points
        turns = (np.diff(points, 2, axis=0) != 0).any(axis=1)
        at = points[1:-1][turns]
        corners = np.concatenate([at, at[:1]] if arc.closed else [points[:1], at, points[-1:]])
        edges.append(np.column_stack([corners[:-1], corners[1:], np.full(len(corners) - 1, arc.label)]))
    rows = np.concatenate([np.zeros((0, 5), np.int64), *edges]).astype(np.int32)
    return VectorMap(lattice, rows, np.zeros(len(rows), np.uint8), epsilon_cells, profile)


def fewest_edges(arc: Arc, epsilon2: int) -> int:
    """The least number of edges, vertices on the arc; with its ends as vertices if it is open.

    For closed arcs over all starts: every chain has an edge that passes a given point, and a vertex as far on as
    any edge can reach from there; starts are tried in the shortest such range. What begins and ends at one
    point takes at least 3 edges.
    """
    points = np.concatenate([arc.points, arc.points, arc.points]) if arc.closed else arc.points
    if not arc.closed:
        least = 3 if (points[0] == points[-1]).all() else 1
        return int(_fewest(points, len(points) - 1, least, epsilon2))
    n = len(arc.points)
    reach = _reach(points, epsilon2)[: 2 * n] - np.arange(2 * n)
    # From the points up to p one gets at most as far as the farthest of them, but not all around.
    far = np.minimum(np.maximum.accumulate(np.arange(2 * n) + np.minimum(reach, n))[n : 2 * n], np.arange(n, 2 * n) + n)
    p = int(np.argmin(far - np.arange(n, 2 * n)))
    starts = [k % n for k in range(n + p + 1, int(far[p]) + 1)]
    return min(int(_fewest(points[s : s + n + 1].copy(), n, 3, epsilon2)) for s in starts)


def fewest_lines(arc: Arc, epsilon2: int) -> int:
    """How many strips of width 2 epsilon the points of an arc take, each a run of them; at least 3 if it is closed."""
    if not arc.closed:
        return int(_strips(arc.points, epsilon2))
    n = len(arc.points)
    points = np.concatenate([arc.points, arc.points])
    # A run that holds point 0 ends at most where the longest one from there does.
    last = min(int(_strip_end(points, 0, n, epsilon2)), n - 1)
    return max(3, min(int(_strips(points[s : s + n], epsilon2)) for s in range(1, last + 2)))


@njit("b1(i8[:,::1], i8, i8, i8)", cache=True, nogil=True)
def _holds(points: NDArray[np.int64], i: int, j: int, epsilon2: int) -> bool:
    """Whether all points from i to j are within epsilon of the segment between these two; exact."""
    dy, dx = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
    length2 = dy * dy + dx * dx
    if length2 == 0:
        return False
    for k in range(i + 1, j):
        ry, rx = points[k, 0] - points[i, 0], points[k, 1] - points[i, 1]
        along = dy * ry + dx * rx
        if along <= 0:
            near = 256 * (ry * ry + rx * rx) <= epsilon2
        elif along >= length2:
            ry, rx = points[k, 0] - points[j, 0], points[k, 1] - points[j, 1]
            near = 256 * (ry * ry + rx * rx) <= epsilon2
        else:
            cross = dx * ry - dy * rx
            near = 256 * cross * cross <= epsilon2 * length2
        if not near:
            return False
    return True


@njit("i8(i8[:,::1], i8, i8)", cache=True, nogil=True)
def _end_of_cone(points: NDArray[np.int64], i: int, epsilon2: int) -> int:
    """The last point that an edge from point i could end in: further on no direction is near all points between.

    Floats, and on the generous side: edges are tested exactly after that.
    """
    radius = np.sqrt(epsilon2 / 256) * (1 + 1e-6)
    # Directions from low to high, counter-clockwise, are near all points so far; they span less than half a turn.
    has_cone = False
    low_y, low_x, high_y, high_x = 0.0, 0.0, 0.0, 0.0
    for j in range(i + 1, len(points)):
        y, x = float(points[j, 0] - points[i, 0]), float(points[j, 1] - points[i, 1])
        length2 = y * y + x * x
        if length2 <= radius * radius:
            continue
        sine = radius / np.sqrt(length2)
        cosine = np.sqrt(1 - sine * sine)
        a_y, a_x = y * cosine - x * sine, x * cosine + y * sine
        b_y, b_x = y * cosine + x * sine, x * cosine - y * sine
        if not has_cone:
            has_cone, low_y, low_x, high_y, high_x = True, a_y, a_x, b_y, b_x
            continue
        if low_x * a_y - low_y * a_x > 0:
            low_y, low_x = a_y, a_x
        if high_x * b_y - high_y * b_x < 0:
            high_y, high_x = b_y, b_x
        if low_x * high_y - low_y * high_x < 0:
            return j
    return len(points) - 1


@njit("i8[::1](i8[:,::1], i8)", cache=True, nogil=True)
def _reach(points: NDArray[np.int64], epsilon2: int) -> NDArray[np.int64]:
    """(n,) for each point one that no edge from it passes."""
    reach = np.empty(len(points), np.int64)
    for i in range(len(points)):
        reach[i] = _end_of_cone(points, i, epsilon2)
    return reach


@njit("i8(i8[:,::1], i8, i8, i8)", cache=True, nogil=True)
def _fewest(points: NDArray[np.int64], last: int, least: int, epsilon2: int) -> int:
    """The fewest edges from the first point to the last one, but at least ``least``."""
    n = last + 1
    cost = np.full(n, n, np.int64)
    cost[0] = 0
    for i in range(last):
        for j in range(i + 1, min(_end_of_cone(points, i, epsilon2), last) + 1):
            if cost[i] + 1 < cost[j] and _holds(points, i, j, epsilon2):
                cost[j] = cost[i] + 1
    if cost[last] >= least:
        return cost[last]
    # So few edges only go around something small: count paths by their number of edges.
    here = np.zeros(n, np.uint8)
    here[0] = 1
    count = 0
    while count < least or not here[last]:
        there = np.zeros(n, np.uint8)
        for i in range(last):
            for j in range(i + 1, n):
                if here[i] and not there[j] and _holds(points, i, j, epsilon2):
                    there[j] = 1
        here = there
        count += 1
        if count > n:
            return n
    return count


@njit("b1(i8[:,::1], i8, i8)", cache=True, nogil=True)
def _fits(hull: NDArray[np.int64], count: int, epsilon2: int) -> bool:
    """Whether a convex polygon, counter-clockwise, is at most 2 epsilon wide in some direction; exact.

    It is least wide in a direction across one of its sides.
    """
    if count < 3:
        return True
    for k in range(count):
        m = (k + 1) % count
        dy, dx = hull[m, 0] - hull[k, 0], hull[m, 1] - hull[k, 1]
        widest = 0
        for p in range(count):
            widest = max(widest, dx * (hull[p, 0] - hull[k, 0]) - dy * (hull[p, 1] - hull[k, 1]))
        if 64 * widest * widest <= epsilon2 * (dy * dy + dx * dx):
            return True
    return False


@njit("i8(i8[:,::1], i8, i8[:,::1])", cache=True, nogil=True)
def _convex_hull(points: NDArray[np.int64], count: int, hull: NDArray[np.int64]) -> int:
    """Write the hull of the first ``count`` points, counter-clockwise, into ``hull``; returns its size."""
    order = np.argsort(points[:count, 1] * (1 << 24) + points[:count, 0])
    size, floor = 0, 1
    for q in range(2 * count - 1):
        if q == count:  # the lower half is done
            floor = size
        k = order[q] if q < count else order[2 * count - 2 - q]
        y, x = points[k, 0], points[k, 1]
        if size > 0 and hull[size - 1, 0] == y and hull[size - 1, 1] == x:
            continue
        while size > floor:
            ay, ax, by, bx = hull[size - 2, 0], hull[size - 2, 1], hull[size - 1, 0], hull[size - 1, 1]
            if (bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0:
                break
            size -= 1
        hull[size, 0], hull[size, 1] = y, x
        size += 1
    return size - 1 if size > 1 else size


@njit("i8(i8[:,::1], i8, i8, i8)", cache=True, nogil=True)
def _strip_end(points: NDArray[np.int64], start: int, stop: int, epsilon2: int) -> int:
    """The last of the points ``start`` to ``stop`` up to which all fit into one strip."""
    hull, more = np.empty((256, 2), np.int64), np.empty((256, 2), np.int64)
    size = 0
    for k in range(start, stop):
        more[:size] = hull[:size]
        more[size] = points[k]
        if size + 3 > len(hull):
            hull = np.empty((2 * len(hull), 2), np.int64)
            longer = np.empty((len(hull), 2), np.int64)
            longer[: size + 1] = more[: size + 1]
            more = longer
        size = _convex_hull(more, size + 1, hull)
        if not _fits(hull, size, epsilon2):
            return k - 1
    return stop - 1


@njit("i8(i8[:,::1], i8)", cache=True, nogil=True)
def _strips(points: NDArray[np.int64], epsilon2: int) -> int:
    """The fewest strips, each for a run of the points: the longest run, and so on."""
    count = 0
    k = 0
    while k < len(points):
        k = _strip_end(points, k, len(points), epsilon2) + 1
        count += 1
    return count


SHAPES = {
    "square": [".....", ".###.", ".###.", ".###.", "....."],
    "diagonal": ["#....", ".#...", "..#..", "...#.", "....#"],
    "three states": ["??..??", "?#..#?", "?#..#?", "######", "??????"],
}


def main() -> None:
    """Print the numbers of the shapes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tiny", action="store_true", help="nothing is large here: for the tests")
    parser.parse_args()
    print(f"{'shape':14s} {'profile':8s} {'arcs':>6s} {'edges':>6s} {'lines':>6s}")
    for name, rows in SHAPES.items():
        states = np.array([[".#?".index(c) for c in row] for row in reversed(rows)], np.uint8)
        for profile, epsilon2 in (("share", 512), ("full", 512), ("exact", 63)):
            arcs = trace(states, profile)
            edges, lines = (sum(f(arc, epsilon2) for arc in arcs) for f in (fewest_edges, fewest_lines))
            print(f"{name:14s} {profile:8s} {len(arcs):6d} {edges:6d} {lines:6d}")


if __name__ == "__main__":
    main()
