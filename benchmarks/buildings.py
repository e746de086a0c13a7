"""Pairs of partial maps with a known transform between them, or with none: what an aligner is tried on.

A building is a generated floor. Two robots see parts of it: what is near a place by the way that one can go, with some
cells of wall behind it. Each robot's grid is the floor sampled in that robot's own frame, of random place and yaw,
through a smooth warp of sigma 1.5 cm that changes over 0.4 m, with 3 % of the cells at boundaries flipped.

Kinds:

- ``same``: one floor, the parts overlap by a quarter of the smaller one at least
- ``little``: the same, by 15 to 25 %
- ``touching``: by less than 5 %
- ``apart``: not at all
- ``different``: parts of two floors
- ``mirrored``: parts of a floor and of its mirror image
- ``rooms``: a corridor with identical rooms, of which each robot has seen some
- ``corridor``: a long corridor with few doors, of which each robot has seen a part
- ``bent``: as ``same``, the second map bent by 0.03 degrees a metre and 0.3 % too large
- ``visits``: as ``same``, at two times: boxes and chairs stand where they didn't, one to each 8 to 60 m2 of floor
- ``wings``: two wings that are alike, moved, turned by 180 degrees or mirrored, and a middle that is not; the parts
  overlap by a tenth at least, which often is the middle alone

    python benchmarks/buildings.py [--each 3] [--out DIR]

prints how much some pairs of each kind overlap, and draws them.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN
from fleetmap.model.pose import Pose2
from fleetmap.sims.space_kernels import FAR, cost_field
from fleetmap.sims.worlds import make_world

CELL_M = 0.05
WARP_M, WARP_OVER_M = 0.015, 0.4
FLIPPED = 0.03
WALL_CELLS = 3
BEND_RAD_M, STRETCH = math.radians(0.03), 0.003
TRIES = 60

States = NDArray[np.uint8]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Pair:
    """Two maps.

    Parameters
    ----------
    kind, seed : what it is, and how it is made again
    a, b : the grids, each in its robot's frame
    T_a_b : the truth; None if there is none
    overlap : share of the smaller free area that both have seen
    shared_xy : (n, 2) metres in b: some points of what both have seen
    """

    kind: str
    seed: int
    a: OccupancyGrid
    b: OccupancyGrid
    T_a_b: Pose2 | None
    overlap: float
    shared_xy: NDArray[np.float64]


def make_pair(kind: str, seed: int) -> Pair:
    """The pair of that kind and seed; the same ones give the same pair."""
    rng = np.random.default_rng([sorted(KINDS).index(kind), seed])
    solid, other, low, high, most = KINDS[kind](rng)
    seen_a, seen_b = views(solid, other, low, high, rng, most=most)
    T_world_a, T_world_b = random_pose(rng, solid.shape), random_pose(rng, other.shape)
    floors = (clutter(solid, rng), clutter(other, rng)) if kind == "visits" else (solid, other)
    a = sample(floors[0], seen_a, T_world_a, rng, bent=False)
    b = sample(floors[1], seen_b, T_world_b, rng, bent=kind == "bent")
    if other is not solid:
        return Pair(kind, seed, a, b, None, 0.0, np.zeros((0, 2)))
    both = seen_a & seen_b & ~solid
    overlap = both.sum() / min((seen_a & ~solid).sum(), (seen_b & ~solid).sum())
    points = np.argwhere(both)[:: max(1, int(both.sum()) // 200)]
    shared_xy = T_world_b.inverse().apply((points[:, ::-1] + 0.5) * CELL_M)
    return Pair(kind, seed, a, b, T_world_a.inverse() @ T_world_b, float(overlap), shared_xy)


Made = tuple[Mask, Mask, float, float, float]
"""Two floors, the least and the most overlap, and the largest share of a floor that a robot has seen."""


def a_floor(rng: np.random.Generator) -> Mask:
    """An office, a hall with clutter, or a maze; oblong."""
    name = str(rng.choice(["office", "office", "office", "unstructured", "maze"]))
    solid = make_world(name, size_m=float(rng.uniform(20, 34)), seed=int(rng.integers(1 << 30))).solid
    height = int(solid.shape[0] * rng.uniform(0.6, 1.0))
    floor = solid[:height].copy()
    floor[-WALL_CELLS:] = True
    return floor


def one(low: float, high: float) -> Callable[[np.random.Generator], Made]:
    """Parts of one floor."""

    def made(rng: np.random.Generator) -> Made:
        floor = a_floor(rng)
        return floor, floor, low, high, 0.75

    return made


def two(rng: np.random.Generator) -> Made:
    """Parts of two floors."""
    return a_floor(rng), a_floor(rng), 0.0, 1.0, 0.75


def mirrored(rng: np.random.Generator) -> Made:
    """Parts of a floor and of its mirror image."""
    floor = a_floor(rng)
    return floor, np.ascontiguousarray(floor[:, ::-1]), 0.0, 1.0, 0.75


def rooms(rng: np.random.Generator) -> Made:
    """A corridor with as many identical rooms on each side as fit; the ends of the corridor were not seen."""
    count, width, depth = int(rng.integers(8, 13)), int(rng.integers(60, 100)), int(rng.integers(70, 110))
    corridor, door = int(rng.integers(36, 50)), int(rng.integers(18, 26))
    room = np.zeros((depth, width), bool)
    room[:WALL_CELLS] = room[-WALL_CELLS:] = room[:, :WALL_CELLS] = True
    at = int(rng.integers(10, width - door - 10))
    room[-WALL_CELLS:, at : at + door] = False
    for _ in range(int(rng.integers(0, 4))):  # the same furniture in each
        row, column = int(rng.integers(8, depth - 30)), int(rng.integers(8, width - 24))
        room[row : row + 14, column : column + 18] = True
    side = np.tile(room, (1, count))
    floor = np.vstack([side, np.zeros((corridor, side.shape[1]), bool), side[::-1]])
    # Beyond the ends the corridor goes on, unseen.
    return floor, floor, 0.0, 1.0, 0.45


def corridor(rng: np.random.Generator) -> Made:
    """A straight corridor of 50 to 90 m, with a door in each wall here and there."""
    length, width = int(rng.integers(1000, 1800)), int(rng.integers(32, 60))
    floor = np.ones((width + 24, length), bool)
    floor[12:-12] = False
    for _ in range(int(rng.integers(0, 4))):
        column = int(rng.integers(20, length - 40))
        rows = slice(4, 12) if rng.random() < 0.5 else slice(-12, -4)
        floor[rows, column : column + 20] = False
    return floor, floor, 0.15, 0.8, 0.5


def wings(rng: np.random.Generator) -> Made:
    """A corridor with uneven rooms, a middle with a niche or two, and the same corridor and rooms again."""
    depth, corridor = int(rng.integers(60, 100)), int(rng.integers(32, 48))
    sides = [side(rng.permutation(rng.integers(50, 120, int(rng.integers(4, 8)))), depth, rng) for _ in range(2)]
    length = min(part.shape[1] for part in sides)
    wing = np.vstack([sides[0][:, :length], np.zeros((corridor, length), bool), sides[1][::-1, :length]])
    other = {0: wing, 1: wing[::-1, ::-1], 2: wing[:, ::-1]}[int(rng.integers(3))]
    middle = np.ones((len(wing), int(rng.integers(120, 280))), bool)
    middle[depth : depth + corridor] = False
    for _ in range(int(rng.integers(1, 4))):
        column, width, deep = int(rng.integers(10, 80)), int(rng.integers(16, 40)), int(rng.integers(10, 50))
        rows = slice(depth - deep, depth) if rng.random() < 0.5 else slice(depth + corridor, depth + corridor + deep)
        middle[rows, column : column + width] = False
    floor = np.hstack([wing, middle, other])
    floor[:, :WALL_CELLS] = floor[:, -WALL_CELLS:] = True
    return floor, floor, 0.1, 1.0, 0.75


def side(widths: NDArray[np.int64], depth: int, rng: np.random.Generator) -> Mask:
    """Rooms of those widths in a row, each with a door somewhere in its lower wall."""
    rooms = []
    for width in widths.tolist():
        room = np.zeros((depth, width), bool)
        room[:WALL_CELLS] = room[-WALL_CELLS:] = room[:, :WALL_CELLS] = True
        at = int(rng.integers(6, width - 24))
        room[-WALL_CELLS:, at : at + 18] = False
        rooms.append(room)
    return np.hstack(rooms)


def clutter(solid: Mask, rng: np.random.Generator) -> Mask:
    """The floor with boxes and chairs on it, of which only legs are seen."""
    floor = solid.copy()
    free = np.argwhere(~solid)
    each_m2 = math.exp(rng.uniform(math.log(8), math.log(60)))
    for row, column in free[rng.integers(len(free), size=int(len(free) * CELL_M**2 / each_m2))]:
        if rng.random() < 0.5:
            height, width = rng.integers(4, 16, 2)
            floor[row : row + height, column : column + width] = True
        else:
            for y, x in ((0, 0), (0, 8), (8, 0), (8, 8)):
                floor[row + y : row + y + 1, column + x : column + x + 1] = True
    return floor


KINDS: dict[str, Callable[[np.random.Generator], Made]] = {
    "same": one(0.25, 1.0),
    "little": one(0.15, 0.25),
    "touching": one(0.0, 0.05),
    "apart": one(0.0, 0.0),
    "different": two,
    "mirrored": mirrored,
    "rooms": rooms,
    "corridor": corridor,
    "bent": one(0.25, 1.0),
    "visits": one(0.25, 1.0),
    "wings": wings,
}
WITHOUT_TRUTH = ("different", "mirrored")


def views(
    solid: Mask, other: Mask, low: float, high: float, rng: np.random.Generator, *, most: float
) -> tuple[Mask, Mask]:
    """What two robots have seen, with an overlap in those bounds; the nearest to it that was found."""
    best: tuple[float, Mask, Mask] | None = None
    for _ in range(TRIES):
        a, b = view(solid, rng, most), view(other, rng, most)
        if other is not solid:
            return with_walls(a, solid), with_walls(b, other)
        overlap = float((a & b).sum() / max(1, min(a.sum(), b.sum())))
        miss = max(low - overlap, overlap - high, 0.0)
        if best is None or miss < best[0]:
            best = miss, a, b
        if miss == 0:
            break
    assert best is not None
    return with_walls(best[1], solid), with_walls(best[2], other)


def view(solid: Mask, rng: np.random.Generator, most: float) -> Mask:
    """What is nearest to a random place by the way one can go, a tenth to ``most`` of the floor."""
    free = np.argwhere(~solid)
    row, column = free[rng.integers(len(free))]
    cost = cost_field((~solid).astype(np.uint8), int(row), int(column))
    reached = np.sort(cost[(cost < FAR) & ~solid])
    share = rng.uniform(0.1, most)
    return (cost <= reached[min(len(reached) - 1, int(share * len(free)))]) & ~solid & (cost < FAR)


def with_walls(near: Mask, solid: Mask) -> Mask:
    """What was seen of the floor, and the walls around it."""
    around: Mask = ndimage.maximum_filter(near, 2 * WALL_CELLS + 1)
    return near | (around & solid)


def random_pose(rng: np.random.Generator, shape: tuple[int, ...]) -> Pose2:
    """T_world_robot: somewhere on the floor, with any yaw."""
    height, width = shape
    return Pose2(rng.uniform(0, width) * CELL_M, rng.uniform(0, height) * CELL_M, rng.uniform(-math.pi, math.pi))


def sample(solid: Mask, seen: Mask, T_world_robot: Pose2, rng: np.random.Generator, *, bent: bool) -> OccupancyGrid:
    """What was seen, as a grid in the robot's frame."""
    rows, columns = np.nonzero(seen)
    corners = np.array([(columns.min(), rows.min()), (columns.max() + 1, rows.max() + 1)]) * CELL_M
    box = np.array([(x, y) for x in corners[:, 0] for y in corners[:, 1]])
    local = T_world_robot.inverse().apply(box)
    low, high = np.floor(local.min(axis=0) / CELL_M) - 8, np.ceil(local.max(axis=0) / CELL_M) + 8
    width, height = (high - low).astype(int)
    x, y = (low[:, None] + 0.5 + np.arange(max(width, height))) * CELL_M
    points = np.stack(np.meshgrid(x[:width], y[:height]), axis=-1)
    points = points + warp(height, width, rng)
    if bent:
        points = bend(points)
    world = T_world_robot.apply(points.reshape(-1, 2)).reshape(points.shape)
    cells = np.floor(world / CELL_M).astype(int)
    inside = (cells >= 0).all(axis=-1) & (cells[..., 0] < solid.shape[1]) & (cells[..., 1] < solid.shape[0])
    column, row = np.where(inside, cells[..., 0], 0), np.where(inside, cells[..., 1], 0)
    known = inside & seen[row, column]
    states = np.where(known, np.where(solid[row, column], OCCUPIED, FREE), UNKNOWN).astype(np.uint8)
    wall = states == OCCUPIED
    edge = (ndimage.binary_dilation(wall) & (states == FREE)) | (wall & ndimage.binary_dilation(states == FREE))
    flipped = edge & (rng.random(states.shape) < FLIPPED)
    states[flipped] = np.where(states[flipped] == FREE, OCCUPIED, FREE)
    return OccupancyGrid.from_states(states, CELL_M, Pose2(float(low[0]) * CELL_M, float(low[1]) * CELL_M))


