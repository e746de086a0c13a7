"""Does what robots have said survive reboots and lies? Seeded schedules on a link in memory, with a clock of its own.

1. reboots: robots of a fleet reboot at any moment, 0.5 to 60 s long, at most 4 times each, before or after their links
   are up, the first one too, all but one at once, behind 9.6 kbit/s. How many schedules lose something that a living
   peer has merged, or end with peers that differ.
2. lives: a robot reboots 5 to 30 times: how many end with peers that keep different lives, or without the largest one.
3. liars: a byzantine author and a lying mirror among robots that publish, reboot, are cut and forget: how many break a
   law (tests/liars.py has them).
4. alignments: robots say where others lie, confirm, take back, lie and are forgotten: how many end with peers that
   place each other differently, or merge another map.
5. revocations: an alignment, a better one, a stranger come and go: how many leave other bytes than before, or move
   others.

Goes on where it stopped, if it is given a file: a seed is run once.

    python benchmarks/schedules.py [--reboots 1000] [--lives 100] [--liars 10000] [--alignments 2000]
        [--revocations 1000] [--minutes 60] [--state FILE] [--json]
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

BATCH = 10
"""Schedules that a process runs at a time."""


def run_batch(kind: str, seeds: list[int]) -> dict[int, list[str]]:
    """By seed, the laws that were broken."""
    from alignment_histories import run_revocation, run_schedule
    from liars import run_liars
    from schedules import run_many_reboots, run_reboots

    runs = {
        "reboots": run_reboots,
        "lives": lambda seed: run_many_reboots(seed, reboots=5 + seed % 26),
        "liars": run_liars,
        "alignments": run_schedule,
        "revocations": run_revocation,
    }
    return {seed: runs[kind](seed)[:5] for seed in seeds}


def batches(counts: dict[str, int], done: dict[str, Any]) -> Iterator[tuple[str, list[int]]]:
    """What is still to be run."""
    for kind, count in counts.items():
        seeds = [seed for seed in range(count) if str(seed) not in done["broken"][kind] and seed >= done["next"][kind]]
        for first in range(0, len(seeds), BATCH):
            yield kind, seeds[first : first + BATCH]


def load(state: Path | None) -> dict[str, Any]:
    """What an earlier run has found."""
    if state is not None and state.exists():
        found: dict[str, Any] = json.loads(state.read_text())
        return found
    kinds = ("reboots", "lives", "liars", "alignments", "revocations")
    return {"next": dict.fromkeys(kinds, 0), "run": dict.fromkeys(kinds, 0), "broken": {kind: {} for kind in kinds}}


def main() -> None:
    """Run all, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--reboots", type=int, default=1000)
    parser.add_argument("--lives", type=int, default=100)
    parser.add_argument("--liars", type=int, default=10_000)
    parser.add_argument("--alignments", type=int, default=2000)
    parser.add_argument("--revocations", type=int, default=1000)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--state", type=Path)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--tiny", action="store_true")
    args = parser.parse_args()
    counts = {kind: getattr(args, kind) for kind in ("reboots", "lives", "liars", "alignments", "revocations")}
    if args.tiny:
        counts = {"reboots": 3, "lives": 1, "liars": 2, "alignments": 3, "revocations": 3}
    began_s = time.monotonic()
    state = load(args.state)
    with ProcessPoolExecutor(args.processes, mp_context=get_context("spawn")) as pool:
        waiting = batches(counts, state)
        under_way = {}
        while True:
            in_time = time.monotonic() - began_s < 60 * args.minutes
            while in_time and len(under_way) < args.processes and (batch := next(waiting, None)) is not None:
                under_way[pool.submit(run_batch, *batch)] = batch
            if not under_way:
                break
            done = next(as_completed(under_way))
            kind, seeds = under_way.pop(done)
            for seed, faults in done.result().items():
                state["run"][kind] += 1
                if faults:
                    state["broken"][kind][str(seed)] = faults
            # Batches end in another order than they began: what lies below the earliest one under way is done.
            running = [first for k, (first, *_) in under_way.values() if k == kind]
            state["next"][kind] = min([*running, max(seeds) + 1])
            if args.state is not None:
                args.state.write_text(json.dumps(state))
            if not args.json:
                told = ", ".join(f"{kind} {state['run'][kind]} of {count}" for kind, count in counts.items())
                print(f"\r{told}", end="", file=sys.stderr, flush=True)
    minutes = (time.monotonic() - began_s) / 60
    if args.json:
        print(json.dumps({"minutes": minutes, **state}))
        return
    print(file=sys.stderr)
    print("| schedules | run | laws broken in |\n|---|---|---|")
    for kind in counts:
        print(f"| {kind} | {state['run'][kind]} | {len(state['broken'][kind])} |")
        for seed, faults in state["broken"][kind].items():
            print(f"  {kind} {seed}: {faults[0]}")
    print(f"{minutes:.1f} minutes, {args.processes} processes")


if __name__ == "__main__":
    main()
