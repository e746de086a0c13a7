"""``fleetmap warmup``: compile every kernel once, so that no robot has to."""

from __future__ import annotations

import time

from fleetmap.cli.output import AsJson, print_json, stderr


def warmup(as_json: AsJson = False) -> None:
    """Compile all numba kernels into the cache, and say where it is.

    Takes a minute or so once after an installation, and next to nothing after that. Without a writable
    cache folder each process compiles for itself: the command says so and exits with 1; set
    NUMBA_CACHE_DIR to a folder that can be written.

    Example:  fleetmap warmup
    """
    import typer

    from fleetmap.model.kernel_cache import cache_folder, kernel_modules, load_kernels

    started = time.perf_counter()
    names = kernel_modules()
    with stderr.status("compiling") as status:
        for name in load_kernels():
            status.update(f"compiling {name}")
    folder = cache_folder()
    seconds = time.perf_counter() - started
    if as_json:
        print_json({"modules": names, "duration_s": seconds, "cache": folder, "cached": folder is not None})
    elif folder is None:
        stderr.print(f"{len(names)} kernel modules compiled in {seconds:.1f} s, but no cache folder can be written:")
        stderr.print("each process will compile again. Set NUMBA_CACHE_DIR to a folder that can be written.")
    else:
        typer.echo(f"{len(names)} kernel modules ready in {seconds:.1f} s; cache: {folder}")
    if folder is None:
        raise typer.Exit(1)
