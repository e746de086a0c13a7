"""Mode 2: a whole map whose edges form closed walks, as the boundary of free space does, through the range coder.

Each edge is told by its turn against the one before and by its length, in contexts that know from the start what walls
look like (``mode2_start``), and the last edge of a walk is free. Everything else goes in the other modes. The same
kernel writes and reads; ``docs/format.md`` is its page.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.codecs.fields import DeltaFields
from fleetmap.codecs.mode2_layout import CONTEXTS
from fleetmap.codecs.mode2_start import SEEN, START
from fleetmap.codecs.range_coder import check
from fleetmap.model.errors import ConfigError
from fleetmap.model.vectormap import VectorMap

MODE = 2

MAX_ITEMS, ITEMS, ITEMS_PER_BYTE = 1 << 18, 1024, 256
"""An item is a walk or an edge. A payload may hold 1024 of them and 256 more for each of its bytes, at most 2^18."""

MAX_EDGES, EDGES, EDGES_PER_BYTE = 1 << 17, 64, 16
"""The same for the edges by themselves, and for the walks: so many take 7 MB, and half a microsecond each."""

MAX_BYTES = 1 << 19
"""Most bytes behind the first one."""

if len(START) != CONTEXTS or len(SEEN) != CONTEXTS:
    # Kernels check no bounds.
    raise ImportError(f"mode2_start.py holds {len(START)} start probabilities; expected {CONTEXTS}")


def encode(fields: DeltaFields, base: VectorMap) -> bytes:
    """The numbers of a snapshot as bytes.

    Raises
    ------
    ConfigError : it is no snapshot, its walks aren't closed, a frontier has a thickness, or it is too large
    """
    from fleetmap.codecs import range_kernels as coding
    from fleetmap.codecs.loop_kernels import code_loops

    if not fits(fields, base):
        raise ConfigError(option="mode", value=MODE, reason="this mode is for whole maps of closed walks")
    data = np.empty(min(MAX_BYTES, 64 + 16 * len(fields.edges)), np.uint8)
    coder = np.array([coding.WRITE, 0, 0, 0, 0, 0, MAX_ITEMS, MAX_EDGES])
    coding.begin(coder, data)
    roots = np.cumsum(fields.absolute_roots, axis=0)
    code_loops(coder, _memory(), data, roots, fields.edges.copy(), np.array([len(roots), len(fields.edges)]))
    coding.finish_writing(coder, data)
    size = int(coder[coding.AT])
    most_items, most_edges = _most(1 + size)
    if coder[coding.STATUS] or coder[coding.ITEMS] > most_items or len(fields.edges) > most_edges:
        raise ConfigError(option="mode", value=MODE, reason=f"a map of {len(fields.edges)} edges is for mode 0")
    return bytes([MODE]) + data[:size].tobytes()


def fits(fields: DeltaFields, base: VectorMap) -> bool:
    """Whether this is the snapshot of a map whose walks all end where they began."""
    if len(base) or len(fields.rethickened) or len(fields.known_roots) or fields.thick_frontiers:
        return False
    starts = np.flatnonzero(fields.edges[:, 3])
    return len(starts) == 0 or not np.add.reduceat(fields.edges[:, :2], starts, axis=0).any()


def count_decisions(fields: DeltaFields, counts: NDArray[np.int64]) -> None:
    """Add the decisions of a snapshot to ``counts``, (CONTEXTS, 2): the start table is made of them."""
    from fleetmap.codecs.loop_kernels import code_loops
    from fleetmap.codecs.range_kernels import COUNT

    coder = np.array([COUNT, 0, 0, 0, 0, 0, MAX_ITEMS, MAX_EDGES])
    roots = np.cumsum(fields.absolute_roots, axis=0)
    sizes = np.array([len(roots), len(fields.edges)])
    code_loops(coder, counts, np.empty(0, np.uint8), roots, fields.edges.copy(), sizes)


def decode(payload: bytes, base: VectorMap) -> DeltaFields:
    """The numbers in a payload.

    Raises
    ------
    ValueError : anything about the bytes is not as it must be
    """
    from fleetmap.codecs.loop_kernels import code_loops
    from fleetmap.codecs.range_kernels import READ, begin, finish_reading

    if payload[0] != MODE:
        raise ValueError(f"unknown flags {payload[0]:#x}")
    if len(payload) > 1 + MAX_BYTES:
        raise ValueError(f"longer than {1 + MAX_BYTES} B")
    if len(base):
        raise ValueError("the base is not empty")
    most_items, most_edges = _most(len(payload))
    data = np.frombuffer(bytearray(payload), np.uint8)[1:]
    coder = np.array([READ, 0, 0, 0, 0, 0, most_items, most_edges])
    begin(coder, data)
    check(coder)
    roots, edges = np.zeros((most_edges, 2), np.int64), np.zeros((most_edges, 5), np.int64)
    counts = np.zeros(2, np.int64)
    code_loops(coder, _memory(), data, roots, edges, counts)
    finish_reading(coder, data)
    check(coder)
    n_roots, n_edges = counts.tolist()
    none = np.zeros(0, np.int64)
    steps = np.diff(roots[:n_roots], axis=0, prepend=np.zeros((1, 2), np.int64))
    return DeltaFields(none, none, steps, edges[:n_edges], none.reshape(0, 2), False, np.zeros((0, 5), np.int32))


def _memory() -> NDArray[np.int64]:
    """(CONTEXTS, 3) what the contexts know at the start."""
    chance = np.frombuffer(START, np.uint8).astype(np.int64) * 256 + 128
    return np.column_stack([chance, chance, np.frombuffer(SEEN, np.uint8).astype(np.int64)])


def _most(size_bytes: int) -> tuple[int, int]:
    """How many items and edges a payload may hold."""
    return min(MAX_ITEMS, ITEMS + ITEMS_PER_BYTE * size_bytes), min(MAX_EDGES, EDGES + EDGES_PER_BYTE * size_bytes)


__all__ = ["MODE", "decode", "encode"]
