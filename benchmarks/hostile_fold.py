"""What one name, six or sixty may cost the fold: honest fleets, and maps drawn to hold up all others.

1. Honest fleets: how much of the fold's room (``merge.afford``) they take, and whether anything is left out. Eight
   robots, or as many as said, hold all of a real map each, with start poses off by up to 4 cm and 0.1 degrees; without
   FLEETMAP_DATA generated offices.
2. Beside four robots in an office, six names (sixty with --names 60) that each say as much as one name may
   (``model.density``), in shapes that cross, lie dense, long, in rows or far apart.

CPU seconds of the first fold and of the next one (when the weights of maps are known), the most memory that the first
takes, and which sources are left out. "same" says that the bytes are those of the honest maps alone.

    python benchmarks/hostile_fold.py [--names 6] [--edges 48000] [--shapes combs ...] [--json]
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fleetmap.merge import afford, fold
from fleetmap.merge.protocol import Source
from fleetmap.model.density import check_density
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import FREE, OCCUPIED, Lattice
from fleetmap.model.map_server import load_map
from fleetmap.model.pose import FixedPose, Pose2
from fleetmap.model.vectormap import VectorMap, make_label
from fleetmap.sims import world_office
from fleetmap.vectorize import vectorize

Ints = NDArray[np.int64]


def polygons(points: Ints, *, resolution_um: int = 50_000) -> VectorMap:
    """(k, m, 2) corners (x, y) of k polygons, each turned counter-clockwise: free inside, walls around."""
    x, y = points[..., 0], points[..., 1]
    area = (x * np.roll(y, -1, 1) - y * np.roll(x, -1, 1)).sum(axis=1)
    points = np.where((area < 0)[:, None, None], points[:, ::-1], points)[area != 0]
    a = points[..., ::-1].reshape(-1, 2)
    b = np.roll(points, -1, 1)[..., ::-1].reshape(-1, 2)
    a, b = a[(a != b).any(axis=1)], b[(a != b).any(axis=1)]
    down = (a[:, 0] > b[:, 0]) | ((a[:, 0] == b[:, 0]) & (a[:, 1] > b[:, 1]))
    label = np.where(down, make_label(OCCUPIED, FREE), make_label(FREE, OCCUPIED))
    rows = np.column_stack([np.where(down[:, None], b, a), np.where(down[:, None], a, b), label])
    return VectorMap(Lattice(resolution_um), rows.astype(np.int32), np.full(len(rows), 4, np.uint8))


def rectangles(x: Ints, y: Ints, width: int, height: int) -> Ints:
    """(k, 4, 2) corners."""
    corners = [(x, y), (x + width, y), (x + width, y + height), (x, y + height)]
    return np.stack([np.stack(corner, axis=-1) for corner in corners], axis=1)


def strips(edges: int, *, pitch: int, length: int, upright: bool, resolution_um: int = 50_000) -> VectorMap:
    """Blocks of strips, a cell wide."""
    across = max(1, length // pitch)
    block, i = np.divmod(np.arange(max(1, edges // 4)), across)
    side = math.ceil(math.sqrt(block[-1] + 1))
    x, y = block % side * (length + 4), block // side * (across * pitch + 4) + i * pitch
    corners = rectangles(x, y, length, 1)
    return polygons(corners[..., ::-1] if upright else corners, resolution_um=resolution_um)


def rooms(edges: int, *, pitch: int, columns: int, resolution_um: int = 50_000) -> VectorMap:
    """Rooms of one cell."""
    y, x = np.divmod(np.arange(max(1, edges // 4)), columns)
    return polygons(rectangles(x * pitch, y * pitch, 1, 1), resolution_um=resolution_um)


def dashed(edges: int, strips: int) -> VectorMap:
    """Strips whose long sides are edges of one cell."""
    n = max(1, edges // (2 * strips))
    there = np.stack([np.arange(n), np.zeros(n, np.int64)], axis=-1)
    back = np.stack([n - np.arange(n), np.ones(n, np.int64)], axis=-1)
    one = np.concatenate([there, back])
    return polygons(np.stack([one + np.array([0, 2 * k]) for k in range(strips)]))


def star(edges: int, seed: int) -> VectorMap:
    """Long thin triangles around one point."""
    angle = np.random.default_rng(seed).uniform(0, 2 * np.pi, edges // 3)
    along = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    across = 2 * along[:, ::-1] * (1, -1)
    corners = np.stack([2000 * along, across - 2000 * along, -across - 2000 * along], axis=1)
    return polygons(corners.round().astype(np.int64))


def triangles(edges: int, seed: int, reach: int = 1000, resolution_um: int = 50_000) -> VectorMap:
    """Triangles between random points."""
    corners = np.random.default_rng(seed).integers(0, reach, (edges // 3, 3, 2))
    return polygons(corners, resolution_um=resolution_um)


def grating(edges: int) -> VectorMap:
    """Strips along and across, in one map."""
    k = np.arange(max(1, edges // 8)) * 4
    zero = np.zeros_like(k)
    return polygons(np.concatenate([rectangles(k, zero, 1, 1000), rectangles(zero, k, 1000, 1)]))


def spiral(edges: int) -> VectorMap:
    """A corridor that winds around itself."""
    turns = max(1, edges // 8)
    reach = 4 * (np.arange(turns) + 1)
    corners = [(-reach, -reach), (reach, -reach), (reach, reach), (-reach - 4, reach)]
    outer = np.stack([np.stack(corner, axis=-1) for corner in corners], axis=1).reshape(-1, 2)
    inner = outer - np.sign(outer)
    return polygons(np.concatenate([outer, inner[::-1]])[None])


def salt(edges: int, seed: int) -> VectorMap:
    """4 % of all cells of an empty hall."""
    side = max(8, math.isqrt(round(edges / 0.14)))
    states = np.random.default_rng(seed).random((side, side)) < 0.04
    return vectorize(OccupancyGrid.from_states(states.astype(np.uint8), 0.05))


SHAPES: dict[str, Callable[[int, int], VectorMap]] = {
    "combs": lambda n, i: strips(n, pitch=2, length=n // 2, upright=i % 2 == 1),
    "parallel combs": lambda n, _: strips(n, pitch=2, length=n // 2, upright=False),
    "short combs": lambda n, i: strips(n, pitch=2, length=100, upright=i % 2 == 1),
    "wide combs": lambda n, i: strips(n, pitch=8, length=100, upright=i % 2 == 1),
    "wider combs": lambda n, i: strips(n, pitch=20, length=20, upright=i % 2 == 1),
    "combs of 1 cm": lambda n, i: strips(n, pitch=10, length=100, upright=i % 2 == 1, resolution_um=10_000),
    "needles": lambda n, i: strips(n, pitch=2, length=6500, upright=i % 2 == 1),
    "triangles": triangles,
    "triangles of 500 m": lambda n, i: triangles(n, i, 500, 10_000_000),
    "star": star,
    "grating": lambda n, _: grating(n),
    "spiral": lambda n, _: spiral(n),
    "salt": salt,
    "rooms": lambda n, _: rooms(n, pitch=6, columns=max(1, math.isqrt(n // 4))),
    "rooms in a row": lambda n, _: rooms(n, pitch=2, columns=n),
    "rooms in a column": lambda n, _: rooms(n, pitch=2, columns=1),
    "rooms of 0.1 mm": lambda n, _: rooms(n, pitch=2, columns=max(1, math.isqrt(n // 4)), resolution_um=100),
    "rooms of 5 mm": lambda n, _: rooms(n, pitch=6, columns=max(1, math.isqrt(n // 4)), resolution_um=5_000),
    "rooms of 10 m": lambda n, _: rooms(min(n, 40_000), pitch=6, columns=80, resolution_um=10_000_000),
    "dashed line": lambda n, _: dashed(n, 1),
    "dashed lines": lambda n, _: dashed(n, 8),
}
"""By name: the map of the i-th name, of about n edges."""


def hostile(shape: str, *, names: int, edges: int) -> list[Source]:
    """One map a name, each a little beside the others."""
    sources = []
    for i in range(names):
        vector_map = SHAPES[shape](edges, i)
        turn = 0.2 * i if "rooms" in shape else 0.0
        pose = FixedPose.from_pose(Pose2(0.013 * i, 0.021 * i, turn))
        sources.append(Source((f"x{i:02}", 1, "0"), pose, vector_map))
    return sources


def honest(vector_map: VectorMap, *, robots: int, seed: int = 0, name: str = "h") -> list[Source]:
    """Each robot holds all of a map; their starts are off by 4 cm and 0.1 degrees at most."""
    rng = np.random.default_rng(seed)
    poses = [Pose2(*rng.uniform(-0.04, 0.04, 2), rng.uniform(-0.002, 0.002)) for _ in range(robots)]
    return [Source((f"{name}{i}", 1, "0"), FixedPose.from_pose(pose), vector_map) for i, pose in enumerate(poses)]


def office(size_m: float, seed: int = 1) -> VectorMap:
    """A generated office, as a robot would have it."""
    solid = world_office.generate(size_m, np.random.default_rng(seed))
    return vectorize(OccupancyGrid.from_states(np.where(solid, OCCUPIED, FREE).astype(np.uint8), 0.05))


def real_maps(profile: str) -> dict[str, VectorMap]:
    """The maps of FLEETMAP_DATA by name; none without it."""
    paths = sorted(Path(os.environ.get("FLEETMAP_DATA", "/nowhere")).glob("maps/*/map.yaml"))
    return {f"{path.parent.name}, {profile}": vectorize(load_map(path), profile=profile) for path in paths}


def room_taken(sources: list[Source]) -> float:
    """Which share of its room the fold of these takes."""
    choice = afford.choose(afford.weighed(sources)[0])
    return choice.spent / choice.room


def timed(sources: list[Source]) -> tuple[float, Any]:
    """CPU seconds of a fold, and its map."""
    began_s = time.process_time()
    merged = fold(sources)
    return time.process_time() - began_s, merged


def most_memory_mb() -> float | None:
    """The most memory this process had since the last call, in MB; None where Linux's counters aren't."""
    try:
        status = Path("/proc/self/status").read_text()
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return None
    return next(int(line.split()[1]) / 1e3 for line in status.splitlines() if line.startswith("VmHWM"))


def measure_honest(name: str, sources: list[Source]) -> dict[str, Any]:
    """A row of the first table."""
    seconds, merged = timed(sources)
    edges = sum(len(source.vector_map) for source in sources)
    row = {"fleet": name, "sources": len(sources), "edges": edges, "room": room_taken(sources), "fold_s": seconds}
    return {**row, "merged": len(merged), "left_out": len(merged.left_out)}


def measure_hostile(shape: str, good: list[Source], *, names: int, edges: int) -> dict[str, Any]:
    """A row of the second table."""
    bad = hostile(shape, names=names, edges=edges)
    alone_s, alone = timed(good)
    most_memory_mb()
    before_mb = most_memory_mb()
    first_s, merged = timed([*good, *bad])
    after_mb = most_memory_mb()
    again_s, _ = timed([*good, *bad])
    out = {frame[0] for frame, _ in merged.left_out}
    return {
        "shape": shape,
        "edges": sum(len(source.vector_map) for source in bad),
        "refused": bad and check_density(bad[0].vector_map),
        "alone_s": alone_s,
        "first_s": first_s,
        "again_s": again_s,
        "memory_mb": after_mb - before_mb if after_mb is not None and before_mb is not None else None,
        "honest_out": sum(source.frame[0] in out for source in good),
        "hostile_out": sum(source.frame[0] in out for source in bad),
        "same": replace(merged, left_out=()).to_bytes() == alone.to_bytes(),
        "reasons": sorted({reason for frame, reason in merged.left_out if frame[0].startswith("x")}),
    }


def show(row: dict[str, Any]) -> None:
    """A line of either table."""
    if "fleet" in row:
        print(
            f"{row['fleet']:<34} {row['sources']:>4} sources {row['edges']:>7} edges: {row['room']:>5.0%} of the room, "
            f"{row['fold_s']:6.2f} s, {row['merged']:>6} merged, {row['left_out']} left out",
            flush=True,
        )
        return
    memory = "" if row["memory_mb"] is None else f", {row['memory_mb']:+5.0f} MB"
    print(
        f"{row['shape']:<20} {row['edges']:>7} edges: {row['alone_s']:.3f} s alone, {row['first_s']:6.3f} s, again "
        f"{row['again_s']:6.3f} s{memory}; left out: {row['honest_out']} honest, {row['hostile_out']} others"
        f"{', same' if row['same'] else ''}{' (refused before: ' + row['refused'] + ')' if row['refused'] else ''}",
        flush=True,
    )


def main() -> None:
    """Measure, and print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--names", type=int, default=6)
    parser.add_argument("--edges", type=int, default=48_000, help="of each name's map")
    parser.add_argument("--shapes", nargs="+", default=list(SHAPES), choices=list(SHAPES))
    parser.add_argument("--robots", type=int, default=8, help="of the honest fleets")
    parser.add_argument("--hostile-only", action="store_true", help="leave the first table out")
    parser.add_argument("--tiny", action="store_true", help="a few edges, to see that it runs")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    if options.tiny:
        options.names, options.edges, options.shapes, options.robots = 2, 400, ["combs", "rooms", "star"], 2
    rows: list[dict[str, Any]] = []

    def add(row: dict[str, Any]) -> None:
        rows.append(row)
        if not options.json:
            show(row)

    good = honest(office(12.0 if options.tiny else 40.0), robots=4)
    timed(good)  # kernels are loaded
    if not options.hostile_only:
        add(measure_honest("generated office", honest(office(12.0 if options.tiny else 40.0), robots=options.robots)))
    if not options.tiny and not options.hostile_only:
        share, full = real_maps("share"), real_maps("full")
        for name, vector_map in {**share, **full}.items():
            add(measure_honest(name, honest(vector_map, robots=options.robots)))
        if share:
            # All places side by side, 200 m apart: each robot says each of them as a submap.
            fleet = []
            for k, vector_map in enumerate(share.values()):
                for source in honest(vector_map, robots=options.robots, seed=k):
                    away = FixedPose.from_pose(Pose2(200.0 * (k % 5), 200.0 * (k // 5))) @ source.T_fleet_frame
                    fleet.append(Source((source.frame[0], 1, str(k)), away, vector_map))
            add(measure_honest("all of them, share", fleet))
            largest = max(share, key=lambda name: len(share[name]))
            add(measure_honest(f"{largest}, thirty robots", honest(share[largest], robots=30)))
    for shape in options.shapes:
        add(measure_hostile(shape, good, names=options.names, edges=options.edges))
    if options.json:
        json.dump(rows, sys.stdout, indent=1)


if __name__ == "__main__":
    main()
