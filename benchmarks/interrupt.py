"""Ctrl-C at random moments while kernels compile must end a program cleanly, and leave nothing running.

    python benchmarks/interrupt.py                 50 times `sim`, `warmup` and an agent, some 15 minutes on two cores
    python benchmarks/interrupt.py --tries 5 --json

Each try has an empty cache, so that all of it falls into the compiling. The interrupt goes to the whole process
group, as a terminal's does. A command must end with 130, one line or one JSON document, and no traceback; an agent
as Python programs do, by KeyboardInterrupt.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

AGENT = """
import asyncio, fleetmap, numpy as np
async def main():
    grid = fleetmap.OccupancyGrid(np.zeros((40, 40), np.int8), 0.05)
    async with fleetmap.join("r7", profile="local", listen=["tcp/127.0.0.1:0"]) as peer:
        await peer.publish(grid)
asyncio.run(main())
"""

PROGRAMS = {
    "sim": ["-m", "fleetmap", "sim", "--robots", "2", "--size", "10"],
    "sim --json": ["-m", "fleetmap", "sim", "--robots", "2", "--size", "10", "--json"],
    "warmup": ["-m", "fleetmap", "warmup"],
    "warmup --json": ["-m", "fleetmap", "warmup", "--json"],
    "agent": ["-c", AGENT],
}

END_S = 20.0
"""And one that hasn't ended so long after the interrupt; the largest measured was 1 s on free cores."""


def attempt(name: str, after_s: float) -> dict[str, object]:
    """Interrupt a program ``after_s`` after it began to compile; what was wrong with its end, and how long it took."""
    with tempfile.TemporaryDirectory() as folder:
        process = subprocess.Popen(
            [sys.executable, *PROGRAMS[name]],
            cwd=folder,
            env={**os.environ, "NUMBA_CACHE_DIR": str(Path(folder) / "cache")},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        try:
            assert process.stderr is not None
            first = process.stderr.readline()
            time.sleep(after_s)
            os.killpg(process.pid, signal.SIGINT)
            began_s = time.monotonic()
            out, err = process.communicate(timeout=END_S)
            took_s = time.monotonic() - began_s
            wrong = judge(name, process.returncode, out, first + err)
        except subprocess.TimeoutExpired:
            wrong, took_s = f"still running {END_S:g} s after the interrupt", END_S
        finally:
            process.kill()
            process.wait()
        left = processes_with(folder)
        if left:
            wrong = wrong or f"left running: {left}"
        return {"program": name, "after_s": after_s, "took_s": took_s, "wrong": wrong}


def judge(name: str, code: int, out: str, err: str) -> str | None:
    """What is wrong with the end of an interrupted program."""
    if "compiling kernels" not in err:
        return f"said nothing of compiling: {err!r}"
    if name == "agent":
        if code not in (1, 130, -signal.SIGINT) or not err.rstrip().endswith("KeyboardInterrupt"):
            return f"code {code}: {err!r}"
        other = set(re.findall(r"^(\w[\w.]*(?:Error|Exception|Stopped)\b.*)", err, re.M))
        other -= {line for line in other if line.startswith("asyncio.exceptions.CancelledError")}
        return f"{other}" if other or "Exception ignored" in err or "Fatal Python" in err else None
    if code != 130 or "Traceback" in err or "Exception" in err:
        return f"code {code}: {err!r}"
    if name.endswith("--json"):
        document = json.loads(out)
        return None if document["error"]["exit_code"] == 130 else f"{document}"
    return None if "interrupted" in err else f"doesn't say that it was interrupted: {err!r}"


def processes_with(folder: str, patience_s: float = 5.0) -> list[int]:
    """Processes that have the folder in their environment, once they have had time to end."""
    until_s = time.monotonic() + patience_s
    while True:
        found = []
        for environment in Path("/proc").glob("[0-9]*/environ"):
            try:
                if folder.encode() in environment.read_bytes():
                    found.append(int(environment.parent.name))
            except OSError:
                continue  # it has ended, or belongs to somebody else
        if not found or time.monotonic() > until_s:
            return found
        time.sleep(0.05)


def main() -> int:
    """Run all tries and print what went wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tries", type=int, default=50, help="of each: sim, warmup (every other one --json), an agent")
    parser.add_argument("--longest-s", type=float, default=10.0, help="the latest moment after the first compiling")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--tiny", action="store_true", help="one try of each, at once")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    rng = random.Random(options.seed)
    tries, longest_s = (1, 0.3) if options.tiny else (options.tries, options.longest_s)
    results = []
    for turn in range(tries):
        json_turn = " --json" if turn % 2 == 0 else ""
        for name in (f"sim{json_turn}", f"warmup{json_turn}", "agent"):
            result = attempt(name, rng.uniform(0.0, longest_s))
            results.append(result)
            if result["wrong"] and not options.json:
                print(f"{name} after {result['after_s']:.2f} s: {result['wrong']}")
    wrong = [result for result in results if result["wrong"]]
    longest = max(float(str(result["took_s"])) for result in results)
    if options.json:
        print(json.dumps({"tries": len(results), "wrong": wrong, "longest_end_s": longest}, indent=2))
    else:
        print(f"{len(results)} interrupts, {len(wrong)} ends that were wrong; the slowest took {longest:.1f} s")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
