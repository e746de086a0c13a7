"""Compiles kernels ahead of their first use, by a process a core, and says how far that is.

Not by threads: numba compiles under one lock. And a process that waits for others can be interrupted at any moment;
one that compiles can't. The processes fill the cache (``kernel_cache``), and who asked loads from there.
"""

from __future__ import annotations

import ctypes
import importlib
import json
import logging
import os
import queue
import selectors
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from fleetmap.model import kernel_cache
from fleetmap.model.errors import FleetmapError
from fleetmap.model.interrupts import interrupts_later
from fleetmap.model.threads import in_thread

MAX_WORKERS = 8
"""The longest chain of kernels that import each other keeps more of them waiting."""

WORKER_BYTES = 1 << 29
"""What LLVM makes a worker grow to at most (350 MB measured): small computers have more cores than room."""

POLL_S = 0.2
"""How often whoever waits looks whether to go on."""

BYTE_S = 0.75e-3
"""One core compiles a byte of source in about this time (224 s for 300 kB, on 3 GHz; modules differ by a factor of 2).
Counts for a tenth of all sources, beside what is measured."""

CLOSE_S = 2.0
"""A worker whose pipe is closed ends itself at once; after this time it is ended."""

ONLY_ONCE = "compiling kernels, only once after an installation: a minute or two; `fleetmap warmup` does it ahead"

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Compiling:
    """How far it is. ``left_s`` is None until that can be told; ``done`` equals ``total`` once, at the end."""

    done: int
    total: int
    elapsed_s: float
    left_s: float | None


class Stopped(FleetmapError):
    """Whoever waited for kernels gave up."""

    def __init__(self) -> None:
        super().__init__("compiling was stopped")


class _State:
    """What this process knows: modules that need no more compiling ahead, and who wants to hear of it."""

    listener: Callable[[Compiling], None] | None = None
    ready: set[str] = set()  # noqa: RUF012 - there is one state
    lock = threading.Lock()
    is_worker = False
    told = False
    unsaved = False


_here = threading.local()
"""``stop``: the event that ends the wait of this thread. ``tick``: called before each kernel that it defines."""


def listen(listener: Callable[[Compiling], None] | None) -> None:
    """Have ``listener`` told of all compiling in this process, from whichever thread; None: a line in the log."""
    _State.listener = listener


def compile_ahead(modules: Iterable[str], *, stop: threading.Event | None = None) -> None:
    """Compile what isn't cached of these kernel modules and of those that they import.

    On all cores; without a folder to write to or a Python to start, here, one by one. A second process that wants
    the same waits for the first one. Returns soon if there is nothing to do. An interrupt in the meantime leaves no
    process behind.

    Parameters
    ----------
    modules : full names, as ``kernel_cache.modules_of`` gives them
    stop : to end the wait from another thread

    Raises
    ------
    Stopped : ``stop`` was set
    """
    from fleetmap.model.kernel import JIT

    if not JIT or _State.is_worker:
        return
    missing = _compile_elsewhere(kernel_cache.with_imports(modules), stop)
    began_s = time.monotonic()
    for done, module in enumerate(missing):

        def tick(done: int = done) -> None:
            _report(Compiling(done, len(missing), time.monotonic() - began_s, None))

        _here.stop, _here.tick = stop, tick
        try:
            importlib.import_module(module)
        finally:
            _here.stop = _here.tick = None
    if missing:
        _report(Compiling(len(missing), len(missing), time.monotonic() - began_s, 0.0))


async def compile_in_thread(modules: Iterable[str]) -> None:
    """``compile_ahead`` beside the event loop; when the waiting task is cancelled, the thread ends soon after."""
    stop = threading.Event()
    try:
        await in_thread(partial(compile_ahead, modules, stop=stop))
    finally:
        stop.set()


def before_kernel(module: str) -> None:
    """Called before a kernel of that module is defined: nothing of its group shall have to be compiled here.

    Raises
    ------
    Stopped : the thread is in ``compile_ahead``, and was told to stop
    """
    stop, tick = getattr(_here, "stop", None), getattr(_here, "tick", None)
    if stop is not None and stop.is_set():
        raise Stopped
    if tick is not None:
        tick()
    elif module.startswith("fleetmap.") and module.endswith("_kernels") and not _State.is_worker:
        group = kernel_cache.group(module)
        if module not in _State.ready:
            _compile_elsewhere(kernel_cache.modules_of(group), None)


