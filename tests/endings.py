"""How programs that joined a fleet end: each case a process, judged by its code, its words, its time and its token.

The table of all cases is printed by ``benchmarks/endings.py``; ``test_endings.py`` takes some of them.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import zenoh

from fleetmap.peer.ports import free_port
from fleetmap.peer.profiles import zenoh_settings
from fleetmap.peer.settings import as_json5

PROGRAM = Path(__file__).parent / "ending_program.py"

FACES = ("asyncio", "sync")
MOMENTS = ("joining", "compiling", "compiling here", "idle", "publishing", "folding", "reading")
UNSEEN = ("joining", "compiling", "compiling here")
"""Moments at which no token need be there yet."""
WAYS = {
    "return": 0,
    "raise": 1,
    "exit": 3,
    "closed loop": 0,
    "SIGINT": -signal.SIGINT,
    "SIGINT twice": -signal.SIGINT,
    "SIGTERM": -signal.SIGTERM,
}
"""Ways to end, and the exit code of each."""
FORGOTTEN = 1
"""What Python ends with instead of ``-SIGINT`` if any thread evaluates a string after the interrupt, as an import that
defines a dataclass does."""
MANNERS = ("left", "with")
"""Whether the peer is left open, or closed by the end of a block."""

END_S = 2.0
"""So long a process may take from its last statement, or from the signal."""
QUICK_S = (0.001, 0.01, 0.03, 0.1, 0.3)
"""Between two interrupts, one of these."""
BEGIN_S = 120.0
"""So long a process may take to come to its moment."""

NOISE = (
    "Exception ignored",
    "Exception in thread",
    "never retrieved",
    "never awaited",
    "Task was destroyed",
    "Event loop is closed",
    "exception calling callback",
    "FATAL",
    "Fatal Python",
    "panicked",
    "core dumped",
)
TWICE = ("Exception ignored", "never retrieved", "never awaited", "Task was destroyed")
"""What Python and asyncio may say themselves, if the second interrupt strikes while they clean up after the first."""


@dataclass(frozen=True)
class Case:
    """One way to end."""

    face: str
    moment: str
    way: str
    manner: str

    def __str__(self) -> str:
        return f"{self.face}, {self.moment}, {self.way}, {self.manner}"


@dataclass(frozen=True)
class Outcome:
    """How it went.

    Parameters
    ----------
    took_s : from the last statement to the end of the process
    wrong : what was wrong with it; None if nothing was
    """

    took_s: float
    wrong: str | None


def all_cases() -> list[Case]:
    """The matrix. A loop that is closed under a block leaves it open: there is no such case."""
    cases = itertools.product(FACES, MOMENTS, WAYS, MANNERS)
    return [Case(*case) for case in cases if case[2] != "closed loop" or case[::3] == ("asyncio", "left")]


class Tokens:
    """A session that sees the tokens of all fleets that connect to it; use it as ``with``."""

    def __init__(self) -> None:
        self.endpoint = f"tcp/127.0.0.1:{free_port('127.0.0.1')}"
        self._changed, self._seen, self._shown = threading.Condition(), set(), set()

    def __enter__(self):
        config = zenoh.Config()
        settings = zenoh_settings("local", listen=[self.endpoint], connect=[], config=None)
        for key, value in settings.items():
            config.insert_json5(key, as_json5(value))
        self._session = zenoh.open(config)
        self._subscriber = self._session.liveliness().declare_subscriber(
            "fleetmap/*/*/alive/**", self._take, history=True
        )
        return self

    def __exit__(self, *_):
        self._session.close()

    def _take(self, sample) -> None:
        key = str(sample.key_expr)
        with self._changed:
            if sample.kind == zenoh.SampleKind.PUT:
                self._shown.add(key)
            else:
                self._shown.discard(key)
            self._changed.notify_all()

    def wait(self, fleet: str, *, shown: bool, timeout_s: float) -> bool:
        """Wait until the fleet shows a token, or none; False if it doesn't come to that."""

        def is_so() -> bool:
            return any(key.split("/")[1] == fleet for key in self._shown) == shown

        with self._changed:
            return self._changed.wait_for(is_so, timeout_s)


def run(case: Case, tokens: Tokens, *, factor: float = 1.0) -> Outcome:
    """Run a program to its end. ``factor`` scales all times."""
    fleet = f"f{time.monotonic_ns()}"
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory(ignore_cleanup_errors=True))
        cold = {"NUMBA_CACHE_DIR": folder} if case.moment.startswith("compiling") else {}
        program = [sys.executable, PROGRAM, case.face, case.moment, case.way, case.manner, fleet, tokens.endpoint]
        errors = stack.enter_context(tempfile.TemporaryFile("w+"))
        process = stack.enter_context(
            subprocess.Popen(
                program,
                env={**os.environ, **cold},
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
                start_new_session=True,
            )
        )
        watchdog = threading.Timer(BEGIN_S * factor, process.kill)
        watchdog.start()
        stack.callback(watchdog.cancel)
        stack.callback(process.kill)
        assert process.stdin is not None
        assert process.stdout is not None

        def wrong(what: str, took_s: float = 0.0) -> Outcome:
            errors.seek(0)
            return Outcome(took_s, f"{what}; it said {errors.read()[-3000:]!r}")

        if not process.stdout.readline().startswith("now"):
            return wrong("never came to its moment")
        if case.moment not in UNSEEN and not tokens.wait(fleet, shown=True, timeout_s=10 * factor):
            return wrong("showed no token")
        if case.way.startswith("SIG"):
            ended_s = time.monotonic()
            number = getattr(signal, case.way.split()[0])
            os.killpg(process.pid, number)
            if case.way.endswith("twice"):
                time.sleep(random.choice(QUICK_S))
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, number)
        else:
            process.stdin.write("go\n")
            process.stdin.flush()
            word, _, stamp = process.stdout.readline().partition(" ")
            if word != "end":
                return wrong("never came to its end")
            ended_s = float(stamp)
        try:
            process.wait(END_S * factor * 4)  # to tell late from never
        except subprocess.TimeoutExpired:
            return wrong("never ended", END_S * factor * 4)
        took_s = time.monotonic() - ended_s
        if not tokens.wait(fleet, shown=False, timeout_s=END_S * factor):
            return wrong("its token stayed", took_s)
        errors.seek(0)
        said = errors.read()
        found = judge(case, process.returncode, said)
        if found is None and took_s > END_S * factor:
            found = f"took {took_s:.2f} s"
        return Outcome(took_s, None if found is None else f"{found}; it said {said[-3000:]!r}")


def judge(case: Case, code: int, said: str) -> str | None:
    """What is wrong with an exit code and with what was said."""
    interrupted, twice = case.way.startswith("SIGINT"), case.way.endswith("twice")
    if code != WAYS[case.way] and not (interrupted and code == FORGOTTEN):
        return f"code {code} instead of {WAYS[case.way]}"
    noise = [word for word in NOISE if word in said and not (twice and word in TWICE)]
    if noise:
        return f"noise: {noise}"
    if twice:
        return None
    if case.moment.startswith("compiling"):  # which is logged
        said = "\n".join(line for line in said.splitlines() if "compiling kernels" not in line)
    last = said.strip().rpartition("\n")[2]
    expected = {"raise": "RuntimeError: of the user's own", "SIGINT": "KeyboardInterrupt"}.get(case.way.split()[0], "")
    if last != expected:
        return f"the last line is {last!r} instead of {expected!r}"
    if case.way == "raise" and said.count("Traceback") != 1:
        return "more than the user's own traceback"
    return None