def warp(height: int, width: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """(height, width, 2) metres: a smooth field."""
    step = WARP_OVER_M / CELL_M
    coarse = rng.normal(0.0, WARP_M, (2, int(height / step) + 3, int(width / step) + 3))
    where = np.stack(np.meshgrid(np.arange(height) / step, np.arange(width) / step, indexing="ij"))
    return np.stack([ndimage.map_coordinates(part, where, order=1) for part in coarse], axis=-1)


def bend(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """The same points as a robot has them whose heading drifts along x, and whose steps are too long."""
    x = points[..., 0] / (1 + STRETCH)
    y = points[..., 1] / (1 + STRETCH) + 0.5 * BEND_RAD_M * x * np.abs(x)
    return np.stack([x, y], axis=-1)


def draw(pair: Pair, path: Path) -> None:
    """Both grids side by side."""
    from PIL import Image

    tall = max(pair.a.height, pair.b.height)
    greys = [np.array([254, 0, 205], np.uint8)[grid.states_yx()] for grid in (pair.a, pair.b)]
    padded = [np.pad(grey, [(0, tall - len(grey)), (4, 4)], constant_values=120) for grey in greys]
    Image.fromarray(np.hstack(padded)[::-1]).save(path)


def main() -> None:
    """Make some, print and draw them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--each", type=int, default=3, help="pairs of each kind")
    parser.add_argument("--out", type=Path, help="where to draw; a new folder if there is none")
    parser.add_argument("--tiny", action="store_true", help="see that it runs")
    options = parser.parse_args()
    out = options.out or Path(tempfile.mkdtemp(prefix="buildings-"))
    out.mkdir(parents=True, exist_ok=True)
    for kind in KINDS:
        for seed in range(1 if options.tiny else options.each):
            pair = make_pair(kind, seed)
            draw(pair, out / f"{kind}-{seed}.png")
            print(f"{kind:10} {seed:3} overlap {100 * pair.overlap:3.0f} %  {pair.a.width} x {pair.a.height} cells")
    print(f"drawn in {out}")


if __name__ == "__main__":
    main()
