"""What peers take of a link, and whether they get on with a slow one.

IP bytes by the kernel's counters, acknowledgements included, in network namespaces that nothing else uses.

- idle: bytes a second each way of one link, with two profiles
- records: one of some 90 bytes each second, and one of the mean size at the mean interval of a simulated robot that
  explores an office of 20 m: bytes of the link both ways by bytes of payload
- a record: what it takes beside its payload, ten a second
- no link: two robots that reach a third one and not each other publish by turns: seconds until the other one holds it
- slow: a robot joins three others, with 200 edges each, by a link of 9.6 kbit/s: seconds until it has joined, until it
  holds all, and until all hold and see the same

    python benchmarks/radio.py [--for-s 60] [--json]

Needs Linux and the right to make a namespace; says so where it has none.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from namespaces import INSIDE, Air, counted_bytes, in_a_namespace
from robot_process import RobotProcess, command
from schedules import squares

import fleetmap
from fleetmap.model.kernel_cache import kernel_modules
from fleetmap.model.kernel_compiler import compile_ahead
from fleetmap.model.pose import Pose2
from fleetmap.sims import SimConfig, run_fleet

ENDPOINT = "tcp/127.0.0.1:7447"
RATE_BPS = 9600
SQUARES = 50
RECORD_BYTES = 90
LIMIT_S = 180.0
TINY_S = 5.0


async def between_two(profile: str, for_s: float, every_s: float | None, change: int = 1) -> dict[str, float]:
    """Two peers on one link, one of which publishes a map in which so many squares are new."""
    common: dict[str, Any] = {"fleet": "radio", "start": Pose2(), "profile": profile, "baselines": False}
    async with (
        fleetmap.join("r0", listen=[ENDPOINT], **common) as a,
        fleetmap.join("r1", connect=[ENDPOINT], listen=["tcp/127.0.0.1:0"], **common) as b,
    ):
        numbers = set(range(20))
        await a.publish(squares(numbers))
        await b.synced(30.0, at_least=1)
        await asyncio.sleep(5.0)  # the heartbeats after the change are over
        began_s, kernel, before = time.monotonic(), counted_bytes(), a.stats().sent["delta"]
        while every_s is not None and time.monotonic() < began_s + for_s:
            numbers |= set(range(max(numbers) + 1, max(numbers) + 1 + change))
            await a.publish(squares(numbers))
            sent = a.stats().sent["delta"].messages - before.messages
            await asyncio.sleep(max(0.0, began_s + sent * every_s - time.monotonic()))
        await asyncio.sleep(max(0.0, began_s + for_s - time.monotonic()))
        kernel, time_s = counted_bytes() - kernel, time.monotonic() - began_s
        delta = a.stats().sent["delta"]
    return {
        "bytes": kernel,
        "s": time_s,
        "records": delta.messages - before.messages,
        "payload": delta.size_bytes - before.size_bytes,
    }


def squares_for(size_bytes: float) -> int:
    """How many new squares make a record of about that size."""
    from exchange import engine, records

    author = engine("r0")
    known, best = set(range(20)), (float("inf"), 1)
    author.publish("0", squares(known))
    records(author)
    for change in range(1, 40):
        known |= set(range(len(known), len(known) + change))
        author.publish("0", squares(known))
        best = min(best, (abs(len(records(author)[0]) - size_bytes), change))
    return best[1]


def measure_links(for_s: float) -> dict[str, Any]:
    """All but the slow one."""
    found: dict[str, Any] = {}
    for profile in ("local", "narrow"):
        idle = asyncio.run(between_two(profile, for_s if profile == "local" else 2 * for_s, None))
        found[f"idle, {profile}: B/s each way"] = idle["bytes"] / idle["s"] / 2
    for name, every_s, size_bytes in (("each second", 1.0, RECORD_BYTES), ("as in an office", *office(for_s))):
        said = asyncio.run(between_two("local", for_s, every_s, squares_for(size_bytes)))
        found[f"records {name}"] = {
            "every_s": every_s,
            "bytes": said["payload"] / said["records"],
            "ratio": said["bytes"] / said["payload"],
        }
    often = asyncio.run(between_two("local", min(for_s, 20.0), 0.1))
    found["a record, beside its payload: B"] = (often["bytes"] - often["payload"]) / often["records"]
    return found


def office(for_s: float) -> tuple[float, float]:
    """Mean seconds between the records of a robot, and their mean size."""
    with tempfile.TemporaryDirectory() as folder:
        size_m = 20.0 if for_s > TINY_S else 8.0
        run_fleet(SimConfig(out=Path(folder), robots=2, world="office", size_m=size_m, seed=1))
        robots = json.loads((Path(folder) / "stats.json").read_text())["per_robot"]
    messages = sum(robot["sent_messages"]["delta"] for robot in robots)
    return sum(robot["t_s"] for robot in robots) / messages, sum(robot["sent"]["delta"] for robot in robots) / messages


def measure_slow(bits_a_second: int | None) -> dict[str, float | None]:
    """Three robots, and one that comes later over a slow link."""
    robots: dict[int, RobotProcess] = {}
    with Air() as air:
        try:
            for k in (1, 2, 3, 4):
                slow = k == 4
                air.host(k, bits_a_second=bits_a_second if slow else None)
                if slow:
                    until_complete(robots.values(), 3, time.monotonic())
                began_s = time.monotonic()
                seeds = [] if k == 1 else ["tcp/10.77.0.1:7447"]
                place = f"tcp/10.77.0.{k}:7447"
                robots[k] = RobotProcess(
                    air.start(k, command(f"r{k}", "slow", "narrow" if slow else "local", place, *seeds))
                )
                robots[k].tell("publish", list(range(1000 * k, 1000 * k + SQUARES)))
            joined_s = robots[4].tell("state")["joined_s"]
            held_s = until_complete([robots[4]], 4, began_s)
            return {"joined_s": joined_s, "held_s": held_s, "equal_s": until_complete(robots.values(), 4, began_s)}
        finally:
            for robot in robots.values():
                robot.kill()


def measure_no_link(updates: int) -> dict[str, float]:
    """A and c reach b, and not each other."""
    robots: dict[str, RobotProcess] = {}
    with Air() as air:
        try:
            for k in (1, 2, 3):
                air.host(k)
            air.part(1, 3)
            for k, name in ((2, "b"), (1, "a"), (3, "c")):
                place = f"tcp/10.77.0.{k}:7447"
                seeds = [] if k == 2 else ["tcp/10.77.0.2:7447"]
                robots[name] = RobotProcess(air.start(k, command(name, "pair", "local", place, *seeds)))
                robots[name].tell("publish", [1000 * k])
            until_complete(robots.values(), 3, time.monotonic())
            delays = []
            for n in range(updates):
                author, listener = ("a", "c") if n % 2 else ("c", "a")
                seq = robots[author].tell("state")["seq"] + 1
                robots[listener].ask("heard", author, seq, LIMIT_S)
                said_s = robots[author].tell("publish", [1000 * (1 + 2 * (author == "c")) + 1 + n])
                delays.append(robots[listener].answer() - said_s)
                time.sleep(1.0)
            return {"updates": updates, "median_s": statistics.median(delays), "longest_s": max(delays)}
        finally:
            for robot in robots.values():
                robot.kill()


def until_complete(robots: Collection[RobotProcess], of: int, from_s: float) -> float | None:
    """Seconds until these see all, and hold the same of all that have published; None if they don't get there."""
    while time.monotonic() < from_s + LIMIT_S:
        states = [robot.tell("state") for robot in robots]
        held = states[0]["held"]
        complete = len(held) == of and all(seq >= 2 for _, _, seq, _ in held)
        if complete and all(state["held"] == held and len(state["alive"]) == of - 1 for state in states):
            return time.monotonic() - from_s
        time.sleep(0.1)
    return None


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--for-s", type=float, default=60.0)
    parser.add_argument("--only", choices=("links", "no-link", "slow"), help="one part")
    parser.add_argument("--tiny", action="store_true", help="a few seconds, to see that it runs")
    parser.add_argument("--json", action="store_true")
    parser.add_argument(INSIDE, action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if not options.inside:
        compile_ahead(kernel_modules())
        sys.exit(in_a_namespace(__file__))
    parts: dict[str, Callable[[], dict[str, Any]]] = {
        "no-link": lambda: measure_no_link(4 if options.tiny else 24),
        "slow": lambda: measure_slow(None if options.tiny else RATE_BPS),
        "links": lambda: measure_links(TINY_S if options.tiny else options.for_s),
    }
    found: dict[str, Any] = {}
    for name, measure in parts.items():
        if options.only in (None, name):
            found[name] = measure()
            if not options.json:
                print(name, json.dumps(found[name], indent=1), flush=True)
    if options.json:
        print(json.dumps(found))


if __name__ == "__main__":
    main()