def compiles_here() -> None:
    """A kernel is compiled in this process: at least the log says so."""
    if not _State.is_worker and _State.listener is None:
        _tell_once()


def could_not_save(folder: Path, error: OSError) -> None:
    """A kernel was compiled and can't be kept: say so, once."""
    if not _State.unsaved and not _State.is_worker:
        logger.warning("compiled kernels can't be kept in %s: %s; the next process compiles them again", folder, error)
    _State.unsaved = True


def _report(now: Compiling) -> None:
    if _State.listener is not None:
        _State.listener(now)
    else:
        _tell_once()


def _tell_once() -> None:
    if not _State.told:
        _State.told = True
        logger.warning(ONLY_ONCE)


def _compile_elsewhere(modules: list[str], stop: threading.Event | None) -> list[str]:
    """Have worker processes compile; what is left to be compiled here, in an order that it can be imported in."""
    from fleetmap.model.kernel import cached_in

    def missing() -> list[str]:
        return [module for module in modules if module not in _State.ready and cached_in(module) is None]

    with _mine(stop):
        left = missing()
        if left:
            folder = kernel_cache.writing_folder(kernel_cache.source_of("fleetmap.model.kernel"))
            if folder is not None and _can_start():
                with _alone(folder, len(left), stop):
                    left = missing()
                    if left and _Workers(left).run(stop):
                        left = missing()
        # What workers couldn't do isn't tried by them again.
        _State.ready.update(modules)
    return left


def _can_start() -> bool:
    """Whether ``sys.executable`` is a Python: where it is embedded, that is the program itself."""
    return Path(sys.executable or "").name.startswith("python") and not getattr(sys, "frozen", False)


@contextmanager
def _mine(stop: threading.Event | None) -> Iterator[None]:
    """One thread of this process at a time."""
    while not _State.lock.acquire(timeout=POLL_S):
        if stop is not None and stop.is_set():
            raise Stopped
    try:
        yield
    finally:
        _State.lock.release()


@contextmanager
def _alone(folder: Path, count: int, stop: threading.Event | None) -> Iterator[None]:
    """One process at a time; robots that start together would compile everything once each."""
    import fcntl

    began_s = time.monotonic()
    with ExitStack() as stack:
        with suppress(OSError):  # a file system without locks: they will
            folder.mkdir(parents=True, exist_ok=True)
            file = stack.enter_context((folder / "fleetmap-kernels.lock").open("wb"))
            while True:
                try:
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    break
                except BlockingIOError:
                    _report(Compiling(0, count, time.monotonic() - began_s, None))
                    time.sleep(POLL_S)
                    if stop is not None and stop.is_set():
                        raise Stopped from None
        yield


@dataclass
class _Worker:
    """A process that imports modules, one after the other."""

    process: subprocess.Popen[bytes]
    module: str | None = None


