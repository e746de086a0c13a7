"""What one map takes under each codec: bytes, times, and what is lost."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.vectormap import VectorMap

METRICS = ("MS", "CC", "PC", "OPDF", "UPDF")

VECTORS = {"vector": ("share", 12), "vector_specks": ("share", 0), "vector_full": ("full", 12)}
"""Our own rows: the profile, and the largest speck in cells that is dropped."""

REFERENCE = "gzip9"

ENOUGH_S = 0.3
"""A codec is run again until it took so long in all, at most five times; the median counts."""

LONG_S = 3.0
"""A codec that takes longer is run once: what a first run takes beside the work is little then."""

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Row:
    """One codec on one map.

    Parameters
    ----------
    codec : its name
    holds : ``cells`` (-1 to 100), ``states`` (three), or ``vector``
    size_bytes, encode_ms, decode_ms : of one message; CPU time
    epsilon_cells : the bound of what is lost; None if nothing is
    metrics : per cent, of what comes back against the grid; None if that is the grid itself
    same_content_bytes : the best grid codec for the same content: for a lossy row, for the grid that is drawn of it
    """

    codec: str
    holds: str
    size_bytes: int
    encode_ms: float
    decode_ms: float
    epsilon_cells: float | None
    metrics: dict[str, float] | None
    same_content_bytes: int


def measure_map(path: Path, grid: OccupancyGrid, on_codec: Callable[[str], object] = lambda _: None) -> dict[str, Any]:
    """All rows of a map, as `fleetmap stats --json` has them.

    Parameters
    ----------
    on_codec : told the name of each codec before it runs, for progress
    """
    from fleetmap.codecs.baselines import GRID_BASELINES, available, unavailable
    from fleetmap.vectorize import vectorize

    on_codec("kernels")
    warm_up()
    rows = [Row("raw", "cells", int(grid.cells_yx.size), 0.0, 0.0, None, None, 0)]
    for name, codec in GRID_BASELINES.items():
        if available(codec):
            on_codec(name)
            data, encode_ms = timed(lambda c=codec: c.encode(grid))  # type: ignore[misc]
            _, decode_ms = timed(lambda c=codec, d=data: c.decode(d))  # type: ignore[misc]
            rows.append(Row(name, codec.keeps, len(data), encode_ms, decode_ms, None, None, 0))
    on_codec("exact")
    states = grid.states_yx()
    data, encode_ms, decode_ms = exact(states)
    rows.append(Row("exact", "states", len(data), encode_ms, decode_ms, None, None, 0))
    best = min(row.size_bytes for row in rows)
    rows = [Row(**{**asdict(row), "same_content_bytes": best}) for row in rows]

    edges = {}
    for name, (profile, specks) in VECTORS.items():
        on_codec(name)
        vector_map = vectorize(grid, profile=profile, specks=specks)
        on_codec(f"{name}, encoded, drawn and compared")
        edges[name] = len(vector_map)
        own = own_row(name, vector_map, grid)
        rows.append(own)
        if name == "vector":
            rows += other_formats(own, vector_map, on_codec)
    reference = next(row.size_bytes for row in rows if row.codec == REFERENCE)
    return {
        "map": str(path),
        "width": grid.width,
        "height": grid.height,
        "resolution_m": grid.resolution_m,
        "edges": edges,
        "codecs": {row.codec: row.size_bytes for row in rows},
        "ratios": {row.codec: reference / row.size_bytes for row in rows},
        "ratios_same_content": {row.codec: row.same_content_bytes / row.size_bytes for row in rows},
        "metrics": {row.codec: row.metrics for row in rows if row.metrics is not None},
        "rows": [asdict(row) for row in rows],
        "unavailable": unavailable(),
    }


def exact(states_yx: NDArray[np.uint8]) -> tuple[bytes, float, float]:
    """The exact layer of a grid, and how long it takes to write and to read; of a large grid, its parts together."""
    from fleetmap.codecs.context_grid import decode_states, encode_states, split

    parts, encode_ms = timed(lambda: [encode_states(states_yx[part]) for part in split(states_yx.shape)])
    _, decode_ms = timed(lambda: [decode_states(data) for data in parts])
    return b"".join(parts), encode_ms, decode_ms


def own_row(name: str, vector_map: VectorMap, grid: OccupancyGrid) -> Row:
    """A snapshot of a vector map, and how like the grid it is."""
    from fleetmap.codecs.context_grid import encode_states, split
    from fleetmap.codecs.protocol import decode, encode_snapshot
    from fleetmap.model.delta import apply
    from fleetmap.model.metrics import compare
    from fleetmap.vectorize import rasterize

    empty = VectorMap.empty(vector_map.lattice, epsilon_cells=vector_map.epsilon_cells, profile=vector_map.profile)
    data, encode_ms = timed(lambda: encode_snapshot(vector_map))
    _, decode_ms = timed(lambda: apply(empty, decode(data, empty, robot=name)))
    drawn = rasterize(vector_map, like=grid)
    found = compare(drawn, grid)
    metrics = {metric: float(getattr(found, metric)) for metric in METRICS}
    states = drawn.states_yx()
    same = sum(len(encode_states(states[part])) for part in split(states.shape))
    return Row(name, "vector", len(data), encode_ms, decode_ms, vector_map.epsilon_cells, metrics, same)


def other_formats(own: Row, vector_map: VectorMap, on_codec: Callable[[str], object]) -> list[Row]:
    """The lines of the same map in the formats of others."""
    from fleetmap.codecs.baselines import VECTOR_BASELINES, available

    rows = []
    for name, codec in VECTOR_BASELINES.items():
        if available(codec):
            on_codec(name)
            data, encode_ms = timed(lambda c=codec: c.encode(vector_map))  # type: ignore[misc]
            _, decode_ms = timed(lambda c=codec, d=data: c.decode(d))  # type: ignore[misc]
            changed = {"codec": name, "size_bytes": len(data), "encode_ms": encode_ms, "decode_ms": decode_ms}
            rows.append(Row(**{**asdict(own), **changed}))
    return rows


def warm_up() -> None:
    """Load the kernels of our own rows, and compile them if nobody has: not what a codec takes."""
    from fleetmap.vectorize import vectorize

    cells = np.full((24, 24), -1, np.int8)
    cells[4:20, 4:20] = 100
    cells[6:18, 6:18] = 0
    grid = OccupancyGrid(cells, 0.05)
    exact(grid.states_yx())
    for name, (profile, specks) in VECTORS.items():
        own_row(name, vectorize(grid, profile=profile, specks=specks), grid)


def timed(work: Callable[[], T]) -> tuple[T, float]:
    """The result, and the median CPU time in milliseconds; of one that takes long, that of the only run."""
    times: list[float] = []
    while len(times) < 5 and sum(times) < ENOUGH_S:
        started = time.process_time()
        result = work()
        times.append(time.process_time() - started)
    if len(times) == 1 and times[0] < LONG_S:
        started = time.process_time()
        result = work()
        times = [min(times[0], time.process_time() - started)]  # the first one may have loaded something
    return result, 1e3 * statistics.median(times)
