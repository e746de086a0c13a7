"""Compiled loops over points of walls: which point of the other map is nearest and faces alike, and what follows.

A map is a table of points sorted by the cell that they lie in (``walls.Index``): columns x, y, normal x, normal y,
metres of wall, and how many of these count where the other map has none. ``frame`` is (x, y of the lower left corner
of the cells, their size, how many in a row, how many rows).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.kernel import kernel

Floats = NDArray[np.float64]

ALIKE = 0.9
"""Least cosine between two walls' normals that may be one wall."""


@kernel("int64(float64[:,::1], int64[::1], float64[::1], float64, float64, float64, float64, float64)")
def nearest(
    table: Floats, start: NDArray[np.int64], frame: Floats, x: float, y: float, nx: float, ny: float, radius_m: float
) -> int:
    """The row of the nearest point within a radius that faces alike; -1 if there is none."""
    columns, rows = int(frame[3]), int(frame[4])
    first_column = max(int(np.floor((x - radius_m - frame[0]) / frame[2])), 0)
    last_column = min(int(np.floor((x + radius_m - frame[0]) / frame[2])), columns - 1)
    first_row = max(int(np.floor((y - radius_m - frame[1]) / frame[2])), 0)
    last_row = min(int(np.floor((y + radius_m - frame[1]) / frame[2])), rows - 1)
    best, found = radius_m * radius_m, -1
    if last_column < first_column:
        return found
    for row in range(first_row, last_row + 1):
        for k in range(start[row * columns + first_column], start[row * columns + last_column + 1]):
            dx, dy = table[k, 0] - x, table[k, 1] - y
            near = dx * dx + dy * dy
            if near < best and table[k, 2] * nx + table[k, 3] * ny > ALIKE:
                best, found = near, k
    return found


@kernel(
    "float64[:,::1](float64[:,::1], int64[::1], float64[::1], float64[:,::1], float64[:,::1], float64[::1], float64, "
    "float64)"
)
def normal_equations(
    table: Floats, start: NDArray[np.int64], frame: Floats, points: Floats, poses: Floats, middle: Floats,
    radius_m: float, soft_m: float,
) -> Floats:  # fmt: skip
    """For each pose (h, 3) of points (n, 6) the sums of Gauss-Newton, about where it puts ``middle``: (h, 12).

    Columns: xx, xy, xt, yy, yt, tt of the matrix, x, y, t of the right side, and of the wall that matches its metres
    and, times these, its x and y.
    """
    out = np.zeros((len(poses), 12))
    for h in range(len(poses)):
        c, s = np.cos(poses[h, 2]), np.sin(poses[h, 2])
        for i in range(len(points)):
            turned_x, turned_y = c * points[i, 0] - s * points[i, 1], s * points[i, 0] + c * points[i, 1]
            nx, ny = c * points[i, 2] - s * points[i, 3], s * points[i, 2] + c * points[i, 3]
            x, y = turned_x + poses[h, 0], turned_y + poses[h, 1]
            k = nearest(table, start, frame, x, y, nx, ny, radius_m)
            if k < 0:
                continue
            ax, ay = table[k, 2], table[k, 3]
            off = (table[k, 0] - x) * ax + (table[k, 1] - y) * ay
            arm_x = turned_x - (c * middle[0] - s * middle[1])
            arm_y = turned_y - (s * middle[0] + c * middle[1])
            at = ay * arm_x - ax * arm_y
            weight = points[i, 4] / (1 + (off / soft_m) ** 2)
            out[h, 0] += weight * ax * ax
            out[h, 1] += weight * ax * ay
            out[h, 2] += weight * ax * at
            out[h, 3] += weight * ay * ay
            out[h, 4] += weight * ay * at
            out[h, 5] += weight * at * at
            out[h, 6] += weight * ax * off
            out[h, 7] += weight * ay * off
            out[h, 8] += weight * at * off
            out[h, 9] += points[i, 4]
            out[h, 10] += points[i, 4] * x
            out[h, 11] += points[i, 4] * y
    return out


