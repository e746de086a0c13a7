"""Compiled kernels: whatever becomes of their files, and wherever they can't be kept, programs go on."""

import os
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from fleetmap.model import kernel_cache, kernel_compiler
from fleetmap.model.interrupts import interrupts_later
from fleetmap.model.kernel import JIT, kernel
from fleetmap.model.kernel_cache import kernel_modules, with_imports

pytestmark = pytest.mark.skipif(not JIT, reason="nothing is compiled")

SMALL = "fleetmap.paper.properties_kernels"
"""A module of one small kernel."""


@pytest.fixture
def folder(monkeypatch, tmp_path):
    """A cache folder of one test."""
    monkeypatch.setattr(kernel_cache, "_candidates", lambda: (tmp_path,))
    monkeypatch.setattr(kernel_cache, "_writable", lambda: (tmp_path,))
    return tmp_path


def double():
    """Define a kernel: compile it, or load it from the cache. The kernel, and whether it was loaded."""

    @kernel("i8(i8)")
    def doubled(x):
        return 2 * x

    assert doubled(21) == 42
    return doubled, bool(doubled.stats.cache_hits)


def run(code, **environment):
    """Run code in a process of its own; what it printed and what it said."""
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout, done.stderr


def test_what_was_compiled_is_loaded_the_next_time(folder):
    assert not double()[1]
    assert sorted(path.suffix for path in folder.rglob("*.nb?")) == [".nbc", ".nbi"]
    assert double()[1]


