"""Checks of the verifier against the sources: where walls, free space and doors are. Floats, at sample points."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from fleetmap.merge.protocol import Source
from fleetmap.merge.verify_planar import Found
from fleetmap.model.lattice import FREE
from fleetmap.model.mergedmap import FLEET_UM, MergedMap
from fleetmap.model.pose import Q30

Floats = NDArray[np.float64]

ROUNDING = 1e-3
"""Slack of every comparison, in lattice steps: far above what float64 loses."""

MAX_SAMPLES = 200_000
"""Points at which space is sampled; a larger map is sampled more coarsely."""


def check_accuracy(sources: list[Source], merged: MergedMap, spacing: int) -> Iterator[Found]:
    """Laws 3 and 5: walls of sources against merged walls, both ways."""
    walls = np.concatenate([_segments(s, merged)[_wall(s)] for s in sources] or [np.zeros((0, 2, 2))])
    merged_walls = _merged_segments(merged)[merged.obstacle]
    for law, from_walls, to_walls, what in (
        ("safety", walls, merged_walls, "a wall of a source"),
        ("accuracy", merged_walls, walls, "a merged wall"),
    ):
        points = _along(from_walls, spacing)
        distance = _distance(points, to_walls)
        for k in np.flatnonzero(distance > merged.tolerance + ROUNDING).tolist():
            x, y = points[k].tolist()
            yield law, y, x, f"{what} lies {distance[k]:.1f} steps off; at most {merged.tolerance}"


def check_space(sources: list[Source], merged: MergedMap) -> Iterator[Found]:
    """Free space, and law 4: what sources saw as free is free, and as far from walls."""
    from scipy.spatial import cKDTree

    segments = [_segments(s, merged) for s in sources]
    boundary = np.concatenate(segments or [np.zeros((0, 2, 2))])
    if len(boundary) == 0:
        return
    walls = np.concatenate([e[_wall(s)] for e, s in zip(segments, sources, strict=True)])
    low, high = boundary.min(axis=(0, 1)) - 20, boundary.max(axis=(0, 1)) + 20
    step = max(10.0, float(np.sqrt(np.prod(high - low) / MAX_SAMPLES)))
    # Heights that no vertex of the fleet lattice has, so that each ray crosses edges inside.
    ys = np.floor(np.arange(low[1], high[1], step)) + 0.437
    xs = np.arange(low[0], high[0], step) + 0.219
    points = np.stack(np.meshgrid(xs, ys), axis=-1).reshape(-1, 2)

    free = np.zeros(len(points), bool)
    for source, edges in zip(sources, segments, strict=True):
        left, right = np.divmod(source.vector_map.edges[:, 4], 3)
        free |= (_winding(edges, (left == FREE).astype(int) - (right == FREE), xs, ys) > 0).ravel()
    sides = merged.edges[:, 4:6]
    jump = (sides[:, 0] == FREE).astype(int) - (sides[:, 1] == FREE)
    merged_segments = _merged_segments(merged)
    merged_free = (_winding(merged_segments, jump, xs, ys) > 0).ravel()

    margin = merged.tolerance + ROUNDING
    wrong = np.flatnonzero(free != merged_free)
    for k in wrong[_distance(points[wrong], boundary) > margin].tolist():
        x, y = points[k].tolist()
        yield "free", y, x, f"free in a source: {bool(free[k])}; in the merged map: {bool(merged_free[k])}"

    # How far free space reaches around each point: to a wall, or to where nobody saw free space (known at the
    # samples only, so a step nearer).
    seen, unseen = np.flatnonzero(free), np.flatnonzero(~free)
    to_unseen = cKDTree(points[unseen]).query(points[seen])[0] - step * np.sqrt(2)
    clearance = np.minimum(_distance(points[seen], walls), to_unseen)
    lost = clearance - _distance(points[seen], merged_segments[merged.obstacle])
    for k in np.flatnonzero(lost > merged.tolerance / 2 + ROUNDING).tolist():
        x, y = points[seen[k]].tolist()
        yield "door", y, x, f"{clearance[k]:.1f} steps of free space around, but a merged wall {lost[k]:.1f} nearer"


def _segments(source: Source, merged: MergedMap) -> Floats:
    """(n, 2, 2) ends (x, y) of a source's edges, in steps of the fleet lattice from the merged map's origin."""
    pose, points_um = source.T_fleet_frame, source.vector_map.segments_xy * 1e6
    # By the integers of the pose: its angle would lose half a millimetre where a map lies 500 km from its frame.
    c, s = pose.cos_q30 / Q30, pose.sin_q30 / Q30
    x = c * points_um[..., 0] - s * points_um[..., 1] + (pose.x_um - merged.origin_um[0])
    y = s * points_um[..., 0] + c * points_um[..., 1] + (pose.y_um - merged.origin_um[1])
    return np.stack([x, y], axis=-1) / FLEET_UM


def _merged_segments(merged: MergedMap) -> Floats:
    """(n, 2, 2) ends (x, y) of the merged edges, in steps of the fleet lattice from the map's origin."""
    return merged.edges[:, [1, 0, 3, 2]].reshape(-1, 2, 2).astype(np.float64)