@dataclass
class _Workers:
    """Some processes that compile ``modules``, which are in an order that they can be imported in."""

    modules: list[str]
    done: set[str] = field(default_factory=set)

    def run(self, stop: threading.Event | None) -> bool:
        """Compile all; False if something went wrong, whatever it was: an import here will tell."""
        began_s = time.monotonic()
        urgency = self._urgency()
        waiting = sorted(self.modules, key=lambda module: -urgency[module])
        with self._workers() as workers, selectors.DefaultSelector() as selector:
            for worker in workers:
                assert worker.process.stdout is not None
                selector.register(worker.process.stdout, selectors.EVENT_READ, worker)
            while len(self.done) < len(self.modules):
                for worker in workers:
                    if worker.module is None and (module := self._next(waiting)) is not None:
                        waiting.remove(module)
                        if not _send(worker, module):
                            return False
                self._tell(workers, began_s)
                for key, _ in selector.select(POLL_S):
                    worker = key.data
                    if worker.process.stdout.readline() != f"done {worker.module}\n".encode():
                        return False
                    self.done.add(worker.module)
                    worker.module = None
                if stop is not None and stop.is_set():
                    raise Stopped
            self._tell(workers, began_s)
        return True

    def _next(self, waiting: list[str]) -> str | None:
        """The most urgent module whose imports are compiled."""
        missing = set(self.modules) - self.done
        return next((m for m in waiting if missing.isdisjoint(kernel_cache.imported_kernels(m))), None)

    def _urgency(self) -> dict[str, int]:
        """How much is to be compiled from each module to the last one that waits for it, in bytes of source."""
        urgency: dict[str, int] = {}
        for module in reversed(self.modules):
            after = [m for m in urgency if module in kernel_cache.imported_kernels(m)]
            urgency[module] = _size(module) + max((urgency[m] for m in after), default=0)
        return urgency

    def _tell(self, workers: list[_Worker], began_s: float) -> None:
        elapsed_s = time.monotonic() - began_s
        total = sum(map(_size, self.modules))
        # What is under way is half done, on average.
        done = sum(map(_size, self.done)) + sum(_size(worker.module) for worker in workers if worker.module) / 2
        expected = total / 10
        byte_s = (elapsed_s + expected * BYTE_S / len(workers)) / (done + expected)
        _report(Compiling(len(self.done), len(self.modules), elapsed_s, (total - done) * byte_s))

    @contextmanager
    def _workers(self) -> Iterator[list[_Worker]]:
        """Start them; none is left, however the block is left."""
        # The interpreter finds this package wherever this process found it.
        code = f"import sys; sys.path[:] = {json.dumps(sys.path)}; from {__name__} import work; work()"
        workers: list[_Worker] = []
        try:
            for _ in range(min(_max_workers(), len(self.modules))):
                process = subprocess.Popen(
                    [sys.executable, "-c", code],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.DEVNULL,
                    # Out of the terminal's process group: Ctrl-C is the parent's to handle.
                    start_new_session=True,
                    env=kernel_cache.environment(),
                )
                workers.append(_Worker(process))
            yield workers
        finally:
            with interrupts_later():
                for worker in workers:
                    assert worker.process.stdin is not None
                    with suppress(OSError):
                        worker.process.stdin.close()
                for worker in workers:
                    try:
                        worker.process.wait(CLOSE_S)
                    except subprocess.TimeoutExpired:
                        worker.process.kill()
                        worker.process.wait()
                    assert worker.process.stdout is not None
                    worker.process.stdout.close()


def _max_workers() -> int:
    room = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2  # the rest is the agent's
    return max(1, min(MAX_WORKERS, len(os.sched_getaffinity(0)), room // WORKER_BYTES))


def _send(worker: _Worker, module: str) -> bool:
    assert worker.process.stdin is not None
    worker.module = module
    try:
        worker.process.stdin.write(f"{module}\n".encode())
        worker.process.stdin.flush()
    except OSError:
        return False
    return True


def _size(module: str) -> int:
    return kernel_cache.source_of(module).stat().st_size


PR_SET_PDEATHSIG = 1
"""Of Linux's prctl: which signal a process gets when the thread that started it ends."""


def work() -> None:
    """Be a worker: import each module that stdin names, and end with stdin, whatever is under way."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(OSError, AttributeError):  # other systems than Linux: then the thread below does it, a bit later
        # A call of LLVM's may take ten seconds, in which no thread of Python's comes to its turn.
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    _State.is_worker = True
    orders: queue.SimpleQueue[str] = queue.SimpleQueue()

    def read() -> None:
        for line in sys.stdin.buffer:
            orders.put(line.decode().strip())
        # The parent has gone, or has what it wanted. LLVM can't be told to stop.
        if (kernel := sys.modules.get("fleetmap.model.kernel")) is not None:
            kernel.saving.acquire()
        os._exit(0)

    threading.Thread(target=read, daemon=True).start()
    while True:
        module = orders.get()
        try:
            importlib.import_module(module)
            answer = "unsaved" if _State.unsaved else "done"
        except Exception:
            answer = "failed"
        sys.stdout.buffer.write(f"{answer} {module}\n".encode())
        sys.stdout.buffer.flush()
