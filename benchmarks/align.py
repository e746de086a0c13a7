"""How often an aligner finds where one map lies in another, and how often wrongly.

On generated pairs of each kind (``buildings.py``), and with FLEETMAP_DATA on the partial maps whose transforms are
known, and on all pairs of maps of different buildings. For each kind: outcomes; how many were committed wrongly
(farther than 0.5 m off anywhere in what both have seen, or with nothing in common), with the upper end of the 95 %
interval; of those with an overlap of at least 25 and 15 %, which share was committed, how far off these are at most
(median, 95 %), and how many true errors lie within the stated 95 % ellipsoid; CPU time, also of looking at a place
again; and how much wall is doubled when both are merged.

    python benchmarks/align.py [--each 100] [--first 0] [--kinds same,rooms] [--state FILE] [--jobs 2] [--json]
    python benchmarks/align.py --rivals --each 20      beside OpenCV's features and a correlative matcher

With ``--state`` each pair is written down when it is done, and what is there isn't done again.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import math
import multiprocessing
import os
import resource
import time
from collections import Counter
from collections.abc import Callable, Iterable
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from buildings import KINDS, Pair, make_pair
from scipy.spatial import cKDTree

from fleetmap.align.align import align_walls, check
from fleetmap.align.protocol import Alignment
from fleetmap.align.walls import sampled, walls_of
from fleetmap.merge import fold
from fleetmap.merge.protocol import Source
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.kernel_cache import modules_of
from fleetmap.model.kernel_compiler import compile_ahead
from fleetmap.model.lattice import FREE, UNKNOWN
from fleetmap.model.map_server import load_map
from fleetmap.model.pose import FixedPose, Pose2
from fleetmap.model.vectormap import VectorMap
from fleetmap.vectorize import vectorize

WRONG_M = 0.5
INSIDE_95 = 7.815
"""Of chi squared with three degrees of freedom."""
DOUBLED_M = 0.05, 0.3
LEFT = 4
"""The column of a merged map's edges that has the state on their left."""
BANDS = ((0.25, 2.0), (0.15, 0.25))
REAL = {
    "gh25_ual": ("r1", "r2", "r3"),
    "malaga_telecom": ("r1", "r2"),
    "tuw_office": ("r1", "r2"),
    "duke_loop5": ("r1", "r2", "r3"),
    "uma_corridor": ("r1", "r2"),
    "fetch_office_sessions": ("r1", "r2", "r3"),
    "willow_sessions": ("r1", "r2"),
}


def look(a: OccupancyGrid, b: OccupancyGrid) -> tuple[Alignment, float]:
    """The answer, and CPU seconds."""
    return look_at(vectorize(a), vectorize(b))


def look_at(a: VectorMap, b: VectorMap) -> tuple[Alignment, float]:
    """The same of vector maps."""
    began_s = time.process_time()
    found = align_walls(walls_of(a), walls_of(b))
    return found, time.process_time() - began_s


def doubled(maps: tuple[VectorMap, VectorMap], T_a_b: Pose2) -> float:
    """Which share of the walls of both maps merged has another one that faces alike 5 to 30 cm beside it."""
    poses = (Pose2(), T_a_b)
    merged = fold(Source((str(k), 1, "0"), FixedPose.from_pose(poses[k]), maps[k]) for k in range(2))
    segments = merged.segments_xy[merged.obstacle]
    free_left = merged.edges[merged.obstacle, LEFT] == FREE
    points, normals, lengths, edge = sampled(segments, free_left)
    tree, beside = cKDTree(points), np.zeros(len(points), bool)
    for k, near in enumerate(tree.query_ball_point(points, DOUBLED_M[1])):
        others = [i for i in near if edge[i] != edge[k] and normals[i] @ normals[k] > 0.94]
        across = np.abs((points[others] - points[k]) @ normals[k])
        beside[k] = bool((across > DOUBLED_M[0]).any())
    return float(lengths[beside].sum() / lengths.sum())


def off_m(found: Pose2, truth: Pose2, shared_xy: np.ndarray[Any, Any]) -> float:
    """How far the answer puts anything that both have seen from where it is."""
    return float(np.hypot(*(found.apply(shared_xy) - truth.apply(shared_xy)).T).max())


def is_right(pair: Pair, found: Pose2 | None) -> bool:
    """Whether a pose is the true one."""
    if found is None or pair.T_a_b is None or not len(pair.shared_xy):
        return False
    return off_m(found, pair.T_a_b, pair.shared_xy) <= WRONG_M


