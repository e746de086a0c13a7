"""Numba kernels that find edges which have jumped over something: no edges meet, but the faces are others.

An obstacle of a cell or two beside a wall may end up inside of it, when the edge of the wall passes on its other
side. Each edge is moved, in thought, from its run of boundary to where it lies; what it passes over it has jumped.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.kernel import kernel
from fleetmap.vectorize.conflict_kernels import BUCKET

SCALE = 1 << 24
SHIFT_Y, SHIFT_X, SHIFT_ALONG = 505, 289, 1024
"""Points are looked at this little (in 1 / SCALE of a cell) up, to the right, and along the boundary of their own, from
where they are. So none lies on a line between lattice points: no edge of at most 4096 cells comes nearer to one that it
does not pass through. And none lies on another boundary that touches its own one at a corner: along, it is beyond the
other one's cracks. Products of a difference in cells (2^13) and one in these units (2^37) stay below 2^51."""


@kernel("i8(i8, i8, i8, i8, i8, i8, i8, i8)", inline="always")
def side_of(ay: int, ax: int, by: int, bx: int, py: int, px: int, shift_y: int, shift_x: int) -> int:
    """Positive if the shifted p lies on the left of the line from a to b; never 0."""
    return (bx - ax) * ((py - ay) * SCALE + shift_y) - (by - ay) * ((px - ax) * SCALE + shift_x)


@kernel("i8(i4[:,::1], i8, i8, i8, i8, i8[:,::1], i8, i8, i8, i8, i8, i8)")
def count_passes(
    points: NDArray[np.int32],
    tail: int,
    head: int,
    start: int,
    end: int,
    edges: NDArray[np.int64],
    k: int,
    py: int,
    px: int,
    wy: int,
    wx: int,
    way: int,
) -> int:
    """How often edge k, going from its run to its place, passes over a vertex that goes from p to w.

    The run leads from corner ``tail`` to corner ``head`` of an arc with the corners ``start`` to ``end``; the vertex's
    own boundary leaves p in the direction ``way``. The sum of how often edge and run wind around w, and how often the
    way from p to w crosses the run; signed.
    """
    shift_y = SHIFT_Y + SHIFT_ALONG * (np.int64(way == 1) - np.int64(way == 3))
    shift_x = SHIFT_X + SHIFT_ALONG * (np.int64(way == 0) - np.int64(way == 2))
    below = wy if shift_y > 0 else wy - 1  # the highest row of lattice points that are below the shifted w
    passes = 0
    cy, cx = edges[k, 2], edges[k, 3]
    dy, dx = edges[k, 0], edges[k, 1]
    m = tail
    stage = 0
    while True:
        # Back along the edge from its head, to the tail's point, along the run, to the head again.
        if (cy <= below) != (dy <= below):
            side = side_of(cy, cx, dy, dx, wy, wx, shift_y, shift_x)
            if dy > cy and side > 0:
                passes += 1
            elif dy < cy and side < 0:
                passes -= 1
        if stage == 3:
            break
        cy, cx = dy, dx
        if stage == 0:
            dy, dx = points[m, 0], points[m, 1]
            stage = 1
        elif m == head:
            dy, dx = edges[k, 2], edges[k, 3]
            stage = 3
        else:
            m += 1
            if m == end:
                m = start
            dy, dx = points[m, 0], points[m, 1]
            p_side = side_of(cy, cx, dy, dx, py, px, shift_y, shift_x) > 0
            w_side = side_of(cy, cx, dy, dx, wy, wx, shift_y, shift_x) > 0
            if p_side != w_side:
                # c and d against the way from p to w: the same shift, seen from them.
                c_side = (wx - px) * ((cy - py) * SCALE - shift_y) - (wy - py) * ((cx - px) * SCALE - shift_x)
                d_side = (wx - px) * ((dy - py) * SCALE - shift_y) - (wy - py) * ((dx - px) * SCALE - shift_x)
                if (c_side > 0) != (d_side > 0):
                    passes += 1 if p_side else -1
    return passes


@kernel(
    "void(i4[:,::1], i4[::1], i4[::1], i4[::1], i4[::1], i8[:,::1], u1[::1], i8, i8, i4[:,::1], i4[:,::1],"
    " i4[::1], i4[::1], i8, u1[::1])",
)
def find_jumps(
    points: NDArray[np.int32],
    offsets: NDArray[np.int32],
    tails: NDArray[np.int32],
    heads: NDArray[np.int32],
    arc_of: NDArray[np.int32],
    edges: NDArray[np.int64],
    alive: NDArray[np.uint8],
    low_y: int,
    low_x: int,
    buckets: NDArray[np.int32],
    links: NDArray[np.int32],
    part_of: NDArray[np.int32],
    witnesses: NDArray[np.int32],
    reach: int,
    bad: NDArray[np.uint8],
) -> None:
    """Set ``bad`` for edges that have jumped over the tail of a ``witnesses`` edge of another part, and for that one.

    ``part_of`` says for each arc which part of the network, connected in itself, it belongs to: if nothing crosses, a
    part is jumped over as a whole, and one witness of it is enough. ``reach`` is epsilon rounded up, in cells; buckets
    and links as in ``link_and_test``.
    """
    looked_at = np.full(len(edges), -1, np.int32)
    for n in range(len(witnesses)):
        e = witnesses[n]
        wy, wx, py, px = edges[e, 0], edges[e, 1], edges[e, 4], edges[e, 5]
        y0, y1 = min(wy, py) - reach - low_y, max(wy, py) + reach - low_y
        x0, x1 = min(wx, px) - reach - low_x, max(wx, px) + reach - low_x
        for row in range(max(y0, 0) // BUCKET, min(y1 // BUCKET + 1, len(buckets))):
            for column in range(max(x0, 0) // BUCKET, min(x1 // BUCKET + 1, buckets.shape[1])):
                link = np.int64(buckets[row, column])
                while link >= 0:
                    k = links[link, 0]
                    link = np.int64(links[link, 1])
                    if not alive[k] or looked_at[k] == n or part_of[arc_of[k]] == part_of[arc_of[e]]:
                        continue
                    looked_at[k] = n
                    if (
                        max(edges[k, 0], edges[k, 2]) + reach < min(wy, py)
                        or min(edges[k, 0], edges[k, 2]) - reach > max(wy, py)
                        or max(edges[k, 1], edges[k, 3]) + reach < min(wx, px)
                        or min(edges[k, 1], edges[k, 3]) - reach > max(wx, px)
                    ):
                        continue
                    arc = arc_of[k]
                    if count_passes(
                        points, tails[k], heads[k], offsets[arc], offsets[arc + 1], edges, k, py, px, wy, wx,
                        edges[e, 8] & 3,
                    ):  # fmt: skip
                        bad[k] = 1
                        bad[e] = 1
