"""Sessions that are open in this process, and their end when nobody else closes them.

A Zenoh session that is open when Python ends would keep the process for ever or abort it: its callbacks run in
threads of Python. Python waits for these if they are no daemons; and if they are, a thread that comes back from Zenoh's
code while Python is taken down ends the whole process, with code 134. So sessions are opened in daemon threads, of
which Zenoh's inherit that, and what is still open once the program's own threads have ended is closed by ``atexit``.
"""

from __future__ import annotations

import atexit
import os
import signal
import threading
import time
from typing import Protocol

from fleetmap.model.errors import LinkError
from fleetmap.model.threads import Worker, fall_silent

CLOSE_S = 1.0
"""So long the end of the process waits for all sessions together. Closing one takes a millisecond, opening 0.1 s."""
CALLBACK_THREAD = "(pyo3-closure)"
"""How the names of Zenoh's threads end, in Zenoh for Python 1.10."""


class Closable(Protocol):
    """Something that is open, from ``opened`` to ``closed``."""

    def close_now(self) -> None:
        """Close, from any thread and at any moment, and call ``closed``. May be called twice; doesn't raise."""


class _State:
    """What this process knows; there is one."""

    open: set[Closable] = set()  # noqa: RUF012 - there is one state
    closer: Worker | None = None
    zenoh_pid: int | None = None


def enter_zenoh(endpoint: str) -> None:
    """To be called before a session is opened.

    Raises
    ------
    LinkError : this process was forked from one that has used Zenoh, whose threads are missing here: it would hang
    """
    if _State.zenoh_pid is None:
        _State.zenoh_pid = os.getpid()
        atexit.register(_close_all)
    elif _State.zenoh_pid != os.getpid():
        raise LinkError(
            endpoint=endpoint,
            reason="this process was forked from one that has used Zenoh, which doesn't survive that; start it with "
            'multiprocessing.get_context("spawn") or subprocess, or fork before the first join',
        )


def opened(session: Closable) -> None:
    """A session is about to be opened."""
    _State.open.add(session)
    if _State.closer is None:
        # Now: at the end of a process, Python 3.12 starts no thread any more.
        _State.closer = Worker("fleetmap-endings")


def close_soon(session: Closable) -> None:
    """Close, and don't wait."""
    if _State.closer is not None:
        _State.closer.soon(session.close_now)


def closed(session: Closable) -> None:
    """The session is closed."""
    _State.open.discard(session)


def _close_all() -> None:
    """Close what is open. In a thread, as what doesn't return shall not keep the process."""
    closer = _State.closer
    if closer is None or _State.zenoh_pid != os.getpid():
        return
    fall_silent()
    # The program has ended: a further Ctrl-C can't end it any more, it could only cut this short.
    in_main = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGINT, signal.SIG_IGN) if in_main else None
    until_s = time.monotonic() + CLOSE_S
    for session in list(_State.open):
        closer.soon(session.close_now)
    done = threading.Event()
    closer.soon(done.set)
    done.wait(CLOSE_S)
    # Zenoh's threads may have been in a callback when their session was closed.
    for thread in threading.enumerate():
        if thread.daemon and thread.name.endswith(CALLBACK_THREAD):
            thread.join(max(0.0, until_s - time.monotonic()))
    if before is not None:
        signal.signal(signal.SIGINT, before)
