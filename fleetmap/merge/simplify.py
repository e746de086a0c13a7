"""Step 6: collinear re-simplification: chains of pieces of one kind become as few edges as the slack allows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.merge.arrange import lower_end_first, pack, unpack
from fleetmap.merge.tiles import tiles_of_points
from fleetmap.model.mergedmap import LEFT, OBSTACLE, RIGHT, THICKNESS


def simplify(rows: NDArray[np.int64], *, slack: int, depth_slack: int) -> NDArray[np.int64]:
    """Replace runs of pieces by chords.

    Parameters
    ----------
    rows : (n, 8) as in ``MergedMap``, ascending; they meet only at vertices
    slack : how far a vertex may lie from the edge that passes it, lattice steps; at most 2^13
    depth_slack : how far the thicknesses that one edge stands for may differ; it gets the largest

    Returns
    -------
    (m, 8), m <= n, ascending. Edges still meet only at vertices, all of them vertices of ``rows``; every face
    keeps its state.
    """
    from fleetmap.merge.simplify_kernels import chains, simplify_chains

    if len(rows) == 0:
        return rows
    vertices, ids = np.unique(pack(rows[:, :4].reshape(-1, 2)), return_inverse=True)
    ids = ids.reshape(-1, 2)
    at = unpack(vertices)
    left, right, wall = rows[:, LEFT], rows[:, RIGHT], rows[:, OBSTACLE]
    kind, turned = 6 * left + 2 * right + wall, 6 * right + 2 * left + wall
    v0, v1 = np.ascontiguousarray(ids[:, 0]), np.ascontiguousarray(ids[:, 1])
    points, offsets, steps = chains(v0, v1, kind, turned, len(vertices))

    # The step that starts at each position; the last position of a chain starts none.
    starts = np.ones(len(points), bool)
    starts[offsets[1:] - 1] = False
    step_at = np.zeros(len(points), np.int64)
    step_at[starts] = steps
    depth = rows[step_at, THICKNESS]
    anchors = _anchors(at, points, offsets)
    keep = simplify_chains(at, points, offsets, depth, anchors, slack, depth_slack, *tiles_of_points(at))

    a, b = keep[:-1], keep[1:]
    inside = starts[a]  # from the last position of a chain to the first of the next is no edge
    a, b = a[inside], b[inside]
    edge = step_at[a]
    along = v0[edge] == points[a]
    sides = np.where(along[:, None], rows[edge][:, [LEFT, RIGHT]], rows[edge][:, [RIGHT, LEFT]])
    ends, against = lower_end_first(np.column_stack([at[points[a]], at[points[b]]]))
    sides[against] = sides[against][:, ::-1]
    # Of the depths from a to b - 1; the position b - 1 starts the last step of the chord.
    thickness = np.maximum.reduceat(depth, np.column_stack([a, b]).ravel())[::2]
    out = np.column_stack([ends, sides, rows[edge, OBSTACLE], thickness])
    return out[np.lexsort(out.T[::-1])]


def _anchors(at: NDArray[np.int64], points: NDArray[np.int64], offsets: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Positions that must stay lest two chains between the same two vertices become one edge.

    A closed chain is taken as two, cut at its vertex farthest from the start. Each of several chains between
    the same vertices keeps its vertex farthest from the line between them, if it has any.
    """
    from fleetmap.merge.simplify_kernels import farthest

    anchor = np.zeros(len(points), bool)
    spans = np.column_stack([offsets[:-1], offsets[1:] - 1])
    closed = points[spans[:, 0]] == points[spans[:, 1]]
    middles = farthest(at, points, np.ascontiguousarray(spans[closed]))
    anchor[middles] = True
    first, last = spans[closed].T
    halves = np.column_stack([first, middles]), np.column_stack([middles, last])
    spans = np.concatenate([spans[~closed], *halves])
    ends = points[spans]
    keys = ends.min(axis=1) * len(at) + ends.max(axis=1)
    _, which, count = np.unique(keys, return_inverse=True, return_counts=True)
    several = (count[which] > 1) & (spans[:, 1] - spans[:, 0] >= 2)
    anchor[farthest(at, points, np.ascontiguousarray(spans[several]))] = True
    return anchor
