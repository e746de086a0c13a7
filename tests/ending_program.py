"""A program that joins a fleet and ends. Run by ``endings.py``; its arguments: FACE MOMENT WAY MANNER FLEET ENDPOINT.

It says ``now`` when the moment is there, waits for a line, says ``end`` before its last statement, and ends in its way;
or is ended by a signal.
"""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import sys
import threading
import time

import numpy as np

import fleetmap
import fleetmap.sync

FACE, MOMENT, WAY, MANNER, FLEET, ENDPOINT = sys.argv[1:]
SIGNALLED = WAY.startswith("SIG")
OPTIONS = {"fleet": FLEET, "profile": "local", "connect": [ENDPOINT], "start": fleetmap.Pose2()}
CELLS = np.full((40, 40), -1, np.int8)
CELLS[8:30, 8:30] = 0
GRID = fleetmap.OccupancyGrid(CELLS, 0.05)

there = threading.Event()


def say(word):
    sys.stdout.write(f"{word} {time.monotonic()}\n")
    sys.stdout.flush()


def arrive(*_):
    if not there.is_set():
        say("now")
        there.set()


def stay(*_):
    """As a kernel does: outside of Python, without its lock, and longer than anybody waits."""
    arrive()
    ctypes.CDLL(None).sleep(60)


def prepare():
    """Have the moment announced."""
    if MOMENT == "joining":
        import zenoh

        really = zenoh.open
        zenoh.open = lambda config: arrive() or really(config)
    elif MOMENT == "compiling":
        from fleetmap.model import kernel_compiler

        kernel_compiler.listen(arrive)
    elif MOMENT == "compiling here":  # as where no process can be started
        from fleetmap.model import kernel_compiler

        sys.executable = ""
        kernel_compiler.listen(arrive)
    elif MOMENT == "publishing":
        from fleetmap.vectorize import Vectorizer

        Vectorizer.update = stay
    elif MOMENT == "folding":
        import fleetmap.merge

        fleetmap.merge.fold = stay


def end():
    """The last statement, but for ``return``."""
    if MOMENT not in ("joining", "compiling", "compiling here"):
        sys.stdin.readline()
    say("end")
    if WAY == "raise":
        raise RuntimeError("of the user's own")
    if WAY == "exit":
        sys.exit(3)


async def work(peer):
    """What is under way at the moment."""
    if MOMENT == "publishing":
        await peer.publish(GRID)
    elif MOMENT == "folding":
        await peer.publish(GRID)
        await peer.refresh()
    elif MOMENT == "reading":
        arrive()
        async for _ in peer.changes():
            pass
    else:
        arrive()
        await asyncio.Event().wait()


async def live(peer):
    if SIGNALLED:
        await work(peer)
    else:
        working = asyncio.create_task(work(peer))
        await asyncio.to_thread(there.wait)
        if WAY == "closed loop":  # the user's own tasks are the user's to end
            working.cancel()
            await asyncio.wait([working])
        end()
        del working


async def enter(joining):
    if MANNER == "with":
        async with joining as peer:
            await live(peer)
    else:
        peer = await joining
        await live(peer)


async def main():
    joining = fleetmap.join("r", **OPTIONS)
    if SIGNALLED or MOMENT not in ("joining", "compiling", "compiling here"):
        await enter(joining)
    else:
        entering = asyncio.create_task(enter(joining))
        await asyncio.to_thread(there.wait)
        if WAY == "closed loop":
            entering.cancel()
            await asyncio.wait([entering])
        end()
        del entering


def work_sync(peer):
    if MOMENT == "publishing":
        peer.publish(GRID)
    elif MOMENT == "folding":
        peer.publish(GRID)
        peer.refresh()
    elif MOMENT == "reading":
        arrive()
        for _ in peer.changes():
            pass
    else:
        arrive()
        while True:
            time.sleep(0.2)  # an interrupt just before a sleep is noticed after it


def until_closed(peer):
    with contextlib.suppress(fleetmap.LinkError):
        work_sync(peer)


def live_sync(peer):
    if SIGNALLED:
        work_sync(peer)
    else:
        threading.Thread(target=until_closed, args=[peer], daemon=True).start()
        there.wait()
        end()


def enter_sync():
    if MANNER == "with":
        with fleetmap.sync.join("r", **OPTIONS) as peer:
            live_sync(peer)
    else:
        live_sync(fleetmap.sync.join("r", **OPTIONS))


def main_sync():
    if SIGNALLED or MOMENT not in ("joining", "compiling", "compiling here"):
        enter_sync()
    else:
        threading.Thread(target=enter_sync, daemon=True).start()
        there.wait()
        end()


prepare()
if FACE == "sync":
    main_sync()
elif WAY == "closed loop":
    loop = asyncio.new_event_loop()
    loop.run_until_complete(main())
    loop.close()
else:
    asyncio.run(main())
