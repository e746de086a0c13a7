"""Step 1: put the edges of a source onto the fleet lattice, with free space to their left.

A vertex goes where its coordinates say, whatever edges it has. So the directed free boundary of a source,
which is a set of cycles, stays one, and its winding number (1 inside free space, 0 outside) stays defined
through placing, snapping and rounding alike: no step can tear a face open.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fleetmap.merge.origin import MAX_EXTENT, Box, in_metres
from fleetmap.merge.protocol import Source
from fleetmap.model.errors import ConfigError, MapFormatError
from fleetmap.model.lattice import FREE, OCCUPIED, Lattice
from fleetmap.model.mergedmap import FLEET_UM
from fleetmap.model.pose import FixedPose
from fleetmap.model.vectormap import THICKNESS_PER_CELL, VectorMap

MAX_LENGTH = 1 << 16
"""Longest edge along one axis, in lattice steps (328 m): intersections then fit 55 bits (arrange_kernels)."""

NOT_CLOSED = "the boundary of free space is not closed, so that no side of it can be told to be free"

MAX_TOTAL_LENGTH = 1 << 26
"""Edges of one source together, by their longer sides, in lattice steps (336 km): a bound for the tiles they pass."""

MAX_THICKNESS = 1 << 14
"""Deepest wall, in lattice steps (82 m): a bound for what another robot may claim."""


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """Directed edges on the fleet lattice, sorted: what the fold knows of one source.

    Until its origin is chosen, in steps from (0, 0) of the component's frame.

    Parameters
    ----------
    ends : (n, 4) int64 rows (y_from, x_from, y_to, x_to); free space is on the left. The back of a wall
        (occupied against unknown) has the unknown on its left.
    winds : (n,) int64; 1 for an edge of the free boundary, 0 for the back of a wall
    wall : (n,) int64; 1 if the right side is occupied
    thickness : (n,) int64 lattice steps
    cell : size of a cell of the source in lattice steps, rounded up, at least 1
    resolution_um : the same in micrometres
    """

    ends: NDArray[np.int64]
    winds: NDArray[np.int64]
    wall: NDArray[np.int64]
    thickness: NDArray[np.int64]
    cell: int
    resolution_um: int

    def box(self) -> Box | None:
        """Where the edges lie; None if there are none."""
        return Box.of(self.ends.reshape(-1, 2)) if len(self.ends) else None

    def seen_from(self, origin: tuple[int, int]) -> Placed:
        """The same edges from an origin (y, x)."""
        return replace(self, ends=self.ends - np.array([*origin, *origin]))

    def content(self) -> bytes:
        """Two sources are the same to the fold if these bytes are: what they are sorted and deduplicated by."""
        rows = np.column_stack([self.ends, self.winds, self.wall, self.thickness])
        return self.resolution_um.to_bytes(4, "big") + rows.astype(">i8").tobytes()


def place(source: Source) -> Placed:
    """Place ``source`` on the fleet lattice that begins at (0, 0).

    Raises
    ------
    MapFormatError : its pose is out of bounds, it extends more than ``MAX_EXTENT`` steps along an axis, its edges are
        longer in all than ``MAX_TOTAL_LENGTH``, or its free boundary is not closed, so that no side of it can be told
        to be free
    """
    vector_map = source.vector_map
    lattice = vector_map.lattice
    rows = vector_map.edges.astype(np.int64)
    try:
        points = to_fleet(source.T_fleet_frame, lattice, rows[:, :4].reshape(-1, 2))
    except ConfigError as error:
        raise _refuse(source, "T_fleet_frame", str(error)) from error
    if len(points) and (extent := Box.of(points).extent) > MAX_EXTENT:
        raise _refuse(source, "edges", f"extends {in_metres(extent)}; at most {in_metres(MAX_EXTENT)}")

    ends, winds, wall = directed(points.reshape(-1, 4), rows[:, 4])
    if (length := int(np.abs(ends[:, 2:] - ends[:, :2]).max(axis=1, initial=0).sum())) > MAX_TOTAL_LENGTH:
        reason = f"{length * FLEET_UM // 10**9} km long together; at most {MAX_TOTAL_LENGTH * FLEET_UM // 10**9} km"
        raise _refuse(source, "edges", reason)
    if not is_closed(ends[winds == 1]):
        raise _refuse(source, "edges", NOT_CLOSED)

    steps = vector_map.thickness.astype(np.int64) * lattice.resolution_um
    thickness = np.minimum(-(-steps // (THICKNESS_PER_CELL * FLEET_UM)), MAX_THICKNESS) * wall
    table = np.column_stack([ends, winds, wall, thickness])
    table = table[(ends[:, :2] != ends[:, 2:]).any(axis=1)]  # an edge that rounding made a point
    table = split_long(table)
    table = table[np.lexsort(table.T[::-1])]
    return Placed(
        np.ascontiguousarray(table[:, :4]),
        table[:, 4].copy(),
        table[:, 5].copy(),
        table[:, 6].copy(),
        max(1, -(-lattice.resolution_um // FLEET_UM)),
        lattice.resolution_um,
    )


def pair_cell(a: int, b: int) -> int:
    """The cell size by which maps of cell sizes ``a`` and ``b`` are drawn together: the coarser one's.

    At most twice the finer one's, so that no robot that claims huge cells can blur the maps of others.
    """
    return min(max(a, b), 2 * min(a, b))


def to_fleet(T_fleet_frame: FixedPose, lattice: Lattice, points_yx: NDArray[np.int64]) -> NDArray[np.int64]:
    """(n, 2) lattice points (y, x) -> (n, 2) fleet lattice points (y, x), rounded half up.

    Notes
    -----
    The two poses are composed in Python integers, each component rounded once. The fleet steps per cell,
    at most 2000, are then held in Q30: |cos|, |sin| <= 2^41 and |cell| <= 2^20 give
    |cos x - sin y| <= 2^41 * 2^20.5, to which whole steps of the offset are added after the division by 2^30. The
    rounding of the Q30 factor moves a point by at most 2^20 / 2^30 steps, 5 um. The result is below 2^34: so are all
    numbers from (0, 0) on; after the origin was chosen, and subtracted, they are below 2^21.
    """
    pose = T_fleet_frame @ lattice.T_frame_lattice
    cos = _round_div(pose.cos_q30 * lattice.resolution_um, FLEET_UM)
    sin = _round_div(pose.sin_q30 * lattice.resolution_um, FLEET_UM)
    steps_x, rest_x = divmod(_round_div(pose.x_um << 30, FLEET_UM) + (1 << 29), 1 << 30)
    steps_y, rest_y = divmod(_round_div(pose.y_um << 30, FLEET_UM) + (1 << 29), 1 << 30)
    y, x = points_yx[:, 0], points_yx[:, 1]
    turned_y, turned_x = sin * x + cos * y + rest_y, cos * x - sin * y + rest_x
    return np.column_stack([(turned_y >> 30) + steps_y, (turned_x >> 30) + steps_x])


def directed(
    ends: NDArray[np.int64], labels: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Edges (n, 4), lower end first, turned so that free space is on their left: ``ends``, ``winds``, ``wall``."""
    left, right = np.divmod(labels, 3)
    turned = (right == FREE) | ((left == OCCUPIED) & (right != FREE))
    winds = ((left == FREE) | (right == FREE)).astype(np.int64)
    wall = ((left == OCCUPIED) | (right == OCCUPIED)).astype(np.int64)
    return np.where(turned[:, None], ends[:, [2, 3, 0, 1]], ends), winds, wall


