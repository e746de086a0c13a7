"""How often an aligner finds where one map lies in another, and how often wrongly.

On generated pairs of each kind (``buildings.py``), and with FLEETMAP_DATA on the partial maps whose transforms are
known. For each kind: outcomes; how many were committed wrongly (farther than 0.5 m off anywhere in what both have seen,
or with nothing in common), with the upper end of the 95 % interval; of those with an overlap of at least 25 and 15 %,
which share was committed, how far off these are at most (median, 95 %), and how many true errors lie within the stated
95 % ellipsoid; CPU time.

    python benchmarks/align.py [--each 100] [--first 0] [--kinds same,rooms] [--json]
"""

from __future__ import annotations

import argparse
import json
import math
import os
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from buildings import KINDS, Pair, make_pair

from fleetmap.align.align import align_walls
from fleetmap.align.protocol import Alignment
from fleetmap.align.walls import walls_of
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.kernel_cache import modules_of
from fleetmap.model.kernel_compiler import compile_ahead
from fleetmap.model.map_server import load_map
from fleetmap.model.pose import Pose2
from fleetmap.vectorize import vectorize

WRONG_M = 0.5
INSIDE_95 = 7.815
"""Of chi squared with three degrees of freedom."""
BANDS = ((0.25, 2.0), (0.15, 0.25))
REAL = {
    "gh25_ual": ("r1", "r2", "r3"),
    "malaga_telecom": ("r1", "r2"),
    "tuw_office": ("r1", "r2"),
    "duke_loop5": ("r1", "r2", "r3"),
    "uma_corridor": ("r1", "r2"),
}


def look(a: OccupancyGrid, b: OccupancyGrid) -> tuple[Alignment, float]:
    """The answer, and CPU seconds."""
    maps = vectorize(a), vectorize(b)
    began_s = time.process_time()
    found = align_walls(walls_of(maps[0]), walls_of(maps[1]))
    return found, time.process_time() - began_s


def off_m(found: Pose2, truth: Pose2, shared_xy: np.ndarray[Any, Any]) -> float:
    """How far the answer puts anything that both have seen from where it is."""
    return float(np.hypot(*(found.apply(shared_xy) - truth.apply(shared_xy)).T).max())


def inside(found: Alignment, truth: Pose2) -> bool:
    """Whether the true error lies within the stated ellipsoid."""
    assert found.T_a_b is not None
    there = found.T_a_b.inverse().apply(np.array(found.middle_xy))
    shift = truth.apply(there) - np.array(found.middle_xy)
    error = np.array([*shift, math.remainder(truth.yaw_rad - found.T_a_b.yaw_rad, math.tau)])
    return bool(error @ np.linalg.solve(np.array(found.covariance), error) < INSIDE_95)


def of_kind(kind: str, seeds: range) -> dict[str, Any]:
    """All pairs of a kind."""
    outcomes: Counter[str] = Counter()
    wrong, times, bands = [], [], {low: [] for low, _ in BANDS}
    for seed in seeds:
        pair = make_pair(kind, seed)
        found, took_s = look(pair.a, pair.b)
        outcomes[found.outcome] += 1
        times.append(took_s)
        committed, right = found.outcome == "committed", is_right(pair, found)
        if committed and not right:
            wrong.append(seed)
        for low, high in BANDS:
            if pair.T_a_b is not None and low <= pair.overlap < high:
                good = committed and right and found.T_a_b is not None
                off = off_m(found.T_a_b, pair.T_a_b, pair.shared_xy) if good and found.T_a_b else math.nan
                bands[low].append((good, off, good and inside(found, pair.T_a_b)))
    return {
        "pairs": len(seeds),
        "outcomes": dict(outcomes),
        "wrong": len(wrong),
        "wrong_at_most_95": round(1 - 0.05 ** (1 / len(seeds)), 4) if not wrong else None,
        "wrong_seeds": wrong,
        "overlap": {f"from {low:.0%}": band(rows) for low, rows in bands.items() if rows},
        "cpu_s": [round(float(np.percentile(times, share)), 3) for share in (50, 95)],
    }


def is_right(pair: Pair, found: Alignment) -> bool:
    """Whether a pose is the true one."""
    if found.T_a_b is None or pair.T_a_b is None or not len(pair.shared_xy):
        return False
    return off_m(found.T_a_b, pair.T_a_b, pair.shared_xy) <= WRONG_M


def band(rows: list[tuple[bool, float, bool]]) -> dict[str, Any]:
    """Of the pairs with so much overlap."""
    good = [off for done, off, _ in rows if done]
    return {
        "pairs": len(rows),
        "committed": round(len(good) / len(rows), 3),
        "off_m": [round(float(np.percentile(good, share)), 4) for share in (50, 95)] if good else None,
        "in_ellipsoid": round(sum(row[2] for row in rows) / len(good), 3) if good else None,
    }


def real(folder: Path) -> dict[str, Any]:
    """Partial maps of real drives."""
    found = {}
    for name, parts in REAL.items():
        told = json.loads((folder / "partial" / name / "transforms.json").read_text())
        places = {
            part["id"]: Pose2(*(part["T_full_from_slice"][k] for k in ("x", "y", "yaw_rad"))) for part in told["slices"]
        }
        bent_m = {part["id"]: part["fit_rms_m"] for part in told["slices"]}
        grids = {part: load_map(folder / "partial" / name / part / "map.yaml") for part in parts}
        for k, a in enumerate(parts):
            for b in parts[k + 1 :]:
                answer, took_s = look(grids[a], grids[b])
                truth = places[a].inverse() @ places[b]
                known = grids[b].states_yx() != 2
                rows, columns = np.nonzero(known)
                centres = np.stack([columns, rows], axis=-1)[:: max(1, len(rows) // 500)] + 0.5
                points = grids[b].origin.apply(centres * grids[b].resolution_m)
                found[f"{name} {a}-{b}"] = {
                    "outcome": answer.outcome,
                    "text": answer.text,
                    "off_m_over_b": None if answer.T_a_b is None else round(off_m(answer.T_a_b, truth, points), 3),
                    "bent_m": round(bent_m[a] + bent_m[b], 3),
                    "cpu_s": round(took_s, 2),
                }
    return found


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--each", type=int, default=100, help="pairs of each kind")
    parser.add_argument("--first", type=int, default=0, help="seed of the first one")
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--tiny", action="store_true", help="see that it runs")
    options = parser.parse_args()
    if options.tiny:
        options.each, options.kinds = 1, "same,different"
    compile_ahead(modules_of("model", "vectorize", "sims"))
    seeds = range(options.first, options.first + options.each)
    document: dict[str, Any] = {kind: of_kind(kind, seeds) for kind in options.kinds.split(",")}
    data = os.environ.get("FLEETMAP_DATA")
    if data and not options.tiny:
        document["real"] = real(Path(data))
    if options.json:
        print(json.dumps(document, indent=2))
        return
    for kind, figures in document.items():
        print(kind)
        for name, value in figures.items():
            print(f"  {name:22} {value}")


if __name__ == "__main__":
    main()