DAMAGES = {
    "empty": lambda whole: b"",
    "cut": lambda whole: whole[: len(whole) // 2],
    "one byte short": lambda whole: whole[:-1],
    "shorter than a checksum": lambda whole: whole[:7],
    "zeros, as after a power cut": lambda whole: bytes(len(whole)),
    "one bit turned": lambda whole: whole[:200] + bytes([whole[200] ^ 1]) + whole[201:],
    "longer": lambda whole: whole + b"\0",
}


@pytest.mark.parametrize("suffix", [".nbi", ".nbc"])
@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_a_damaged_file_is_compiled_anew_and_replaced(folder, suffix, damage):
    double()
    (path,) = folder.rglob(f"*{suffix}")
    whole = path.read_bytes()
    path.write_bytes(damage(whole))
    assert not double()[1]
    assert double()[1]
    assert not list(folder.rglob("*.tmp*"))


def test_files_that_numba_itself_wrote_are_replaced(folder):
    double()
    for path in folder.rglob("*.nb?"):
        path.write_bytes(path.read_bytes()[:-16])  # it writes no checksum
    assert not double()[1]
    assert double()[1]


@pytest.mark.parametrize("suffix", [".nbi", ".nbc"])
def test_a_folder_in_the_place_of_a_file_costs_the_cache_and_no_more(folder, suffix, caplog, monkeypatch):
    monkeypatch.setattr(kernel_compiler._State, "unsaved", False)
    double()
    (path,) = folder.rglob(f"*{suffix}")
    path.unlink()
    path.mkdir()
    assert not double()[1]
    assert not double()[1]
    assert [record.message.startswith("compiled kernels can't be kept in") for record in caplog.records].count(
        True
    ) == 1


def test_a_full_disk_costs_the_cache_and_no_more(folder, monkeypatch, caplog):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(kernel_compiler._State, "unsaved", False)
    monkeypatch.setattr("pathlib.Path.write_bytes", full)
    assert not double()[1]
    assert not double()[1]
    assert "No space left" in caplog.text
    assert not list(folder.rglob("*.tmp*"))


def test_a_full_folder_that_cannot_be_written_is_read(folder, monkeypatch):
    double()
    monkeypatch.setattr(kernel_cache, "_writable", lambda: None)
    assert double()[1]


def test_a_kernel_is_stale_when_one_that_it_imports_has_changed(monkeypatch, tmp_path):
    monkeypatch.setattr(kernel_cache, "PACKAGE", tmp_path)
    caller, called, other = (tmp_path / "room" / f"{name}_kernels.py" for name in ("caller", "called", "other"))
    caller.parent.mkdir()
    caller.write_text("from fleetmap.room.called_kernels import f\n")
    for path in (called, other):
        path.write_text("one = 1\n")

    def stamp():
        kernel_cache.stamp.cache_clear()
        kernel_cache._imports.cache_clear()
        return kernel_cache.stamp(caller)

    try:
        first = stamp()
        other.write_text("one = 2\n")
        assert stamp() == first
        called.write_text("one = 2\n")
        assert stamp() != first
    finally:
        kernel_cache.stamp.cache_clear()
        kernel_cache._imports.cache_clear()


def test_each_module_comes_after_those_that_it_imports():
    modules = with_imports(reversed(kernel_modules()))
    assert sorted(modules) == sorted(kernel_modules())
    for place, module in enumerate(modules):
        assert set(kernel_cache.imported_kernels(module)) <= set(modules[:place])


def test_a_module_is_cached_once_it_is_compiled_ahead(tmp_path):
    code = f"""
        import sys
        from fleetmap.model.kernel import cached_in
        from fleetmap.model.kernel_compiler import compile_ahead
        print(cached_in("{SMALL}"))
        compile_ahead(["{SMALL}"])
        print(cached_in("{SMALL}"))
        assert "{SMALL}" not in sys.modules
    """
    out, err = run(code, NUMBA_CACHE_DIR=str(tmp_path))
    before, after = out.splitlines()
    assert before == "None"
    assert after.startswith(str(tmp_path))
    assert err.count("\n") == 1, err
    assert "compiling kernels" in err


def test_without_a_folder_to_write_to_a_program_runs_and_says_so_once(tmp_path):
    nowhere = tmp_path / "file"
    nowhere.write_text("")
    code = f"""
        import tempfile
        tempfile.tempdir = {str(nowhere)!r}
        from fleetmap.model.kernel_compiler import compile_ahead
        compile_ahead(["{SMALL}"])
        import {SMALL}
        print("fine")
    """
    out, err = run(code, NUMBA_CACHE_DIR=str(nowhere / "cache"))
    assert out == "fine\n"
    kept, compiles = err.splitlines()
    assert "can't be kept" in kept
    assert "NUMBA_CACHE_DIR" in kept
    assert "compiling kernels" in compiles


def test_a_folder_for_the_time_stands_in_and_children_share_it(tmp_path):
    nowhere = tmp_path / "file"
    nowhere.write_text("")
    code = f"""
        import subprocess, sys
        from fleetmap.model.kernel import cached_in
        from fleetmap.model.kernel_cache import environment, is_temporary
        from fleetmap.model.kernel_compiler import compile_ahead
        compile_ahead(["{SMALL}"])
        folder = cached_in("{SMALL}")
        assert is_temporary(folder)
        child = "from fleetmap.model.kernel import cached_in; print(cached_in('{SMALL}'))"
        print(folder)
        print(subprocess.check_output([sys.executable, "-c", child], env=environment(), text=True))
    """
    out, _ = run(code, NUMBA_CACHE_DIR=str(nowhere / "cache"))
    own, childs = out.split()
    assert own == childs
    assert not Path(own).exists()


def test_an_interrupt_waits_for_the_end_of_the_block():
    steps = []

    def block():
        with interrupts_later():
            steps.append("before")
            signal.raise_signal(signal.SIGINT)
            steps.append("after")

    with pytest.raises(KeyboardInterrupt):
        block()
    assert steps == ["before", "after"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_workers_end_when_whoever_started_them_is_killed(tmp_path, timeout_factor):
    code = f"from fleetmap.model.kernel_compiler import compile_ahead; compile_ahead({list(kernel_modules())})"
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    parent = subprocess.Popen([sys.executable, "-c", code], env=environment, stderr=subprocess.PIPE, text=True)
    assert parent.stderr is not None
    with parent:
        assert "compiling kernels" in parent.stderr.readline()
        children = Path(f"/proc/{parent.pid}/task/{parent.pid}/children").read_text().split()
        parent.kill()
    for child in children:
        wait_for_end(int(child), 20.0 * timeout_factor)


def wait_for_end(pid, timeout_s):
    """Wait until a process that is no child has ended."""
    import select

    try:
        ends = os.pidfd_open(pid)
    except ProcessLookupError:
        return
    try:
        assert select.select([ends], [], [], timeout_s)[0], f"{pid} still runs"
    finally:
        os.close(ends)


def test_a_peer_loads_no_kernel_beyond_those_that_are_compiled_before_it_is_seen():
    code = """
        import asyncio, sys
        import numpy as np
        import fleetmap
        from fleetmap.peer.memory_link import LoopClock, MemoryHub

        async def main():
            hub = MemoryHub(LoopClock())
            cells = np.full((60, 60), -1, np.int8)
            async with (
                fleetmap.join("a", start=fleetmap.Pose2(), link=hub.link("a")) as a,
                fleetmap.join("b", start=fleetmap.Pose2(), link=hub.link("b")) as b,
            ):
                for size in (30, 40, 50):
                    cells[5:size, 5:50] = 0
                    cells[20, 10:30] = 100
                    await a.publish(fleetmap.OccupancyGrid(cells.copy(), 0.05))
                    assert len(await b.synced(at_least=1))

        asyncio.run(main())
        print(*(name for name in sys.modules if name.endswith("_kernels")))
    """
    out, _ = run(code)
    loaded = set(out.split())
    assert "fleetmap.merge.arrange_kernels" in loaded
    assert loaded <= set(kernel_cache.modules_of(*kernel_cache.AGENT))
