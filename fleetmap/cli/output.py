"""What every command prints, and where: results on stdout, everything else on stderr."""

from __future__ import annotations

import io
import json
import math
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

AsJson = Annotated[bool, typer.Option("--json", help="Print exactly one JSON document on stdout.")]

stderr = Console(stderr=True)


EVERY_S = 8.0
"""In a pipe or a file, what takes long says so this often."""


@contextmanager
def progress(title: str) -> Iterator[Callable[[str], None]]:
    """Say on stderr what is being done, and for how long: in place on a terminal, elsewhere a line now and then.

    Yields
    ------
    tell : called with the name of each step as it begins
    """
    live, ended = stderr.is_terminal, threading.Event()
    step, began_s = "", time.monotonic()
    status = stderr.status(escape(title)) if live else None

    def show() -> None:
        text = escape(f"{title}: {step}, {time.monotonic() - began_s:.0f} s")
        with suppress(OSError):  # what nobody can read is no reason to stop
            if status is not None:
                status.update(text)
            else:
                stderr.print(text, highlight=False, soft_wrap=True)

    def tick() -> None:
        while not ended.wait(1.0 if live else EVERY_S):
            show()

    def tell(name: str) -> None:
        nonlocal step, began_s
        step, began_s = name, time.monotonic()
        if live:
            show()

    ticker = threading.Thread(target=tick, name="progress", daemon=True)
    with status or nullcontext():
        ticker.start()
        try:
            yield tell
        finally:
            ended.set()
            ticker.join()


@contextmanager
def progress_bar(title: str, unit: str) -> Iterator[Callable[[int, int], None]]:
    """Say on stderr how far the work is: a bar with the time that is left on a terminal, elsewhere a line now and then.

    Yields
    ------
    tell : called with how many of how many are done
    """
    if stderr.is_terminal:
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        with Progress(*columns, console=stderr, transient=True) as bars:
            task = bars.add_task(escape(title), total=None)
            yield lambda done, total: bars.update(task, completed=done, total=total)
        return
    said_s = time.monotonic()

    def tell(done: int, total: int) -> None:
        nonlocal said_s
        if time.monotonic() - said_s >= EVERY_S:
            said_s = time.monotonic()
            with suppress(OSError):  # what nobody can read is no reason to stop
                stderr.print(f"{title}: {done:,} of {total:,} {unit}", markup=False, highlight=False, soft_wrap=True)

    yield tell


class OutputLost(Exception):
    """Standard output can't be written: its disk is full, or its reader is gone. No OSError, which a map may cause."""

    def __init__(self, error: OSError) -> None:
        self.reader_gone = isinstance(error, BrokenPipeError)
        super().__init__(f"standard output can't be written: {error.strerror}")


class CheckedOutput(io.TextIOWrapper):
    """Standard output, telling its own failures from those of other files."""

    def __init__(self, stream: io.TextIOWrapper) -> None:
        encoding, errors, lines = stream.encoding, stream.errors, stream.line_buffering
        super().__init__(stream.detach(), encoding, errors, line_buffering=lines)

    def write(self, text: str) -> int:
        """Write a text, into the buffer or beyond."""
        try:
            return super().write(text)
        except OSError as error:
            raise OutputLost(error) from None

    def flush(self) -> None:
        """Write what is in the buffer."""
        try:
            super().flush()
        except OSError as error:
            raise OutputLost(error) from None


def print_json(document: Mapping[str, object]) -> None:
    """One JSON document on stdout, numbers that are no numbers as null (strict JSON has none)."""
    json.dump(_strict(document), sys.stdout, indent=2, allow_nan=False)
    sys.stdout.write("\n")


def print_table(title: str, columns: list[str], rows: list[list[str]]) -> None:
    """A table on stdout; the first column is text, the others are numbers."""
    table = Table(header_style="bold")
    for i, column in enumerate(columns):
        table.add_column(column, justify="left" if i == 0 else "right", overflow="fold")
    for row in rows:
        table.add_row(*row)
    console = Console()
    if not console.is_terminal:  # a pipe has no width: never cut a number
        console = Console(width=max(120, Console(width=10_000).measure(table).maximum + 2))
    console.print(escape(title), style="bold", soft_wrap=True, highlight=False)
    console.print(table)


def _strict(value: object) -> object:
    if isinstance(value, Mapping):
        return {str(k): _strict(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_strict(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
