"""What a simulated fleet sends, over several seeds: README's table, with spread.

Runs ``fleetmap sim`` for each world and seed, one after the other, into FOLDER/WORLD-SEED; a folder that holds a run
already is only read. Then two rows a world: median, and in brackets least and most, over the seeds.

- payload: what was handed to the transport, to one receiver; of grids the grids alone
- wire: the same on an IP link over the simulated time; both sides carry poses, goals, heartbeats and keep-alives
- whole grids, rectangles, differences: how many times as much these would have been
- B/m², B/s and robot: by floor explored, and by simulated seconds of all robots
- wall error: distances between true walls and merged ones

    python benchmarks/runs.py [FOLDER] [--worlds office maze unstructured] [--seeds 1 2 3 4 5] [--json]

With ``--starts unknown`` robots start anywhere and find each other; in ``--json`` ``together_s`` says when they had,
and ``misplaced_cm`` how far off a robot ever was in its own merged map.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

WORLDS = ("office", "maze", "unstructured")
SEEDS = (1, 2, 3, 4, 5)


def run(folder: Path, world: str, seed: int, *, robots: int, size_m: float, starts: str) -> dict[str, Any]:
    """The document of one run; it is made if it isn't there."""
    name = Path(world).parent.name if world.endswith(".yaml") else world
    path = folder / f"{name}-{seed}{'' if starts == 'known' else f'-{starts}'}" / "stats.json"
    if not path.exists():
        command = [sys.executable, "-m", "fleetmap", "sim", "--robots", robots, "--world", world, "--size", size_m]
        command += ["--seed", seed, "--listen", "tcp/127.0.0.1:0", "--out", path.parent, "--starts", starts]
        done = subprocess.run([str(part) for part in command], capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise SystemExit(f"{world}, seed {seed}: {done.stderr}")
    document: dict[str, Any] = json.loads(path.read_text())
    return document


def spread(values: list[float]) -> dict[str, float]:
    """Median, least and most."""
    return {"median": statistics.median(values), "least": min(values), "most": max(values)}


def summarize(documents: list[dict[str, Any]]) -> dict[str, Any]:
    """All figures of a world."""
    keys = ["bytes_vector", "ratio_full", "ratio_updates", "ratio_exact", "bytes_per_m2", "bytes_per_s_robot"]
    pick: dict[str, Callable[[dict[str, Any]], float]] = {
        **{key: lambda d, k=key: d[k] for key in (*keys, *(f"wire_{key}" for key in keys))},
        "duration_s": lambda d: d["duration_s"],
        "simulated_s": lambda d: d["simulated_s"],
        "covered": lambda d: d["covered"],
        "collisions": lambda d: d["collisions"],
        "components": lambda d: d["components"],
        "together_s": lambda d: d["simulated_s"] if d["together_s"] is None else d["together_s"],
        "misplaced_cm": lambda d: 100 * d["misplaced_m"],
        "error_median_cm": lambda d: 100 * d["merged_error_m"]["median"],
        "error_p95_cm": lambda d: 100 * d["merged_error_m"]["p95"],
    }
    return {
        "runs": len(documents),
        "converged": sum(d["converged"] for d in documents),
        **{key: spread([float(of(d)) for d in documents]) for key, of in pick.items()},
    }


def shown(value: dict[str, float], form: str, factor: float = 1.0) -> str:
    """Median, and from the least to the most."""
    middle, least, most = (format(factor * value[key], form) for key in ("median", "least", "most"))
    return middle if least == most else f"{middle} ({least} to {most})"


def table(worlds: dict[str, dict[str, Any]]) -> str:
    """README's table, as Markdown."""
    columns = ("world", "", "sent, kB", "whole grids", "rectangles", "differences", "B/m²", "B/s and robot")
    lines = ["| " + " | ".join((*columns, "wall error, cm: median, 95 %")) + " |", "|" + "---|" * (len(columns) + 1)]
    for world, found in worlds.items():
        error = f"{shown(found['error_median_cm'], '.1f')}, {shown(found['error_p95_cm'], '.1f')}"
        for name, what, prefix, last in ((world, "payload", "", error), ("", "wire", "wire_", "")):
            cells = [
                shown(found[f"{prefix}bytes_vector"], ".0f", 1e-3),
                *(f"{shown(found[f'{prefix}ratio_{short}'], '.1f')} x" for short in ("full", "updates")),
                f"{shown(found[f'{prefix}ratio_exact'], '.2f')} x",
                *(shown(found[f"{prefix}{per}"], ".0f") for per in ("bytes_per_m2", "bytes_per_s_robot")),
            ]
            lines.append("| " + " | ".join((name, what, *cells, last)) + " |")
    return "\n".join(lines)


def main() -> None:
    """Run what is missing, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, help="of the run folders; a temporary one if not named")
    parser.add_argument("--worlds", nargs="+", default=WORLDS)
    parser.add_argument("--seeds", nargs="+", type=int, default=SEEDS)
    parser.add_argument("--robots", type=int, default=4)
    parser.add_argument("--size", type=float, default=40.0)
    parser.add_argument("--starts", choices=("known", "unknown"), default="known")
    parser.add_argument("--tiny", action="store_true", help="one small run, to see that it runs")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    if options.tiny:
        options.worlds, options.seeds, options.robots, options.size = ("maze",), (1,), 1, 5.0
    with tempfile.TemporaryDirectory(prefix="fleetmap-runs-") as scratch:
        folder = options.folder or Path(scratch)
        worlds = {}
        for world in options.worlds:
            documents = []
            for seed in options.seeds:
                documents.append(
                    run(folder, world, seed, robots=options.robots, size_m=options.size, starts=options.starts)
                )
                if not options.tiny:
                    print(f"{world}, seed {seed}: done", file=sys.stderr, flush=True)
            worlds[world] = summarize(documents)
    print(json.dumps(worlds, indent=1) if options.json else table(worlds))


if __name__ == "__main__":
    main()
