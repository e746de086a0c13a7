"""A program that joined a fleet ends when it ends: at once, as it meant to, and the others see it go."""

from __future__ import annotations

import asyncio
import gc
import subprocess
import sys
import threading

import pytest
from endings import FACES, MANNERS, MOMENTS, WAYS, Case, Tokens, all_cases, run

import fleetmap
import fleetmap.sync
from fleetmap.model.errors import LinkError
from fleetmap.model.threads import Worker, in_thread, may_be_dropped
from fleetmap.peer.endings import CALLBACK_THREAD
from fleetmap.peer.memory_link import LoopClock, MemoryHub

TIMEOUT_S = 20.0


def some_cases():
    """Each face at each moment, each in turn in another way and manner; benchmarks/endings.py runs all."""
    cases = [
        Case(face, moment, tuple(WAYS)[(2 * i + 3 * j) % len(WAYS)], MANNERS[(i + j) % 2])
        for j, face in enumerate(FACES)
        for i, moment in enumerate(MOMENTS)
    ]
    cases = [case for case in cases if case in all_cases()]
    return [
        *cases,
        Case("asyncio", "idle", "closed loop", "left"),
        Case("asyncio", "publishing", "SIGINT", "with"),
        Case("sync", "reading", "SIGINT", "left"),
    ]


@pytest.fixture(scope="module")
def tokens():
    with Tokens() as seen:
        yield seen


@pytest.mark.parametrize("case", some_cases(), ids=str)
def test_a_program_ends_at_once_with_its_own_code_and_its_token(case, tokens, timeout_factor):
    assert run(case, tokens, factor=timeout_factor).wrong is None


def test_the_cases_here_have_each_way_in_each_face_and_manner():
    assert {(c.face, c.way) for c in some_cases()} >= {(c.face, c.way) for c in all_cases() if c.face == "sync"}
    assert {c.way for c in some_cases()} == set(WAYS)
    assert {(c.face, c.manner) for c in some_cases()} == {(c.face, c.manner) for c in all_cases()}


# Loops


def test_a_robot_whose_loop_was_closed_is_gone_as_soon_as_something_reaches_it(tokens, timeout_factor):
    loop = asyncio.new_event_loop()
    options = {"fleet": "closed", "profile": "local", "connect": [tokens.endpoint]}
    loop.run_until_complete(fleetmap.join("a", **options).__aenter__())
    assert tokens.wait("closed", shown=True, timeout_s=TIMEOUT_S * timeout_factor)
    loop.close()
    with fleetmap.sync.join("b", **options):
        pass
    assert tokens.wait("closed", shown=False, timeout_s=TIMEOUT_S * timeout_factor)


async def test_a_peer_whose_tasks_are_cancelled_leaves_the_fleet():
    hub = MemoryHub(LoopClock())
    link = hub.link("a")
    peer = await fleetmap.join("a", link=link)
    assert link.token is not None
    tasks = asyncio.all_tasks() - {asyncio.current_task()}
    for task in tasks:
        task.cancel()
    await asyncio.wait(tasks)
    assert link.token is None
    with pytest.raises(LinkError, match="closed"):
        await peer.refresh()
    await peer.close()


async def test_close_does_not_wait_for_a_kernel():
    gate, began = threading.Event(), asyncio.Event()
    loop = asyncio.get_running_loop()
    link = MemoryHub(LoopClock()).link("a")
    peer = await fleetmap.join("a", link=link)

    def stay():
        loop.call_soon_threadsafe(began.set)
        gate.wait(TIMEOUT_S)

    reading = asyncio.ensure_future(peer._read(stay))
    await began.wait()
    async with asyncio.timeout(TIMEOUT_S / 2):
        await peer.close()
    assert link.token is None
    assert not gate.is_set()
    gate.set()
    await reading


# Threads


def test_all_threads_of_zenoh_are_daemons_and_are_named_as_the_end_of_a_process_knows_them(tokens):
    before = set(threading.enumerate())
    with fleetmap.sync.join("a", fleet="threads", profile="local", connect=[tokens.endpoint]):
        added = [thread for thread in threading.enumerate() if thread not in before]
        assert sum(thread.name.endswith(CALLBACK_THREAD) for thread in added) == 1
        assert all(thread.daemon for thread in added), added


def test_a_thread_of_the_program_goes_on_with_the_peer_when_the_main_thread_has_ended(tokens):
    code = f"""
import threading, time, fleetmap, fleetmap.sync
peer = fleetmap.sync.join("r", fleet="thread", profile="local", connect=["{tokens.endpoint}"])
def work():
    threading.main_thread().join()
    peer.refresh()
    print("refreshed", flush=True)
threading.Thread(target=work).start()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "refreshed\n", "")


async def test_a_worker_makes_its_calls_in_order_and_skips_those_that_nobody_waits_for():
    worker, gate, made = Worker("test"), threading.Event(), []
    first = asyncio.ensure_future(worker.run(lambda: gate.wait(TIMEOUT_S)))
    others = [asyncio.ensure_future(worker.run(lambda i=i: made.append(i))) for i in range(3)]
    await asyncio.sleep(0)
    others[1].cancel()
    gate.set()
    await asyncio.gather(first, *others, return_exceptions=True)
    assert made == [0, 2]
    with pytest.raises(ZeroDivisionError):
        await worker.run(lambda: 1 // 0)
    worker.stop()
    with pytest.raises(RuntimeError, match="stopped"):
        await worker.run(lambda: None)


def test_a_call_outlives_its_loop_in_silence(capfd):
    gate, began = threading.Event(), threading.Event()

    def stay():
        began.set()
        gate.wait(TIMEOUT_S)

    async def give_up():
        task = asyncio.ensure_future(in_thread(stay))
        await asyncio.sleep(0)
        assert began.wait(TIMEOUT_S)  # a call that has not begun is not made
        task.cancel()

    asyncio.run(give_up())
    (thread,) = [thread for thread in threading.enumerate() if thread.name == "fleetmap-call"]
    gate.set()
    thread.join(TIMEOUT_S)
    assert not thread.is_alive()
    assert capfd.readouterr() == ("", "")


def test_a_task_that_never_began_is_dropped_in_silence(recwarn):
    async def never_begins():
        pass

    loop = asyncio.new_event_loop()
    task = loop.create_task(never_begins())
    may_be_dropped(task)
    loop.close()
    del task, loop
    gc.collect()
    assert not recwarn.list


# Forks


FORK = """
import os, sys, fleetmap, fleetmap.sync
endpoint = sys.argv[1]
options = {"fleet": "fork", "profile": "local", "connect": [endpoint]}
def join(name):
    try:
        with fleetmap.sync.join(name, **options):
            return "joined"
    except fleetmap.LinkError as error:
        return str(error)
def in_child(work):
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.write(writing, str(work()).encode())
        sys.exit(5)
    os.close(writing)
    said = os.fdopen(reading).read()
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), said, flush=True)
def use(peer):
    try:
        peer.refresh()
    except fleetmap.LinkError as error:
        peer.close()
        return str(error)
in_child(lambda: join("before"))
with fleetmap.sync.join("parent", **options) as peer:
    in_child(lambda: join("child"))
    in_child(lambda: use(peer))
    peer.refresh()
"""


def test_a_fork_joins_before_the_first_join_and_is_told_to_spawn_after_it(tokens):
    done = subprocess.run(
        [sys.executable, "-c", FORK, tokens.endpoint], capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    before, child, inherited = done.stdout.splitlines()
    assert before == "5 joined"
    assert child.startswith("5 ")
    assert '("spawn")' in child
    assert "forked from" in inherited