def _wall(source: Source) -> NDArray[np.bool_]:
    from fleetmap.model.lattice import OCCUPIED

    left, right = np.divmod(source.vector_map.edges[:, 4], 3)
    return np.asarray((left == OCCUPIED) | (right == OCCUPIED))


def _along(segments: Floats, spacing: int) -> Floats:
    """(k, 2) points on segments (n, 2, 2), at most ``spacing`` apart, both ends among them."""
    if len(segments) == 0:
        return np.zeros((0, 2))
    parts = np.maximum(1, np.ceil(np.hypot(*(segments[:, 1] - segments[:, 0]).T) / spacing)).astype(int)
    which = np.repeat(np.arange(len(segments)), parts + 1)
    t = (np.arange(len(which)) - np.repeat(np.cumsum(parts + 1) - parts - 1, parts + 1)) / parts[which]
    a, b = segments[which, 0], segments[which, 1]
    return np.asarray(a + t[:, None] * (b - a))


def _distance(points: Floats, segments: Floats) -> Floats:
    """(k,) distances of points to the nearest of the segments; infinite if there are none."""
    import shapely

    if len(segments) == 0 or len(points) == 0:
        return np.full(len(points), np.inf)
    tree = shapely.STRtree(shapely.linestrings(segments))
    index, distance = tree.query_nearest(shapely.points(points), return_distance=True, all_matches=False)
    out = np.full(len(points), np.inf)
    out[index[0]] = distance
    return out


def _winding(segments: Floats, jump: NDArray[np.int64], xs: Floats, ys: Floats) -> NDArray[np.int64]:
    """(len(ys), len(xs)) sums of ``jump`` = (left is free) - (right is free) over what a ray from -x crosses."""
    count = np.zeros((len(ys), len(xs) + 1), np.int64)
    a, b = segments[:, 0], segments[:, 1]
    up = np.where(a[:, 1] < b[:, 1], 1, -1)
    first = np.searchsorted(ys, np.minimum(a[:, 1], b[:, 1]))
    last = np.searchsorted(ys, np.maximum(a[:, 1], b[:, 1]))
    for i in np.flatnonzero((last > first) & (jump != 0)).tolist():
        rows = np.arange(first[i], last[i])
        x = a[i, 0] + (ys[rows] - a[i, 1]) * (b[i, 0] - a[i, 0]) / (b[i, 1] - a[i, 1])
        # Crossing an upward edge towards +x goes from its left to its right.
        count[rows, np.searchsorted(xs, x)] -= up[i] * jump[i]
    return np.cumsum(count, axis=1)[:, : len(xs)]