@kernel(
    "float64[::1](float64[:,::1], int64[::1], float64[::1], float64[:,::1], float64[::1], float32[:,::1], "
    "uint8[:,::1], float64[::1], boolean[::1])"
)
def one_way(
    table: Floats, start: NDArray[np.int64], frame: Floats, points: Floats, pose: Floats,
    clearance: NDArray[np.float32], states: NDArray[np.uint8], limits: Floats, matched: NDArray[np.bool_],
) -> Floats:  # fmt: skip
    """What the other map says of points (n, 6) at one pose; ``matched`` (n,) is filled with which of them it has, too.

    Parameters
    ----------
    clearance, states : of the other map, in cells
    limits : x, y of the cells' lower left corner, their size; how near two sights of a wall are; how deep in free space
        a wall contradicts; how far inside of its free side it is looked whether the place is known

    Returns
    -------
    (12,) : metres of wall explained, in conflict, visible; the sum of squares of the distances; xx, xy, yy of the
        matched normals; and x, y, xx, xy, yy of the matched points, all times their metres
    """
    out = np.zeros(12)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    height, width = states.shape
    for i in range(len(points)):
        x = c * points[i, 0] - s * points[i, 1] + pose[0]
        y = s * points[i, 0] + c * points[i, 1] + pose[1]
        nx, ny = c * points[i, 2] - s * points[i, 3], s * points[i, 2] + c * points[i, 3]
        k = nearest(table, start, frame, x, y, nx, ny, limits[3])
        matched[i] = k >= 0
        length = points[i, 4]
        if k >= 0:
            off = (table[k, 0] - x) * table[k, 2] + (table[k, 1] - y) * table[k, 3]
            out[0] += length
            out[2] += length
            out[3] += length * off * off
            out[4] += length * nx * nx
            out[5] += length * nx * ny
            out[6] += length * ny * ny
            out[7] += length * x
            out[8] += length * y
            out[9] += length * x * x
            out[10] += length * x * y
            out[11] += length * y * y
            continue
        column, row = int(np.floor((x - limits[0]) / limits[2])), int(np.floor((y - limits[1]) / limits[2]))
        if 0 <= column < width and 0 <= row < height and clearance[row, column] > limits[4]:
            out[1] += points[i, 5]
        x, y = x + limits[5] * nx, y + limits[5] * ny
        column, row = int(np.floor((x - limits[0]) / limits[2])), int(np.floor((y - limits[1]) / limits[2]))
        if 0 <= column < width and 0 <= row < height and states[row, column] != 2:
            out[2] += points[i, 5]
    return out


@kernel("int64(float64[:,::1], int64[::1], boolean[::1], float64, float64, float64)")
def count_lines(
    points: Floats, first: NDArray[np.int64], matched: NDArray[np.bool_], share: float, least_m: float, apart_m: float
) -> int:
    """How many different lines the matched segments lie on.

    Parameters
    ----------
    points : (n, 6), those of one segment after each other
    first : the first point of each segment, the longest segment first; and how many points it has: (segments, 2), flat
    share, least_m : of a segment that counts as matched, and how long it is at least
    apart_m : two lines that face alike are so far apart
    """
    lines = np.zeros((len(first) // 2, 3))
    found = 0
    for k in range(len(first) // 2):
        length, there, x, y = 0.0, 0.0, 0.0, 0.0
        for i in range(first[2 * k], first[2 * k] + first[2 * k + 1]):
            length += points[i, 4]
            there += points[i, 4] * matched[i]
            x += points[i, 4] * points[i, 0]
            y += points[i, 4] * points[i, 1]
        if length < least_m or there < share * length:
            continue
        nx, ny = points[first[2 * k], 2], points[first[2 * k], 3]
        known = False
        for line in range(found):
            off = abs((x * lines[line, 0] + y * lines[line, 1]) / length - lines[line, 2])
            known |= off < apart_m and nx * lines[line, 0] + ny * lines[line, 1] > 0.97
        if not known:
            lines[found] = nx, ny, (x * nx + y * ny) / length
            found += 1
    return found