def inside(found: Alignment, truth: Pose2) -> bool:
    """Whether the true error lies within the stated ellipsoid."""
    assert found.T_a_b is not None
    there = found.T_a_b.inverse().apply(np.array(found.middle_xy))
    shift = truth.apply(there) - np.array(found.middle_xy)
    error = np.array([*shift, math.remainder(truth.yaw_rad - found.T_a_b.yaw_rad, math.tau)])
    return bool(error @ np.linalg.solve(np.array(found.covariance), error) < INSIDE_95)


def try_pair(task: tuple[str, int]) -> dict[str, Any]:
    """One generated pair."""
    pair = make_pair(*task)
    maps = vectorize(pair.a), vectorize(pair.b)
    found, took_s = look_at(*maps)
    right = is_right(pair, found.T_a_b)
    row: dict[str, Any] = {
        "kind": pair.kind,
        "seed": pair.seed,
        "overlap": round(pair.overlap, 4),
        "outcome": found.outcome,
        "right": right,
        "cpu_s": round(took_s, 4),
        "edges": max(map(len, maps)),
        "evidence": vars_of(found.evidence),
        "second": vars_of(found.second),
    }
    if found.outcome == "committed" and right and found.T_a_b is not None and pair.T_a_b is not None:
        row["off_m"] = round(off_m(found.T_a_b, pair.T_a_b, pair.shared_xy), 5)
        row["in_ellipsoid"] = inside(found, pair.T_a_b)
        began_s = time.process_time()
        check(walls_of(maps[0]), walls_of(maps[1]), found.T_a_b)
        row["check_s"] = round(time.process_time() - began_s, 4)
        row["doubled"] = [round(doubled(maps, pose), 4) for pose in (found.T_a_b, pair.T_a_b)]
    return row


def vars_of(evidence: Any) -> dict[str, float] | None:
    """The numbers of what speaks for a pose."""
    if evidence is None:
        return None
    values = {name: float(getattr(evidence, name)) for name in evidence.__slots__}
    return {name: round(value, 4) for name, value in values.items() if math.isfinite(value)}


def try_pairs(tasks: list[tuple[str, int]], *, state: Path | None, jobs: int) -> list[dict[str, Any]]:
    """All of them, in several processes; what the state file has already isn't done again."""
    rows = [json.loads(line) for line in state.read_text().splitlines()] if state and state.exists() else []
    done = {(row["kind"], row["seed"]) for row in rows}
    wanted = set(tasks)
    rows = [row for row in rows if (row["kind"], row["seed"]) in wanted]
    left = [task for task in tasks if task not in done]
    with multiprocessing.get_context("spawn").Pool(jobs) as pool:
        for row in pool.imap_unordered(try_pair, left):
            rows.append(row)
            if state:
                with state.open("a") as file:
                    file.write(json.dumps(row) + "\n")
    return sorted(rows, key=lambda row: (row["kind"], row["seed"]))


