"""``fleetmap warmup``: compile every kernel once, so that no robot has to."""

from __future__ import annotations

import os
import time

import typer

from fleetmap.cli.output import AsJson, print_json, stderr


def warmup(as_json: AsJson = False) -> None:
    """Compile all numba kernels into the cache, on all cores, and say where it is.

    Takes a minute or two once after an installation, and a second or two after that. What is cut or stale in the
    cache is replaced. Without a writable cache folder each process compiles for itself: the command says so and
    exits with 1; set NUMBA_CACHE_DIR to a folder that can be written. From a full folder kernels are read whether
    or not it can be written.

    Example:  fleetmap warmup
    """
    from fleetmap.model.kernel import cached_in
    from fleetmap.model.kernel_cache import is_temporary, kernel_modules
    from fleetmap.model.kernel_compiler import compile_ahead

    started = time.perf_counter()
    names = kernel_modules()
    compile_ahead(names)
    folders = [folder for name in names if (folder := cached_in(name)) is not None and not is_temporary(folder)]
    cached = len(folders) == len(names)
    cache = os.path.commonpath(folders) if cached else None
    seconds = time.perf_counter() - started
    if as_json:
        print_json({"modules": list(names), "duration_s": seconds, "cache": cache, "cached": cached})
    elif cached:
        typer.echo(f"{len(names)} kernel modules ready in {seconds:.1f} s; cache: {cache}")
    else:
        stderr.print(f"{len(names)} kernel modules compiled in {seconds:.1f} s, but no cache folder can be written:")
        stderr.print("each process will compile again. Set NUMBA_CACHE_DIR to a folder that can be written.")
    if not cached:
        raise typer.Exit(1)
