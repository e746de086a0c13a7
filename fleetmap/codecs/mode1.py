"""Mode 1: the numbers of a small delta through a range coder that knows from the start what deltas look like.

Deflate pays for its tables in each message, and a delta is hardly longer than they are. Here the tables are part of
the format (``mode1_start``). The same kernels write and read; ``docs/format.md`` is their page.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.codecs.fields import DeltaFields
from fleetmap.codecs.mode1_layout import CONTEXTS
from fleetmap.codecs.mode1_start import START
from fleetmap.codecs.range_coder import REASONS, check, start_probabilities
from fleetmap.model.errors import ConfigError
from fleetmap.model.vectormap import VectorMap

MODE = 1
THICK_FRONTIERS = 0x20
"""Flag: the thickness of frontiers is written too; without it they have none."""

MAX_ITEMS, ITEMS, ITEMS_PER_BYTE = 1 << 14, 1024, 256
"""An item is a window, an edge of the base in it, an endpoint or root, an added or a rethickened edge. A payload may
hold 1024 of them and 256 more for each of its bytes, at most 2^14: what hostile bytes can cost, 1 ms."""

MAX_EDGES, EDGES, EDGES_PER_BYTE = 2048, 64, 16
"""The same for the removed, the added, the rethickened edges and the roots, each by themselves."""

MAX_PASSED = 1 << 18
"""Most edges of the base in the bands of all windows: they are copied, 1 ms at the most."""

MAX_BYTES = 1 << 14
"""Most bytes behind the first one: a longer payload is better off with deflate."""

_PROBABILITIES = start_probabilities(START)
if len(_PROBABILITIES) != CONTEXTS:
    # Kernels check no bounds.
    raise ImportError(f"mode1_start.py holds {len(_PROBABILITIES)} start probabilities; expected {CONTEXTS}")


def encode(fields: DeltaFields, base: VectorMap) -> bytes:
    """The numbers of a delta as bytes; the first one is the mode and its flags.

    Raises
    ------
    ConfigError : the delta is too large for this mode
    """
    from fleetmap.codecs import range_kernels as coding

    largest = max(map(len, (fields.removed, fields.known_roots, fields.absolute_roots, fields.edges)))
    data = np.empty(MAX_BYTES, np.uint8)
    coder = np.array([coding.WRITE, 0, 0, 0, 0, 0, MAX_ITEMS, MAX_EDGES])
    coding.begin(coder, data)
    if max(largest, len(fields.rethickened)) > MAX_EDGES:
        raise _too_large(largest)
    try:
        _code_known(coder, _PROBABILITIES.copy(), data, fields, base)
    except ValueError:  # from _block
        raise _too_large(largest) from None
    coding.finish_writing(coder, data)
    size = int(coder[coding.AT])
    most_items, most_edges = _most(1 + size)
    if coder[coding.STATUS] or coder[coding.ITEMS] > most_items or max(largest, len(fields.rethickened)) > most_edges:
        raise _too_large(largest)
    return bytes([MODE | (THICK_FRONTIERS if fields.thick_frontiers else 0)]) + data[:size].tobytes()


def count_decisions(fields: DeltaFields, base: VectorMap, counts: NDArray[np.int64]) -> None:
    """Add the decisions of a delta to ``counts``, (CONTEXTS, 2): the start table is made of them."""
    from fleetmap.codecs.range_kernels import COUNT

    coder = np.array([COUNT, 0, 0, 0, 0, 0, MAX_ITEMS, MAX_EDGES])
    _code_known(coder, counts.reshape(-1), np.empty(0, np.uint8), fields, base)


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
    probabilities = _PROBABILITIES.copy()
    begin(coder, data)
    windows = np.zeros((MAX_WINDOWS, 5), np.int64)
    n_windows = code_windows(coder, probabilities, data, windows, 0, len(base.bands.numbers))
    check(coder)
    windows = windows[:n_windows]
    n_removed = int(windows[:, REMOVED].sum())
    removed, removed_rows = np.empty(n_removed, np.int64), np.empty((n_removed, 5), np.int32)
    block, spans = _block(windows, base)
    code_removed(coder, probabilities, data, block, windows, spans, removed, removed_rows)
    known, absolute = np.zeros(most_edges, np.int64), np.zeros((most_edges, 2), np.int64)
    edges, rethickened = np.zeros((most_edges, 5), np.int64), np.zeros((most_edges, 2), np.int64)
    counts = np.zeros(4, np.int64)
    check(coder)
    code_walks(coder, probabilities, data, removed_rows, known, absolute, edges, counts, thick_frontiers)
    first = int(removed[0]) if n_removed else 0
    code_rethickened(coder, probabilities, data, rethickened, counts, first, len(base))
    finish_reading(coder, data)
    check(coder)
    n_known, n_absolute, n_edges, n_rethickened = counts.tolist()
    return DeltaFields(
        removed,
        known[:n_known],
        absolute[:n_absolute],
        edges[:n_edges],
        rethickened[:n_rethickened],
        thick_frontiers,
        removed_rows,
    )


def _code_known(
    coder: NDArray[np.int64],
    probabilities: NDArray[np.int64],
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
    code_windows(coder, probabilities, data, windows, count, len(bands.numbers))
    windows = windows[:count]
    block, spans = _block(windows, base)
    code_removed(coder, probabilities, data, block, windows, spans, fields.removed, removed)
    counts = np.array([len(fields.known_roots), len(fields.absolute_roots), len(fields.edges), len(fields.rethickened)])
    code_walks(
        coder,
        probabilities,
        data,
        removed,
        fields.known_roots,
        fields.absolute_roots,
        fields.edges,
        counts,
        fields.thick_frontiers,
    )
    first = int(fields.removed[0]) if len(removed) else 0
    code_rethickened(coder, probabilities, data, fields.rethickened, counts, first, len(base))


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


__all__ = ["MODE", "REASONS", "decode", "encode"]