def of_kind(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """What came of all pairs of a kind."""
    committed = [row for row in rows if row["outcome"] == "committed"]
    wrong = [row["seed"] for row in committed if not row["right"]]
    bands = {f"from {low:.0%}": band([row for row in rows if low <= row["overlap"] < high]) for low, high in BANDS}
    return {
        "pairs": len(rows),
        "outcomes": dict(Counter(row["outcome"] for row in rows)),
        "wrong": len(wrong),
        "wrong_at_most_95": at_most(len(wrong), len(rows)),
        "wrong_seeds": wrong,
        "overlap": {name: figures for name, figures in bands.items() if figures["pairs"]},
        "cpu_s": percentiles([row["cpu_s"] for row in rows]),
        "check_s": percentiles([row["check_s"] for row in rows if "check_s" in row]),
        "doubled, at the place found and at the true one": [
            percentiles([row["doubled"][k] for row in rows if "doubled" in row]) for k in (0, 1)
        ],
    }


def at_most(wrong: int, pairs: int) -> float:
    """The upper end of the 95 % interval of a share (Clopper and Pearson; one-sided where nothing was wrong)."""
    from scipy.stats import beta

    return round(float(beta.ppf(0.95 if wrong == 0 else 0.975, wrong + 1, pairs - wrong)), 6) if pairs > wrong else 1.0


def band(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Of the pairs with so much overlap."""
    good = [row for row in rows if "off_m" in row]
    return {
        "pairs": len(rows),
        "committed": round(len(good) / len(rows), 3) if rows else None,
        "off_m": percentiles([row["off_m"] for row in good]) if good else None,
        "in_ellipsoid": round(sum(row["in_ellipsoid"] for row in good) / len(good), 3) if good else None,
    }


def percentiles(values: Iterable[float]) -> list[float]:
    """The median, and what 95 % stay below; nothing of nothing."""
    these = list(values)
    return [round(float(np.percentile(these, share)), 4) for share in (50, 95)] if these else []


def real_pairs(folder: Path) -> dict[str, tuple[OccupancyGrid, OccupancyGrid, Pose2, float]]:
    """Partial maps of real drives: both grids, T_a_b, and how much both are bent, in metres."""
    found = {}
    for name, parts in REAL.items():
        told = json.loads((folder / "partial" / name / "transforms.json").read_text())
        if "slices" in told:
            of = {part["id"]: part for part in told["slices"]}
            places = {k: Pose2(*(of[k]["T_full_from_slice"][v] for v in ("x", "y", "yaw_rad"))) for k in parts}
            grids = {k: load_map(folder / "partial" / name / k / "map.yaml") for k in parts}
            for a, b in combinations(parts, 2):
                bent_m = of[a]["fit_rms_m"] + of[b]["fit_rms_m"]
                found[f"{name} {a}-{b}"] = grids[a], grids[b], places[a].inverse() @ places[b], bent_m
        else:
            paths = {part["id"]: folder / "partial" / name / part["map"] for part in told["maps"]}
            grids = {k: load_map(path) for k, path in paths.items()}
            for pair in told["pairs"]:
                truth = Pose2(*(pair["T_a_from_b"][v] for v in ("x", "y", "yaw_rad")))
                found[f"{name} {pair['a']}-{pair['b']}"] = grids[pair["a"]], grids[pair["b"]], truth, pair["rms_m"]
    return found


def real(folder: Path) -> dict[str, Any]:
    """What came of partial maps of real drives."""
    found = {}
    for name, (a, b, truth, bent_m) in real_pairs(folder).items():
        answer, took_s = look(a, b)
        found[name] = {
            "outcome": answer.outcome,
            "text": answer.text,
            "off_m": None if answer.T_a_b is None else round(off_m(answer.T_a_b, truth, shared_xy(a, b, truth)), 3),
            "off_m_over_b": None if answer.T_a_b is None else round(off_m(answer.T_a_b, truth, known_xy(b)), 3),
            "bent_m": round(bent_m, 3),
            "cpu_s": round(took_s, 2),
            "evidence": vars_of(answer.evidence),
            "second": vars_of(answer.second),
        }
    return found


def known_xy(grid: OccupancyGrid) -> np.ndarray[Any, Any]:
    """(n, 2) metres: some places that a map knows."""
    rows, columns = np.nonzero(grid.states_yx() != UNKNOWN)
    centres = np.stack([columns, rows], axis=-1)[:: max(1, len(rows) // 500)] + 0.5
    return grid.origin.apply(centres * grid.resolution_m)


def shared_xy(a: OccupancyGrid, b: OccupancyGrid, T_a_b: Pose2) -> np.ndarray[Any, Any]:
    """(n, 2) metres in b: some places that both maps know."""
    points = known_xy(b)
    cells = np.floor(a.origin.inverse().apply(T_a_b.apply(points)) / a.resolution_m).astype(int)
    inside = ((cells >= 0) & (cells < (a.width, a.height))).all(axis=1)
    both = inside.copy()
    both[inside] = a.states_yx()[cells[inside, 1], cells[inside, 0]] != UNKNOWN
    return points[both]


def different_buildings(folder: Path) -> dict[str, Any]:
    """All pairs of real maps of different buildings: a committed one is wrong."""
    maps = {path.name: path / "map.yaml" for path in sorted((folder / "maps").iterdir())}
    buildings: dict[str, str] = {}
    for name in maps:
        buildings[name] = name.removesuffix("_005").removesuffix("_010").split("_20")[0]
    walls = {name: walls_of(vectorize(load_map(path))) for name, path in maps.items()}
    outcomes: Counter[str] = Counter()
    wrong, times = [], []
    for a, b in combinations(maps, 2):
        if buildings[a] == buildings[b]:
            continue
        began_s = time.process_time()
        found = align_walls(walls[a], walls[b])
        times.append(time.process_time() - began_s)
        outcomes[found.outcome] += 1
        if found.outcome == "committed":
            wrong.append((a, b, found.text))
    return {
        "pairs": len(times),
        "outcomes": dict(outcomes),
        "wrong": wrong,
        "wrong_at_most_95": at_most(len(wrong), len(times)),
        "cpu_s": percentiles(times),
    }


def beside_rivals(kinds: Iterable[str], seeds: range, folder: Path | None) -> dict[str, Any]:
    """The same pairs for ours and the others, in turn: accepted and right, accepted and wrong, error, CPU seconds."""
    import align_rivals

    ways: dict[str, Any] = {
        "fleetmap": lambda a, b: look(a, b)[0],
        "AKAZE, as multirobot_map_merge": align_rivals.features,
        "AKAZE, confidence 0.3": lambda a, b: align_rivals.features(a, b, confidence=0.3, greys="file"),
        "correlative": align_rivals.correlative,
    }
    if importlib.util.find_spec("cv2") is None:
        ways = {name: way for name, way in ways.items() if "AKAZE" not in name}
    groups: dict[str, list[tuple[OccupancyGrid, OccupancyGrid, Callable[[Pose2], float | None]]]] = {}
    for kind in kinds:
        pairs = [make_pair(kind, seed) for seed in seeds]
        groups[kind] = [(pair.a, pair.b, partial(off_if_right, pair)) for pair in pairs]
    if folder:
        groups["real"] = [
            (a, b, partial(off_over_b, b, truth, WRONG_M + bent_m))
            for a, b, truth, bent_m in real_pairs(folder).values()
        ]
    table: dict[str, Any] = {}
    for group, pairs in groups.items():
        table[group] = {name: {"right": 0, "wrong": 0, "off_m": [], "cpu_s": []} for name in ways}
        for a, b, right in pairs:
            for name, way in ways.items():
                row = table[group][name]
                began_s = time.process_time()
                found = way(a, b)
                row["cpu_s"].append(time.process_time() - began_s)
                accepted = found.outcome == "committed" if isinstance(found, Alignment) else found.accepted
                if accepted:
                    off = right(found.T_a_b)
                    row["wrong" if off is None else "right"] += 1
                    row["off_m"] += [] if off is None else [off]
        for row in table[group].values():
            row["pairs"] = len(pairs)
            row["off_m"], row["cpu_s"] = percentiles(row["off_m"]) if row["off_m"] else None, percentiles(row["cpu_s"])
    return table


def off_if_right(pair: Pair, pose: Pose2) -> float | None:
    """How far off a right pose is; None if it is wrong."""
    return off_m(pose, pair.T_a_b, pair.shared_xy) if is_right(pair, pose) and pair.T_a_b is not None else None


def off_over_b(b: OccupancyGrid, truth: Pose2, most_m: float, pose: Pose2) -> float | None:
    """How far off a pose of a real map is, anywhere in it; None if that is too far."""
    off = off_m(pose, truth, known_xy(b))
    return off if off <= most_m else None


def show(document: dict[str, Any]) -> None:
    """Print it for people."""
    for part, figures in document.items():
        print(part)
        for name, value in figures.items() if isinstance(figures, dict) else [("", figures)]:
            print(f"  {name:30} {value}")


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--each", type=int, default=100, help="pairs of each kind")
    parser.add_argument("--first", type=int, default=0, help="seed of the first one")
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--state", type=Path, help="where what is done is written down")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes")
    parser.add_argument("--rivals", action="store_true", help="beside other ways, one process, pairs in turn")
    parser.add_argument("--real", action="store_true", help="the real maps alone")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--tiny", action="store_true", help="see that it runs")
    options = parser.parse_args()
    if options.tiny:
        options.each, options.kinds, options.jobs = 1, "same,different", 1
    compile_ahead(modules_of("model", "vectorize", "align", "merge", "sims"))
    seeds = range(options.first, options.first + options.each)
    kinds = options.kinds.split(",")
    data = None if options.tiny else os.environ.get("FLEETMAP_DATA")
    document: dict[str, Any] = {}
    if options.rivals:
        document = beside_rivals(kinds, seeds, Path(data) if data else None)
    else:
        if not options.real:
            tasks = [(kind, seed) for seed in seeds for kind in kinds]
            rows = try_pairs(tasks, state=options.state, jobs=options.jobs)
            document = {kind: of_kind([row for row in rows if row["kind"] == kind]) for kind in kinds}
            document["all"] = of_kind(rows)
        if data:
            document["real"] = real(Path(data))
            document["different buildings"] = different_buildings(Path(data))
    document["memory"] = {"peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024}
    if options.json:
        print(json.dumps(document, indent=2))
    else:
        show(document)


if __name__ == "__main__":
    main()