def check_closed(vector_map: VectorMap, *, path: str) -> None:
    """Check what ``place`` asks of a map by itself.

    Raises
    ------
    MapFormatError : the boundary of its free space is not closed
    """
    rows = vector_map.edges.astype(np.int64)
    ends, winds, _ = directed(rows[:, :4], rows[:, 4])
    if not is_closed(ends[winds == 1]):
        raise MapFormatError(path=path, field="edges", reason=NOT_CLOSED)


def is_closed(ends: NDArray[np.int64]) -> bool:
    """Whether as many of the directed edges (n, 4) leave each point as reach it."""
    # Far from (0, 0) the sums wrap around; within ``MAX_EXTENT`` of each other no two points become one by that.
    leave = ends[:, 0] * (1 << 32) + ends[:, 1]
    reach = ends[:, 2] * (1 << 32) + ends[:, 3]
    return bool(np.array_equal(np.sort(leave), np.sort(reach)))


def split_long(table: NDArray[np.int64]) -> NDArray[np.int64]:
    """Cut edges longer than ``MAX_LENGTH`` into equal parts at rounded points; columns after 4 are inherited.

    The points depend on the edge alone, not on its direction, so that two sources cut one edge alike.
    """
    length = np.abs(table[:, 2:4] - table[:, :2]).max(axis=1, initial=0)
    parts = -(-length // MAX_LENGTH)
    if (parts <= 1).all():
        return table
    cut = []
    for row in table[parts > 1].tolist():
        (y0, x0), (y1, x1) = sorted([(row[0], row[1]), (row[2], row[3])])
        k = -(-max(y1 - y0, abs(x1 - x0)) // MAX_LENGTH)
        points = [(y0 + _round_div((y1 - y0) * i, k), x0 + _round_div((x1 - x0) * i, k)) for i in range(k + 1)]
        if points[0] != (row[0], row[1]):
            points.reverse()
        cut += [[*a, *b, *row[4:]] for a, b in zip(points[:-1], points[1:], strict=True)]
    return np.concatenate([table[parts <= 1], np.array(cut, np.int64)])


def _round_div(value: int, divisor: int) -> int:
    """``value / divisor`` rounded half up, exactly; ``divisor`` is positive."""
    return (2 * value + divisor) // (2 * divisor)


def _refuse(source: Source, field: str, reason: str) -> MapFormatError:
    return MapFormatError(path="/".join(map(str, source.frame)), field=field, reason=reason)
