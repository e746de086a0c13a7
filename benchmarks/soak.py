"""Do robots hold for a long time? Six, each with a network namespace of its own, over real Zenoh.

Three live all the time; the other three are killed and started again at random. Any of them is cut from the network for
a while, and publishes now and then, a map that moves and doesn't grow. At the end all are whole again, and must hold
the same within a minute. Shown are the memory, files and threads of those that lived all the time, by minute.

    python benchmarks/soak.py [--minutes 10] [--seed 0] [--json]

Needs Linux and the right to make a namespace; says so where it has none.
"""

from __future__ import annotations

import argparse
import json
import random
import sys
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from namespaces import INSIDE, Air, in_a_namespace
from robot_process import RobotProcess, command

from fleetmap.model.kernel_cache import kernel_modules
from fleetmap.model.kernel_compiler import compile_ahead

ROBOTS, STEADY = 6, 3
STEP_S = 0.5
SQUARES = 100
"""Of one robot's map."""
LONGEST_CUT_S = 20.0
EQUAL_S = 60.0


class Soak:
    """The robots, and what happens to them.

    Parameters
    ----------
    air : where they are
    seed : of all that happens
    """

    def __init__(self, air: Air, seed: int) -> None:
        self.air, self.random = air, random.Random(seed)
        self.robots: dict[int, RobotProcess] = {}
        self.place = 0
        self.cut_until_s: dict[int, float] = {}
        self.happened = {"kills": 0, "cuts": 0, "publishes": 0}
        for k in range(1, ROBOTS + 1):
            air.host(k)
            self.start(k)

    def start(self, k: int) -> None:
        """A robot's process begins."""
        seeds = [f"tcp/10.77.0.{other}:7447" for other in range(1, STEADY + 1) if other != k]
        place = f"tcp/10.77.0.{k}:7447"
        self.robots[k] = RobotProcess(self.air.start(k, command(f"r{k}", "soak", "local", place, *seeds)))
        self.publish(k)

    def publish(self, k: int) -> None:
        """A robot says a little more."""
        count = self.random.randrange(1, 6)
        self.robots[k].tell("publish", list(range(self.place, self.place + count)), SQUARES)
        self.place += count
        self.happened["publishes"] += 1

    def step(self) -> None:
        """Something happens, or nothing."""
        now_s = time.monotonic()
        for k in [k for k, until_s in self.cut_until_s.items() if until_s <= now_s]:
            del self.cut_until_s[k]
            self.air.cut(k, up=True)
        chance = self.random.random()
        k = self.random.randrange(1, ROBOTS + 1)
        if chance < 0.02 and k > STEADY:
            self.happened["kills"] += 1
            self.robots[k].kill()
            self.start(k)
        elif chance < 0.05 and k not in self.cut_until_s:
            self.happened["cuts"] += 1
            self.cut_until_s[k] = now_s + self.random.uniform(1.0, LONGEST_CUT_S)
            self.air.cut(k)
        elif chance < 0.5:
            self.publish(k)

    def heal(self) -> None:
        """All are whole again."""
        for k in self.cut_until_s:
            self.air.cut(k, up=True)
        self.cut_until_s.clear()

    def states(self) -> dict[int, dict[str, Any]]:
        """What each sees, holds and takes."""
        return {k: robot.tell("state") for k, robot in self.robots.items()}

    def seconds_until_equal(self) -> float | None:
        """None if that takes too long."""
        began_s = time.monotonic()
        while time.monotonic() < began_s + EQUAL_S:
            states = list(self.states().values())
            if all(s["held"] == states[0]["held"] and len(s["alive"]) == ROBOTS - 1 for s in states):
                return time.monotonic() - began_s
            time.sleep(0.25)
        return None

    def close(self) -> None:
        """End all."""
        for robot in self.robots.values():
            robot.kill()


def run(minutes: float, seed: int) -> dict[str, Any]:
    """One soak."""
    with Air() as air:
        soak = Soak(air, seed)
        try:
            began_s, looks = time.monotonic(), []
            while (passed_s := time.monotonic() - began_s) < 60 * minutes:
                soak.step()
                if passed_s >= 60 * len(looks):
                    looks.append(soak.states())
                time.sleep(STEP_S)
            soak.heal()
            equal_s, last = soak.seconds_until_equal(), soak.states()
        finally:
            soak.close()
    looks.append(last)
    return {
        "seed": seed,
        "minutes": minutes,
        **soak.happened,
        "equal_s": equal_s,
        "streams": len(last[1]["held"]),
        "steady": {
            f"r{k}": {key: [round(look[k][key]) for look in looks] for key in ("rss_mb", "files", "threads")}
            for k in range(1, STEADY + 1)
        },
        "problems": sorted({text for state in last.values() for text in state["problems"]}),
    }


def main() -> int:
    """Run, and print what was found; 1 if the robots were not equal in the end."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--tiny", action="store_true", help="a few seconds, to see that it runs")
    parser.add_argument("--json", action="store_true")
    parser.add_argument(INSIDE, action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if not options.inside:
        compile_ahead(kernel_modules())
        return in_a_namespace(__file__)
    found = run(0.1 if options.tiny else options.minutes, options.seed)
    print(json.dumps(found, indent=None if options.json else 1))
    return 0 if found["equal_s"] is not None else 1


if __name__ == "__main__":
    sys.exit(main())
