"""A robot in a process of its own that does what comes in on its input, a line of JSON each, and says what it sees.

python tests/robot_process.py NAME FLEET PROFILE LISTEN [CONNECT ...]
"""

from __future__ import annotations

import asyncio
import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from schedules import squares

import fleetmap
from fleetmap.model.pose import Pose2


class Obedient:
    """The robot's side."""

    def __init__(self, peer: fleetmap.Peer, joined_s: float) -> None:
        self.peer, self.joined_s = peer, joined_s
        self.numbers: set[int] = set()

    async def publish(self, numbers: list[int], keep: int | None = None) -> float:
        """Say so many squares more, of which only the last ones stay; returns when, by the machine's clock."""
        self.numbers = set(sorted(self.numbers | set(numbers))[-(keep or len(self.numbers) + len(numbers)) :])
        await self.peer.publish(squares(self.numbers))
        return time.monotonic()

    async def heard(self, robot: str, seq: int, timeout_s: float) -> float | None:
        """When so much of another robot was held, by the machine's clock."""
        try:
            async with asyncio.timeout(timeout_s), self.peer.stepped:
                await self.peer.stepped.wait_for(
                    lambda: any(p.robot == robot and p.seq >= seq for p in self.peer.peers)
                )
        except TimeoutError:
            return None
        return time.monotonic()

    def state(self) -> dict[str, Any]:
        """What it sees, holds and takes."""
        peers, own = self.peer.peers, self.peer._engine.own
        streams = self.peer._engine.holdings.streams()
        return {
            "joined_s": self.joined_s,
            "alive": sorted(p.robot for p in peers if p.alive),
            "held": [[s.robot, s.life, s.seq, s.digest] for s in streams],
            "seq": own.seq,
            "rss_mb": int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 1e6,
            "files": len(os.listdir("/proc/self/fd")),
            "threads": len(os.listdir("/proc/self/task")),
            "problems": [problem.text for problem in self.peer.health()],
        }

    async def obey(self) -> None:
        """Until there is no more input."""
        loop = asyncio.get_running_loop()
        while line := await loop.run_in_executor(None, sys.stdin.readline):
            what, *args = json.loads(line)
            answer = getattr(self, what)(*args)
            print(json.dumps(await answer if asyncio.iscoroutine(answer) else answer), flush=True)  # noqa: T201


class RobotProcess:
    """The side of whoever starts it.

    Parameters
    ----------
    process : with pipes
    """

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process

    def tell(self, what: str, *args: object) -> Any:
        """Have it do something, and wait for the answer."""
        self.ask(what, *args)
        return self.answer()

    def ask(self, what: str, *args: object) -> None:
        """Have it do something."""
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps([what, *args]) + "\n")
        self.process.stdin.flush()

    def answer(self) -> Any:
        """What came of it."""
        assert self.process.stdout is not None
        return json.loads(self.process.stdout.readline())

    def kill(self) -> None:
        """End it without a word."""
        self.process.kill()
        self.process.wait()


def command(name: str, fleet: str, profile: str, listen: str, *connect: str) -> list[str]:
    """What starts it."""
    return [sys.executable, __file__, name, fleet, profile, listen, *connect]


async def main(name: str, fleet: str, profile: str, listen: str, *connect: str) -> None:
    """Join, and obey."""
    began_s = time.monotonic()
    places: dict[str, Any] = {"listen": [listen], "connect": list(connect)}
    async with fleetmap.join(name, fleet=fleet, profile=profile, start=Pose2(), baselines=False, **places) as peer:
        await Obedient(peer, time.monotonic() - began_s).obey()


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))
