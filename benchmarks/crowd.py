"""Do many peers hold on few cores? Processes with several peers each, over real Zenoh on loopback.

All join at once, by one that the others dial, and publish 50 squares each. Then:

- equal: seconds from the last join's start until all see all, and hold the same of each
- settled: the same from the start of one more publish each, all at once, when the load has settled
- absent: how often a peer lost sight of another one, in so many idle seconds; and CPU seconds a second of all processes
- publishes: what so many publishes, spread over the time, cost in lists, questions and answers
- threads: of one process, those of Python beyond what it had, and of Zenoh

With --busy so many other processes compute all the time.

    python benchmarks/crowd.py [--processes 5] [--peers 10] [--busy 0] [--idle-s 60] [--publishes 150] [--json]
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import random
import subprocess
import sys
import threading
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from schedules import squares

import fleetmap
from fleetmap.model.kernel_cache import kernel_modules
from fleetmap.model.kernel_compiler import compile_ahead
from fleetmap.model.pose import Pose2
from fleetmap.peer.ports import free_port

SQUARES = 50
ASKING = ("want", "list", "repair", "snapshot")
PUBLISHES_S = 30.0
LIMIT_S = 300.0


class Crowd:
    """The peers of one process."""

    def __init__(self, process: int, count: int, endpoint: str) -> None:
        self.process, self.endpoint = process, endpoint
        self.names = [f"r{process}-{k}" for k in range(count)]
        self.peers: list[fleetmap.Peer] = []
        self.numbers: dict[str, set[int]] = {}
        self.rng = random.Random(process)

    async def join(self) -> dict[str, float]:
        """All join, one after the other; returns when the last one began, by the machine's clock."""
        last_s = 0.0
        for name in self.names:
            last_s = time.monotonic()
            first = name == "r0-0"
            place = {"listen": [self.endpoint]} if first else {"connect": [self.endpoint]}
            self.peers.append(await fleetmap.join(name, fleet="crowd", profile="local", start=Pose2(), **place))
            self.numbers[name] = set()
            await self.grow(self.peers[-1], SQUARES)
        return {"last_s": last_s}

    async def grow(self, peer: fleetmap.Peer, count: int) -> None:
        """A peer publishes so many squares more, at places of its own."""
        at = (self.process * 100 + self.names.index(peer.robot)) * 1000
        known = self.numbers[peer.robot]
        known |= {at + k for k in range(len(known), len(known) + count)}
        await peer.publish(squares(known))

    def state(self) -> dict[str, Any]:
        """What each peer sees and holds."""
        told = []
        for peer in self.peers:
            infos = peer.peers
            own = peer._engine.own
            held = sorted([(p.robot, p.life, p.seq) for p in infos] + [(peer.robot, own.life, own.seq)])
            told.append((sum(p.alive for p in infos), hash(tuple(held))))
        return {"alive": min(alive for alive, _ in told), "held": sorted({held for _, held in told})}

    async def idle(self, seconds: float) -> dict[str, float]:
        """Nothing is published; what is lost sight of is counted at each look."""
        until_s, cpu_s, drops = time.monotonic() + seconds, time.process_time(), 0
        absent: set[tuple[str, str]] = set()
        while time.monotonic() < until_s:
            await asyncio.sleep(0.25)
            now = {(peer.robot, p.robot) for peer in self.peers for p in peer.peers if not p.alive}
            drops += len(now - absent)
            absent = now
        return {"drops": drops, "cpu_s": time.process_time() - cpu_s}

    async def publishes(self, count: int, seconds: float) -> dict[str, int]:
        """So many publishes at any time; returns what was said because of them."""
        before, began_s = self.said(), time.monotonic()
        for at_s in sorted(self.rng.uniform(0, seconds) for _ in range(count)):
            await asyncio.sleep(max(0.0, began_s + at_s - time.monotonic()))
            await self.grow(self.rng.choice(self.peers), 1)
        await asyncio.sleep(5.0)
        return {kind: size - before.get(kind, 0) for kind, size in self.said().items()}

    def said(self) -> dict[str, int]:
        """Bytes that the peers have sent, by kind."""
        sent: dict[str, int] = {}
        for peer in self.peers:
            for kind, count in peer.stats().sent.items():
                sent[kind] = sent.get(kind, 0) + count.size_bytes
        return sent

    def threads(self) -> dict[str, int]:
        """Of this process."""
        names = [Path(f"/proc/self/task/{task}/comm").read_text().strip() for task in os.listdir("/proc/self/task")]
        zenoh = sum(name.split("-")[0] in ("app", "acc", "net", "tx", "rx", "tokio") for name in names)
        return {"python": threading.active_count(), "zenoh": zenoh, "all": len(names)}

    async def obey(self) -> None:
        """Do what comes in, a line each, until there is no more."""
        loop = asyncio.get_running_loop()
        try:
            while line := await loop.run_in_executor(None, sys.stdin.readline):
                what, *args = json.loads(line)
                answer = getattr(self, what)(*args)
                answer = await answer if asyncio.iscoroutine(answer) else answer
                print(json.dumps(answer), flush=True)
        finally:
            await asyncio.gather(*(peer.close() for peer in self.peers))

    async def grow_all(self) -> None:
        """Each publishes once."""
        for peer in self.peers:
            await self.grow(peer, 1)


