"""The robot processes of a run, seen from the parent: started, asked in step, and none left behind."""

from __future__ import annotations

import asyncio
import contextlib
import sys
import time
from asyncio.subprocess import PIPE, Process
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from fleetmap.model.kernel_cache import environment
from fleetmap.sims.config import Death
from fleetmap.sims.pipe import MAX_LINE, line, parse

CLOSE_S = 8.0
"""A process that was told to leave gets so long before it is ended."""


@dataclass
class Member:
    """One robot process."""

    robot: str
    process: Process
    log: Path
    alive: bool = True


@dataclass
class Crew:
    """All robot processes. Use it as ``async with``: leaving it ends every one of them, however it is left.

    Parameters
    ----------
    silent_s : a process that doesn't answer for this long is taken for dead
    """

    silent_s: float
    members: list[Member] = field(default_factory=list)
    deaths: list[Death] = field(default_factory=list)
    t_s: float = 0.0
    """Simulated time, for the notes on deaths."""
    began_s: float = field(default_factory=time.monotonic)

    async def __aenter__(self) -> Crew:
        return self

    async def __aexit__(self, *error: object) -> None:
        # Shielded: a second Ctrl-C must not leave processes behind.
        await asyncio.shield(self._end())

    async def start(self, robot: str, order: Mapping[str, object], *, log: Path) -> None:
        """Start a process, never forked: a Zenoh session does not survive a fork."""
        with log.open("wb") as stderr:
            process = await asyncio.create_subprocess_exec(
                sys.executable,
                "-m",
                "fleetmap.sims.process",
                robot,
                stdin=PIPE,
                stdout=PIPE,
                stderr=stderr,
                limit=MAX_LINE,
                # Out of the terminal's process group: Ctrl-C is the parent's to handle.
                start_new_session=True,
                # The robots share the cores; each one's libraries taking all of them would only slow them down.
                env={**environment(), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
            )
        member = Member(robot, process, log)
        self.members.append(member)
        self._write(member, order)

    @property
    def living(self) -> list[Member]:
        """Members that still answer."""
        return [member for member in self.members if member.alive]

    async def ask(
        self,
        message: Mapping[str, object] | Callable[[Member], Mapping[str, object]] | None,
        *,
        timeout_s: float | None = None,
    ) -> dict[str, dict[str, object]]:
        """Say something to all living members and wait for all answers; robot -> answer.

        ``None`` only waits. Whoever ends or stays silent is noted among the dead and left out.
        """

        async def one(member: Member) -> tuple[Member, dict[str, object] | None]:
            if message is not None:
                self._write(member, message(member) if callable(message) else message)
            return member, await self._answer(member, timeout_s or self.silent_s)

        answers = await asyncio.gather(*(one(member) for member in self.living))
        return {member.robot: answer for member, answer in answers if answer is not None}

    def _write(self, member: Member, message: Mapping[str, object]) -> None:
        assert member.process.stdin is not None
        with contextlib.suppress(ConnectionError):  # it has ended; the missing answer says so
            member.process.stdin.write(line(message))

    async def _answer(self, member: Member, timeout_s: float) -> dict[str, object] | None:
        assert member.process.stdout is not None
        try:
            raw = await asyncio.wait_for(member.process.stdout.readline(), timeout_s)
            if raw:
                return parse(raw)
            # Its exit code follows its output at once.
            code = await asyncio.wait_for(member.process.wait(), CLOSE_S)
            reason = f"killed by signal {-code}" if code < 0 else f"ended with code {code}, see {member.log.name}"
        except TimeoutError:
            reason = f"silent for {timeout_s:g} s"
        except ValueError as error:
            reason = f"answered nonsense: {error}"
        member.alive = False
        with contextlib.suppress(ProcessLookupError):
            member.process.kill()
        wall_s = time.monotonic() - self.began_s
        self.deaths.append(Death(member.robot, round(self.t_s, 1), round(wall_s, 1), reason))
        return None

    async def _end(self) -> None:
        """Ask all to leave, then make sure of it."""
        for member in self.members:
            self._write(member, {"close": True})
            assert member.process.stdin is not None
            member.process.stdin.close()
        _, late = await asyncio.wait(
            [asyncio.ensure_future(member.process.wait()) for member in self.members] or [asyncio.ensure_future(_no())],
            timeout=CLOSE_S,
        )
        for member in self.members:
            if member.process.returncode is None:
                member.process.kill()
        if late:
            await asyncio.wait(late)


async def _no() -> int:
    return 0
