"""What peers take of a link, and whether they get on with a slow one.

IP bytes by the kernel's counters, acknowledgements included, in network namespaces that nothing else uses.

- idle: bytes a second each way of one link, with two profiles
- records: one of some 90 bytes each second, and one of the mean size at the mean interval of a simulated robot that
  explores an office of 20 m: bytes of the link both ways by bytes of payload
- a record: what it takes beside its payload, ten a second
- slow: a robot joins three others, with 200 edges each, by a link of 9.6 kbit/s: seconds until it has joined, until it
  holds all, and until all hold and see the same

    python benchmarks/radio.py [--for-s 60] [--json]

Needs Linux and the right to make a namespace; says so where it has none.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from namespaces import INSIDE, Air, counted_bytes, in_a_namespace
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


def robot_command(name: str, k: int, connect: str, profile: str) -> list[str]:
    """A process with one robot."""
    return [sys.executable, __file__, "--robot", name, f"tcp/10.77.0.{k}:7447", connect, profile]


async def be_robot(name: str, listen: str, connect: str, profile: str) -> None:
    """Join, publish, and say what is seen and held whenever that is asked for."""
    began_s = time.monotonic()
    places = [connect] if connect != "-" else []
    join = fleetmap.join(
        name, fleet="slow", start=Pose2(), listen=[listen], connect=places, profile=profile, baselines=False
    )
    async with join as peer:
        joined_s = time.monotonic() - began_s
        await peer.publish(squares(range(1000 * int(name[1:]), 1000 * int(name[1:]) + SQUARES)))
        while await asyncio.get_running_loop().run_in_executor(None, sys.stdin.readline):
            peers = peer.peers
            held = sorted([(p.robot, p.seq) for p in peers] + [(name, peer._engine.own.seq)])
            alive = sum(p.alive for p in peers)
            print(json.dumps({"joined_s": joined_s, "alive": alive, "held": held}), flush=True)


def measure_slow(bits_a_second: int | None) -> dict[str, float | None]:
    """Three robots, and one that comes later over a slow link."""
    with Air() as air:
        robots: dict[int, subprocess.Popen[str]] = {}
        try:
            for k in (1, 2, 3, 4):
                air.host(k, bits_a_second=bits_a_second if k == 4 else None)
                if k == 4:
                    _until(robots, lambda states: _complete(states, of=3), time.monotonic())
                connect = "-" if k == 1 else "tcp/10.77.0.1:7447"
                began_s = time.monotonic()
                robots[k] = air.start(k, robot_command(f"r{k}", k, connect, "narrow" if k == 4 else "local"))
            joined_s = _read(robots[4])["joined_s"]
            held_s = _until({4: robots[4]}, _complete, began_s)
            equal_s = _until(robots, _complete, began_s)
            return {"joined_s": joined_s, "held_s": held_s, "equal_s": equal_s}
        finally:
            for robot in robots.values():
                robot.kill()
                robot.wait()


def _read(robot: subprocess.Popen[str]) -> dict[str, Any]:
    assert robot.stdin is not None
    assert robot.stdout is not None
    robot.stdin.write("\n")
    robot.stdin.flush()
    told: dict[str, Any] = json.loads(robot.stdout.readline())
    return told


def _complete(states: Sequence[dict[str, Any]], of: int = 4) -> bool:
    """Whether these see all, and hold the same of all that have published."""
    first = states[0]["held"]
    published = len(first) == of and all(seq >= 2 for _, seq in first)
    return published and all(state["held"] == first and state["alive"] == of - 1 for state in states)


def _until(
    robots: dict[int, subprocess.Popen[str]], done: Callable[[Sequence[dict[str, Any]]], bool], from_s: float
) -> float | None:
    """Seconds until the latest states of all are so; None if they don't get there."""
    while time.monotonic() < from_s + LIMIT_S:
        if done([_read(robot) for robot in robots.values()]):
            return time.monotonic() - from_s
        time.sleep(0.1)
    return None


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--for-s", type=float, default=60.0)
    parser.add_argument("--only", choices=("links", "slow"), help="one part")
    parser.add_argument("--tiny", action="store_true", help="a few seconds, to see that it runs")
    parser.add_argument("--json", action="store_true")
    parser.add_argument(INSIDE, action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--robot", nargs=4, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.robot:
        asyncio.run(be_robot(*options.robot))
        return
    if not options.inside:
        compile_ahead(kernel_modules())
        sys.exit(in_a_namespace(__file__))
    found: dict[str, Any] = {}
    if options.only != "slow":
        found |= measure_links(TINY_S if options.tiny else options.for_s)
    if options.only != "links":
        found["slow"] = measure_slow(None if options.tiny else RATE_BPS)
    print(json.dumps(found, indent=None if options.json else 1))


if __name__ == "__main__":
    main()