class Processes:
    """The processes, which all do what they are told at the same time."""

    def __init__(self, processes: int, peers: int) -> None:
        endpoint = f"tcp/127.0.0.1:{free_port('127.0.0.1')}"
        self.peers = processes * peers
        self._children = [
            subprocess.Popen(
                [sys.executable, __file__, "--inside", str(k), str(peers), endpoint],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
                env={**os.environ, "PYTHONHASHSEED": "0"},
            )
            for k in range(processes)
        ]

    def tell(self, what: str, *args: object) -> list[Any]:
        """The answers of all."""
        for child in self._children:
            assert child.stdin is not None
            child.stdin.write(json.dumps([what, *args]) + "\n")
            child.stdin.flush()
        return [json.loads(child.stdout.readline()) for child in self._children if child.stdout is not None]

    def equal(self) -> bool:
        """Whether all see all and hold the same."""
        states = self.tell("state")
        held = {held for state in states for held in state["held"]}
        self.least = min(state["alive"] for state in states)
        return len(held) == 1 and self.least == self.peers - 1

    def seconds_until_equal(self, from_s: float) -> float | None:
        """None if that takes too long."""
        while not self.equal():
            if time.monotonic() > from_s + LIMIT_S:
                return None
            time.sleep(0.25)
        return time.monotonic() - from_s

    def close(self) -> None:
        """End them."""
        for child in self._children:
            assert child.stdin is not None
            child.stdin.close()
        for child in self._children:
            child.wait(30)


def total(parts: Iterable[dict[str, float]], key: str) -> float:
    """Of all processes."""
    return sum(part.get(key, 0) for part in parts)


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Everything, once."""
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(options.busy)]
    crowd = Processes(options.processes, options.peers)
    try:
        last_s = max(joined["last_s"] for joined in crowd.tell("join"))
        equal_s = crowd.seconds_until_equal(last_s)
        found: dict[str, Any] = {"peers": crowd.peers, "busy": options.busy, "equal_s": equal_s, "least": crowd.least}
        time.sleep(2.0)
        began_s = time.monotonic()
        crowd.tell("grow_all")
        found["settled_s"] = crowd.seconds_until_equal(began_s)
        idle = crowd.tell("idle", options.idle_s)
        found |= {"absent": total(idle, "drops"), "cores": total(idle, "cpu_s") / options.idle_s}
        said = crowd.tell("publishes", options.publishes // options.processes, min(PUBLISHES_S, options.idle_s))
        found["published"] = {kind: total(said, kind) for kind in sorted({kind for part in said for kind in part})}
        found["asking_bytes"] = sum(found["published"].get(kind, 0) for kind in ASKING)
        found["threads"] = crowd.tell("threads")
        return found
    finally:
        crowd.close()
        for process in busy:
            process.kill()


def main() -> None:
    """Measure, and print what was found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--processes", type=int, default=5)
    parser.add_argument("--peers", type=int, default=10, help="in each process")
    parser.add_argument("--busy", type=int, default=0, help="other processes that compute all the time")
    parser.add_argument("--idle-s", type=float, default=60.0)
    parser.add_argument("--publishes", type=int, default=150)
    parser.add_argument("--tiny", action="store_true", help="two processes with two peers, for a few seconds")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--inside", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.inside:
        process, count, endpoint = options.inside
        asyncio.run(_inside(int(process), int(count), endpoint))
        return
    if options.tiny:
        options.processes, options.peers, options.idle_s, options.publishes = 2, 2, 2.0, 4
    compile_ahead(kernel_modules())
    found = measure(options)
    print(json.dumps(found, indent=None if options.json else 1))


async def _inside(process: int, count: int, endpoint: str) -> None:
    await Crowd(process, count, endpoint).obey()


if __name__ == "__main__":
    main()
