"""How programs that joined a fleet end: all ways, at all moments, with both faces.

    python benchmarks/endings.py                         the whole table, some five minutes on two cores
    python benchmarks/endings.py --only sync --times 5   cases with that word, each five times
    python benchmarks/endings.py --json

Each case is a process that may take 2 s from its last statement, or from the signal. It must end with its own exit
code and without a word of ours, and its token must be gone.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import statistics
import sys
from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from endings import Tokens, all_cases, run

FACTOR = float(os.environ.get("FLEETMAP_TEST_TIMEOUT_FACTOR", "1"))


def main() -> int:
    """Run all cases and print how long each took."""
    # A shell that runs this in the background has it, and its children, ignore Ctrl-C.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="cases with these words, separated by commas")
    parser.add_argument("--times", type=int, default=1)
    parser.add_argument("--at-once", type=int, default=2)
    parser.add_argument("--tiny", action="store_true", help="one case")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    words = [word.strip() for word in options.only.split(",") if word.strip()]
    cases = [case for case in all_cases() if all(word in str(case).split(", ") for word in words)]
    cases = cases[:1] if options.tiny else cases * options.times
    with Tokens() as tokens, ThreadPoolExecutor(options.at_once) as pool:
        outcomes = list(pool.map(lambda case: run(case, tokens, factor=FACTOR), cases))
    wrong = [(case, outcome.wrong) for case, outcome in zip(cases, outcomes, strict=True) if outcome.wrong]
    took = defaultdict(list)
    for case, outcome in zip(cases, outcomes, strict=True):
        took[case.way, case.moment].append(outcome.took_s)
    if options.json:
        rows = [
            {"way": way, "moment": moment, "median_s": statistics.median(times), "longest_s": max(times)}
            for (way, moment), times in took.items()
        ]
        failures = [{"case": str(case), "wrong": what} for case, what in wrong]
        print(json.dumps({"cases": len(cases), "rows": rows, "wrong": failures}, indent=2))
        return 1 if wrong else 0
    print("| way | moment | ends | median, s | longest, s |\n|---|---|---|---|---|")
    for (way, moment), times in took.items():
        print(f"| {way} | {moment} | {len(times)} | {statistics.median(times):.2f} | {max(times):.2f} |")
    for case, what in wrong:
        print(f"{case}: {what}")
    print(f"{len(cases)} ends, {len(wrong)} of them wrong; the slowest took {max(o.took_s for o in outcomes):.2f} s")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
