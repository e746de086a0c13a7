"""Does what robots have said survive reboots over real Zenoh? Processes on loopback, killed by SIGKILL.

Seeded schedules: robots are killed at any moment, and started again 0.5 to some seconds later: the first one, which the
others dial, any other one, or all but one at once. Each life maps other rooms. A map that a living peer has merged must
be merged by it, and by all others, in the end.

    python benchmarks/reboots_zenoh.py [--schedules 10] [--json]
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from attacks import Fleet

from fleetmap.model.kernel_cache import kernel_modules
from fleetmap.model.kernel_compiler import compile_ahead

MOST_REBOOTS = 4
EQUAL_WITHIN_S = 30.0


def run_schedule(seed: int, *, robots: int, events: int) -> dict[str, Any]:
    """What one schedule lost, and how long it took until all held the same after the last event."""
    rng = np.random.default_rng(seed)
    names = [f"r{i}" for i in range(robots)]
    reboots = dict.fromkeys(names, 0)
    row = robots
    seen: dict[str, set[str]] = {}
    """What peers have merged that live on, as digests of maps."""

    def look(fleet: Fleet) -> None:
        for robot, answer in fleet.ask_all(fleet.running, "kept").items():
            kept = answer["kept"]
            assert isinstance(kept, dict)
            seen[robot] = seen.get(robot, set()) | {digest for digests in kept.values() for digest in digests}

    with Fleet(names, fleet=f"reboots{seed}", rooms=int(rng.integers(5, 50)), timeout_s=60.0) as fleet:
        for _ in range(events):
            look(fleet)
            match int(rng.integers(4)):
                case 0:
                    killed = names[:1]
                case 1:
                    killed = [name for name in names if name != rng.choice(names)][: robots - 1]
                case _:
                    killed = [str(rng.choice(names))]
            killed = [name for name in killed if reboots[name] < MOST_REBOOTS]
            for name in killed:
                # In the midst of an update of its own map, sometimes: that one may be lost, and no other one.
                fleet.kill(name)
                seen.pop(name, None)
            time.sleep(float(rng.uniform(0.5, 3.0)))
            for name in killed:
                reboots[name] += 1
                row += 1
                fleet.start(name, row=row)
            for name in killed:
                fleet.joined(name)
                fleet.publish(name)
            time.sleep(float(rng.uniform(0.0, 2.0)))
        began_s = time.monotonic()
        digests = fleet.synced(at_least=robots - 1, timeout_s=EQUAL_WITHIN_S)
        equal_s = time.monotonic() - began_s
        before = {robot: set(digests) for robot, digests in seen.items()}
        look(fleet)
        kept = {
            robot: {digest for digests in answer["kept"].values() for digest in digests}  # type: ignore[attr-defined]
            for robot, answer in fleet.ask_all(fleet.running, "kept").items()
        }
        ever = set().union(*before.values())
        lost = sum(len(ever - held) for held in kept.values())
    return {"seed": seed, "reboots": sum(reboots.values()), "lost": lost, "equal": len({*digests.values()}) == 1,
            "equal_s": round(equal_s, 2)}  # fmt: skip


def main() -> None:
    """Run all, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--schedules", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--tiny", action="store_true")
    args = parser.parse_args()
    seeds = range(args.first, args.first + (1 if args.tiny else args.schedules))
    compile_ahead(kernel_modules())  # or the robots would do it while they reboot
    rows = []
    if not args.json:
        print("| schedule | reboots | maps lost | equal | after s |\n|---|---|---|---|---|", flush=True)
    for seed in seeds:
        row = run_schedule(seed, robots=2 if args.tiny else 3, events=1 if args.tiny else 4)
        rows.append(row)
        if not args.json:
            told = [row[name] for name in ("seed", "reboots", "lost", "equal", "equal_s")]
            print(f"| {' | '.join(map(str, told))} |", flush=True)
    if args.json:
        print(json.dumps(rows))


if __name__ == "__main__":
    main()
