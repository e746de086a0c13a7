"""Mode 1: the numbers of a delta or a snapshot through a range coder that knows from the start what they look like.

Deflate pays for its tables in each message, and a delta is hardly longer than they are. Here the tables are part of
the format (``mode1_start``). The same kernels write and read; ``docs/format.md`` is their page.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.codecs.fields import DeltaFields
from fleetmap.codecs.mode1_layout import CONTEXTS
from fleetmap.codecs.mode1_start import DELTA, SNAPSHOT
from fleetmap.codecs.range_coder import check, start_memory
from fleetmap.model.errors import ConfigError
from fleetmap.model.vectormap import VectorMap

MODE = 1
THICK_FRONTIERS = 0x20
"""Flag: the thickness of frontiers is written too; without it they have none."""

MAX_ITEMS, ITEMS, ITEMS_PER_BYTE = 1 << 18, 1024, 256
"""An item is a window, an edge of the base in it, an endpoint or root, an added or a rethickened edge. A payload may
hold 1024 of them and 256 more for each of its bytes, at most 2^18: what hostile bytes can cost."""

MAX_EDGES, EDGES, EDGES_PER_BYTE = 1 << 17, 64, 16
"""The same for the removed, the added, the rethickened edges and the roots, each by themselves."""

MAX_PASSED = 1 << 18
"""Most edges of the base in the bands of all windows: they are copied, 1 ms at the most."""

MAX_BYTES = 1 << 19
"""Most bytes behind the first one."""

if {len(table) for pair in (DELTA, SNAPSHOT) for table in pair} != {CONTEXTS}:
    # Kernels check no bounds.
    raise ImportError(f"the tables in mode1_start.py are not for {CONTEXTS} contexts")
_DELTA, _SNAPSHOT = start_memory(*DELTA), start_memory(*SNAPSHOT)


def encode(fields: DeltaFields, base: VectorMap) -> bytes:
    """The numbers of a delta as bytes; the first one is the mode and its flags.

    Raises
    ------
    ConfigError : the delta is too large for this mode
    """
    from fleetmap.codecs import range_kernels as coding

    parts = (fields.removed, fields.known_roots, fields.absolute_roots, fields.edges, fields.rethickened)
    largest = max(map(len, parts))
    if largest > MAX_EDGES:
        raise _too_large(largest)
    data = np.empty(min(MAX_BYTES, 64 + 16 * sum(map(len, parts))), np.uint8)
    coder = np.array([coding.WRITE, 0, 0, 0, 0, 0, MAX_ITEMS, MAX_EDGES])
    coding.begin(coder, data)
    try:
        _code_known(coder, _memory(base), data, fields, base)
    except ValueError:  # from _block
        raise _too_large(largest) from None
    coding.finish_writing(coder, data)
    size = int(coder[coding.AT])
    most_items, most_edges = _most(1 + size)
    if coder[coding.STATUS] or coder[coding.ITEMS] > most_items or largest > most_edges:
        raise _too_large(largest)
    return bytes([MODE | (THICK_FRONTIERS if fields.thick_frontiers else 0)]) + data[:size].tobytes()


def count_decisions(fields: DeltaFields, base: VectorMap, counts: NDArray[np.int64]) -> None:
    """Add the decisions of a delta to ``counts``, (CONTEXTS,), see ``range_coder.count_memory``."""
    from fleetmap.codecs.range_kernels import COUNT

    coder = np.array([COUNT, 0, 0, 0, 0, 0, MAX_ITEMS, MAX_EDGES])
    _code_known(coder, counts, np.empty(0, np.uint8), fields, base)


def decode(payload: bytes, base: VectorMap) -> DeltaFields:
    """The numbers in a payload.

    Raises
    ------
    ValueError : anything about the bytes is not as it must be
    """
    from fleetmap.codecs.growth_kernels import code_rethickened, code_walks
    from fleetmap.codecs.range_kernels import READ, begin, finish_reading
    from fleetmap.codecs.removal_kernels import MAX_WINDOWS, REMOVED, code_removed, code_windows

    if payload[0] & ~(MODE | THICK_FRONTIERS):
        raise ValueError(f"unknown flags {payload[0]:#x}")
    if len(payload) > 1 + MAX_BYTES:
        raise ValueError(f"longer than {1 + MAX_BYTES} B")
    thick_frontiers = bool(payload[0] & THICK_FRONTIERS)
    most_items, most_edges = _most(len(payload))
    data = np.frombuffer(bytearray(payload), np.uint8)[1:]
    coder = np.array([READ, 0, 0, 0, 0, 0, most_items, most_edges])
    memory = _memory(base)
    begin(coder, data)
    windows = np.zeros((MAX_WINDOWS, 5), np.int64)
    n_windows = code_windows(coder, memory, data, windows, 0, len(base.bands.numbers))
    check(coder)
    windows = windows[:n_windows]
    n_removed = int(windows[:, REMOVED].sum())
    removed, removed_rows = np.empty(n_removed, np.int64), np.empty((n_removed, 5), np.int32)
    block, spans = _block(windows, base)
    thickness = np.empty(n_removed, np.int64)
    code_removed(coder, memory, data, block, windows, spans, removed, removed_rows, thickness)
    known, roots = np.zeros(most_edges, np.int64), np.zeros((most_edges, 2), np.int64)
    edges, rethickened = np.zeros((most_edges, 5), np.int64), np.zeros((most_edges, 2), np.int64)
    counts = np.zeros(4, np.int64)
    check(coder)
    code_walks(coder, memory, data, removed_rows, thickness, known, roots, edges, counts, thick_frontiers)
    first = int(removed[0]) if n_removed else 0
    code_rethickened(coder, memory, data, rethickened, counts, first, len(base))
    finish_reading(coder, data)
    check(coder)
    n_known, n_roots, n_edges, n_rethickened = counts.tolist()
    return DeltaFields(
        removed,
        known[:n_known],
        np.diff(roots[:n_roots], axis=0, prepend=_origin(removed_rows)),
        edges[:n_edges],
        rethickened[:n_rethickened],
        thick_frontiers,
        removed_rows,
    )


def _code_known(
    coder: NDArray[np.int64],
    memory: NDArray[np.int64],
    data: NDArray[np.uint8],
    fields: DeltaFields,
    base: VectorMap,
) -> None:
    """Write the fields, or count their decisions."""
    from fleetmap.codecs.growth_kernels import code_rethickened, code_walks
    from fleetmap.codecs.removal_kernels import MAX_WINDOWS, choose_windows, code_removed, code_windows

    windows = np.zeros((MAX_WINDOWS, 5), np.int64)
    removed = fields.removed_rows
    bands = base.bands
    numbers = bands.touched(removed)
    count = choose_windows(removed, numbers, np.array(bands.places(numbers), np.int64), windows)
    code_windows(coder, memory, data, windows, count, len(bands.numbers))
    windows = windows[:count]
    block, spans = _block(windows, base)
    thickness = np.empty(len(removed), np.int64)
    code_removed(coder, memory, data, block, windows, spans, fields.removed, removed, thickness)
    counts = np.array([len(fields.known_roots), len(fields.absolute_roots), len(fields.edges), len(fields.rethickened)])
    code_walks(
        coder,
        memory,
        data,
        removed,
        thickness,
        fields.known_roots,
        _origin(removed) + np.cumsum(fields.absolute_roots, axis=0),
        fields.edges.copy(),
        counts,
        fields.thick_frontiers,
    )
    first = int(fields.removed[0]) if len(removed) else 0
    code_rethickened(coder, memory, data, fields.rethickened, counts, first, len(base))


def _memory(base: VectorMap) -> NDArray[np.int64]:
    """What the contexts know at the start: of snapshots, or of deltas."""
    return (_DELTA if len(base) else _SNAPSHOT).copy()


def _origin(removed: NDArray[np.int32]) -> NDArray[np.int64]:
    """(1, 2) from where absolute roots are told."""
    return removed[:1, :2].astype(np.int64) if len(removed) else np.zeros((1, 2), np.int64)


def _block(windows: NDArray[np.int64], base: VectorMap) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """(n, 6) the rows of all windows' bands, and for each window, (w, 3): its first and last row + 1, and a place."""
    starts = base.bands.starts
    places: list[int] = []
    spans: list[tuple[int, int, int]] = []
    end = 0
    for first, count, _, _, _ in windows.tolist():
        start, end = end, end + starts[first + count] - starts[first]
        places += range(first, first + count)
        spans.append((start, end, starts[first]))
        if end > MAX_PASSED:
            raise ValueError(f"the windows lie in bands of more than {MAX_PASSED} edges")
    return base.bands.gather(places), np.array(spans, np.int64).reshape(-1, 3)


def _most(size_bytes: int) -> tuple[int, int]:
    """How many items and edges a payload may hold."""
    return min(MAX_ITEMS, ITEMS + ITEMS_PER_BYTE * size_bytes), min(MAX_EDGES, EDGES + EDGES_PER_BYTE * size_bytes)


def _too_large(edges: int) -> ConfigError:
    return ConfigError(option="mode", value=MODE, reason=f"a delta of {edges} edges is for mode 0")


__all__ = ["MODE", "decode", "encode"]
