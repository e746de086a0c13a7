"""Shows how far the kernels are: a line that changes on a terminal, one each 10 s in a pipe."""

from __future__ import annotations

import time
from contextlib import suppress

from rich.errors import LiveError
from rich.status import Status

from fleetmap.cli.output import stderr
from fleetmap.model.kernel_compiler import Compiling

WHAT = "compiling kernels (only once after an installation)"

EACH_S = 9.0
"""A pipe gets a line this often: whoever waits 10 s without one takes a program for hung."""


class CompilingShown:
    """Takes what ``kernel_compiler.listen`` gives; ``close`` it."""

    def __init__(self) -> None:
        self._status: Status | None = None
        self._next_s = 0.0

    def __call__(self, now: Compiling) -> None:
        """Show it, if it is time to."""
        ends = now.done == now.total
        if stderr.is_terminal and self._status is None and not ends:
            with suppress(LiveError):  # another line is being shown: then lines below each other
                status = Status("", console=stderr)
                status.start()
                self._status = status
        if self._status is not None:
            self._status.update(text_of(now))
            if ends:
                self.close()
        elif ends or time.monotonic() >= self._next_s:
            self._next_s = 0.0 if ends else time.monotonic() + EACH_S
            stderr.print(text_of(now), highlight=False, soft_wrap=True)

    def close(self) -> None:
        """Give the terminal back."""
        if self._status is not None:
            self._status.stop()
            self._status = None


def text_of(now: Compiling) -> str:
    """One line: how many of how many, and how long it takes yet."""
    if now.done == now.total:
        return f"compiled {now.total} kernel modules in {now.elapsed_s:.0f} s"
    # No more digits than are known.
    left = "" if now.left_s is None else f", about {max(5, 5 * round(now.left_s / 5))} s left"
    return f"{WHAT}: {now.done} of {now.total}{left}"
