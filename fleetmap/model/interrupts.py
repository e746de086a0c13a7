"""Ctrl-C where it may not strike: numba's compiler and its import don't survive an exception at any line."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def interrupts_later() -> Iterator[None]:
    """Hold SIGINT back until the block has ended; then whoever handled it before gets it.

    In other threads than the main one this does nothing: Python handles signals in the main thread only.
    """
    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGINT) is None:
        yield
        return
    came: list[tuple[int, FrameType | None]] = []
    before = signal.signal(signal.SIGINT, lambda number, frame: came.append((number, frame)))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        if came and callable(before):
            before(*came[0])
        elif came and before is signal.SIG_DFL:
            signal.raise_signal(signal.SIGINT)
