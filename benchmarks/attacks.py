"""What do thirteen attacks do to four honest robots? Real Zenoh on loopback; the attacks are in tests/thirteen.py.

By attack: until all honest maps were right everywhere while it lasted; at how many looks one was not; how often
`synced()` returned with a wrong one; by how much the largest process grew; from publish to held at the worst before and
under attack, and their ratio; until a newcomer's map was held; until all saw all and agreed after it had left.

    python benchmarks/attacks.py [--seconds 10] [--only 2 6 ...] [--tiny] [--json]
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

TINY = (5,)


def worst(seconds: Sequence[float]) -> float:
    """The 99th percentile."""
    return float(np.percentile(seconds, 99)) if seconds else float("inf")


def main() -> None:
    """Attack one fleet with each in turn, and print a table."""
    from attacks import Fleet
    from thirteen import ATTACKS, trial

    from fleetmap.model.kernel_cache import kernel_modules
    from fleetmap.model.kernel_compiler import compile_ahead

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--only", type=int, nargs="*", default=list(ATTACKS), choices=list(ATTACKS))
    parser.add_argument("--tiny", action="store_true")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    numbers, seconds = (TINY, 1.0) if options.tiny else (options.only, options.seconds)
    compile_ahead(kernel_modules())  # or the robots would do it while they are measured
    rng = np.random.default_rng(13)
    found = {}
    if not options.json:
        print(f"{seconds:.0f} s each; load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
        print(" #  right s  wrong looks  lies   MB  p99 quiet  under  ratio  newcomer s  recovered s  faults")
    with Fleet(late=("e", "f", "g"), timeout_s=60.0) as fleet:
        for number in numbers:
            o = trial(fleet, ATTACKS[number], seconds=seconds, rng=rng)
            found[number] = asdict(o)
            quiet, under = worst(o.quiet_s), worst(o.under_s)
            if not options.json:
                wrong = f"{sum(map(bool, o.looks)):5}/{len(o.looks):<5}"
                megabytes = o.growth_bytes / 2**20
                print(
                    f"{number:2}  {o.right_s:7.2f}  {wrong}  {len(o.lies):4}  {megabytes:3.0f}  {quiet:9.3f}"
                    f"  {under:5.2f}  {under / quiet:5.1f}  {o.came_s:10.1f}  {o.recovered_s:11.1f}  {o.faults or ''}",
                    flush=True,
                )
    if options.json:
        print(json.dumps({"seconds": seconds, "cores": os.cpu_count(), "attacks": found}))


if __name__ == "__main__":
    main()
