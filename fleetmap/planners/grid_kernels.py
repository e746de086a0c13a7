"""Kernels of the grid planner: clearance by exact point-to-edge distances, A*, and segment clearance."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.kernel import kernel


@kernel("float64(float64, float64, float64, float64, float64, float64)")
def point_segment_d2(px: float, py: float, ax: float, ay: float, bx: float, by: float) -> float:
    """Squared distance from a point to a segment."""
    dx, dy = bx - ax, by - ay
    length2 = dx * dx + dy * dy
    t = 0.0
    if length2 > 0.0:
        t = min(1.0, max(0.0, ((px - ax) * dx + (py - ay) * dy) / length2))
    ex, ey = ax + t * dx - px, ay + t * dy - py
    return ex * ex + ey * ey


@kernel("void(boolean[:, ::1], float64[:, ::1], float64)")
def block_near(passable: NDArray[np.bool_], walls: NDArray[np.float64], clearance: float) -> None:
    """Clear every cell whose centre is nearer than ``clearance`` to a wall, (n, 4) x0 y0 x1 y1; all in cells."""
    height, width = passable.shape
    limit2 = clearance * clearance
    for k in range(walls.shape[0]):
        ax, ay, bx, by = walls[k, 0], walls[k, 1], walls[k, 2], walls[k, 3]
        row0 = max(0, int(math.floor(min(ay, by) - clearance - 0.5)))
        row1 = min(height, int(math.ceil(max(ay, by) + clearance + 0.5)))
        for row in range(row0, row1):
            # Only the part of the edge that this row can see: a long diagonal doesn't cost its bounding box.
            y = row + 0.5
            t0, t1 = 0.0, 1.0
            if ay != by:
                ta = (y - clearance - ay) / (by - ay)
                tb = (y + clearance - ay) / (by - ay)
                t0, t1 = max(0.0, min(ta, tb)), min(1.0, max(ta, tb))
                if t0 > t1:
                    continue
            xa, xb = ax + t0 * (bx - ax), ax + t1 * (bx - ax)
            col0 = max(0, int(math.floor(min(xa, xb) - clearance - 0.5)))
            col1 = min(width, int(math.ceil(max(xa, xb) + clearance + 0.5)))
            for col in range(col0, col1):
                if passable[row, col] and point_segment_d2(col + 0.5, y, ax, ay, bx, by) < limit2:
                    passable[row, col] = False


@kernel("float64(float64, float64, float64, float64, float64[:, ::1], float64)")
def segment_clearance(px: float, py: float, qx: float, qy: float, walls: NDArray[np.float64], enough: float) -> float:
    """Least distance from segment pq to the walls, or ``enough`` if all of them are farther than that."""
    best2 = enough * enough
    low_x, high_x = min(px, qx) - enough, max(px, qx) + enough
    low_y, high_y = min(py, qy) - enough, max(py, qy) + enough
    for k in range(walls.shape[0]):
        ax, ay, bx, by = walls[k, 0], walls[k, 1], walls[k, 2], walls[k, 3]
        if max(ax, bx) < low_x or min(ax, bx) > high_x or max(ay, by) < low_y or min(ay, by) > high_y:
            continue
        side_a = (qx - px) * (ay - py) - (qy - py) * (ax - px)
        side_b = (qx - px) * (by - py) - (qy - py) * (bx - px)
        side_p = (bx - ax) * (py - ay) - (by - ay) * (px - ax)
        side_q = (bx - ax) * (qy - ay) - (by - ay) * (qx - ax)
        if side_a * side_b < 0.0 and side_p * side_q < 0.0:
            return 0.0
        best2 = min(best2, point_segment_d2(ax, ay, px, py, qx, qy))
        best2 = min(best2, point_segment_d2(bx, by, px, py, qx, qy))
        best2 = min(best2, point_segment_d2(px, py, ax, ay, bx, by))
        best2 = min(best2, point_segment_d2(qx, qy, ax, ay, bx, by))
    return math.sqrt(best2)


@kernel("boolean(boolean[:, ::1], float64, float64, float64, float64)")
def stays_free(free: NDArray[np.bool_], px: float, py: float, qx: float, qy: float) -> bool:
    """Whether every cell that segment pq passes is free (Amanatides and Woo, 1987, section 2)."""
    height, width = free.shape
    col, row = int(math.floor(px)), int(math.floor(py))
    last_col, last_row = int(math.floor(qx)), int(math.floor(qy))
    dx, dy = qx - px, qy - py
    step_x, step_y = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
    next_x = ((col + (1 if dx > 0 else 0)) - px) / dx if dx != 0.0 else math.inf
    next_y = ((row + (1 if dy > 0 else 0)) - py) / dy if dy != 0.0 else math.inf
    for _ in range(abs(last_col - col) + abs(last_row - row) + 1):
        if not (0 <= row < height and 0 <= col < width) or not free[row, col]:
            return False
        if next_x < next_y:
            col += step_x
            next_x += abs(1.0 / dx)
        else:
            row += step_y
            next_y += abs(1.0 / dy) if dy != 0.0 else math.inf
    return True


@kernel("int64[::1](boolean[:, ::1], int64, int64)")
def astar(passable: NDArray[np.bool_], start: int, goal: int) -> NDArray[np.int64]:
    """8-connected A* with the octile heuristic; flat cell indices from start to goal, empty if there is no path.

    The open list is a binary heap with lazy deletion; ties go to the entry that was pushed first, so that
    the path doesn't depend on anything but the map.
    """
    height, width = passable.shape
    cost = np.full(height * width, np.inf)
    parent = np.full(height * width, -1, np.int64)
    closed = np.zeros(height * width, np.bool_)
    goal_row, goal_col = goal // width, goal % width
    diagonal = math.sqrt(2.0)
    heap = [(0.0, 0, start)]
    cost[start] = 0.0
    pushed = 0
    while len(heap) > 0:
        # heappop
        cell = heap[0][2]
        last = heap.pop()
        if len(heap) > 0:
            i = 0
            while True:
                child = 2 * i + 1
                if child >= len(heap):
                    break
                if child + 1 < len(heap) and heap[child + 1] < heap[child]:
                    child += 1
                if not heap[child] < last:
                    break
                heap[i] = heap[child]
                i = child
            heap[i] = last
        if closed[cell]:
            continue
        closed[cell] = True
        if cell == goal:
            break
        row, col = cell // width, cell % width
        for dr in range(-1, 2):
            for dc in range(-1, 2):
                r, c = row + dr, col + dc
                if (dr == 0 and dc == 0) or r < 0 or c < 0 or r >= height or c >= width or not passable[r, c]:
                    continue
                other = r * width + c
                through = cost[cell] + (diagonal if dr != 0 and dc != 0 else 1.0)
                if closed[other] or through >= cost[other]:
                    continue
                cost[other] = through
                parent[other] = cell
                a, b = abs(r - goal_row), abs(c - goal_col)
                pushed += 1
                entry = (through + max(a, b) + (diagonal - 1.0) * min(a, b), pushed, other)
                # heappush
                heap.append(entry)
                i = len(heap) - 1
                while i > 0 and entry < heap[(i - 1) // 2]:
                    heap[i] = heap[(i - 1) // 2]
                    i = (i - 1) // 2
                heap[i] = entry
    if not closed[goal]:
        return np.empty(0, np.int64)
    count = 1
    cell = goal
    while cell != start:
        cell = parent[cell]
        count += 1
    path = np.empty(count, np.int64)
    cell = goal
    for i in range(count - 1, -1, -1):
        path[i] = cell
        cell = parent[cell]
    return path
