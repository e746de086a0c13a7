"""Calls in threads that nobody waits for when a loop or the process ends.

``asyncio.to_thread`` and ``concurrent.futures`` join their threads then, however long that takes. A kernel can't be
told to stop, and some run for seconds; so what may be in one runs here, and is left behind.
"""

from __future__ import annotations

import asyncio
import contextvars
import queue
import threading
import weakref
from collections.abc import Callable
from contextlib import suppress
from typing import Any, TypeVar

R = TypeVar("R")

_at_exit = threading.Event()


class ProcessEnds(RuntimeError):
    """The main thread has ended, and Python starts no other one any more (at ``atexit``, from Python 3.12 on)."""


def fall_silent() -> None:
    """Tell nobody of any outcome any more: the process ends, and an error that this causes is nobody's."""
    _at_exit.set()


class Worker:
    """A daemon thread that makes calls, one after the other.

    Parameters
    ----------
    name : of the thread

    Raises
    ------
    ProcessEnds : it is too late for a thread
    """

    def __init__(self, name: str) -> None:
        self._calls: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._stopped = False
        # The thread holds the queue alone, so that a worker that is forgotten doesn't live on through it.
        thread = threading.Thread(target=_make_calls, args=(self._calls,), name=name, daemon=True)
        try:
            thread.start()
        except RuntimeError as error:
            if threading.main_thread().is_alive():
                raise
            raise ProcessEnds(str(error)) from None

    async def run(self, call: Callable[[], R]) -> R:
        """The result of a call. If the caller gives up before it began, it isn't made; else it goes on.

        Raises
        ------
        RuntimeError : the worker is stopped
        """
        if self._stopped:
            raise RuntimeError("this worker is stopped")
        loop = asyncio.get_running_loop()
        future: asyncio.Future[R] = loop.create_future()
        context = contextvars.copy_context()

        def settle(set_outcome: Callable[[], None]) -> None:
            if not future.done():
                set_outcome()

        def make() -> None:
            if future.cancelled():
                return
            outcome: Callable[[], None]
            try:
                result = context.run(call)
                outcome = lambda: future.set_result(result)  # noqa: E731
            except BaseException as error:
                outcome = lambda found=error: future.set_exception(found)  # type: ignore[misc]  # noqa: E731
            # A loop that is closed has nobody who waits.
            with suppress(RuntimeError):
                if not _at_exit.is_set():
                    loop.call_soon_threadsafe(settle, outcome)

        self._calls.put(make)
        return await future

    def soon(self, call: Callable[[], None]) -> None:
        """Make a call that nobody waits for, and that doesn't raise."""
        self._calls.put(call)

    def stop(self) -> None:
        """Let the thread end after the calls that wait for it; returns at once."""
        self._stopped = True
        self._calls.put(None)


async def in_thread(call: Callable[[], R]) -> R:
    """The result of a call, made in a thread of its own; if the caller gives up, it goes on."""
    if _at_exit.is_set():
        await asyncio.get_running_loop().create_future()  # for ever
    worker = Worker("fleetmap-call")
    try:
        return await worker.run(call)
    finally:
        worker.stop()


def may_be_dropped(task: asyncio.Task[Any]) -> None:
    """Have Python say nothing when a task is left where its loop was closed, be it before it began."""
    task._log_destroy_pending = False  # type: ignore[attr-defined]
    coroutine = task.get_coro()
    if coroutine is not None:
        weakref.finalize(task, coroutine.close).atexit = False


def _make_calls(calls: queue.SimpleQueue[Callable[[], None] | None]) -> None:
    while (call := calls.get()) is not None:
        call()
        del call  # nothing of the last call lives on while the thread waits
