"""The next map of an epoch: only what may have changed is traced, and edges that still hold stay."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import OCCUPIED, UNKNOWN
from fleetmap.vectorize.arcs import Arcs
from fleetmap.vectorize.fresh import APART_CELLS
from fleetmap.vectorize.phase import SIXTEENTHS
from fleetmap.vectorize.store import Store

REDO_RATIO = 1.15
"""Edges beside a gap are done anew if they would be more than so many times the fewest: what stickiness may cost."""

CELL2 = SIXTEENTHS**2
"""When the phase has moved, new edges are chosen within epsilon / sqrt(2), but not within less than a cell, so that
they hold the next time, too. Boundaries are ragged by whole cells: this takes but 2 to 10 % more edges."""

WIDEN_CELLS = 32
"""By so much the window grows when a vertex outside of it is in the way; four times as much the next time."""

PATIENCE = 6
"""So often edges outside of the window are drawn in before everything is done anew."""

KNOWN_CHANGE, KNOWN_RATIO = 4, 0.3
"""A wall keeps the thickness that it is known to have until it is off by a cell (4 quarters) or 30 %: each change costs
bytes."""


@dataclass(slots=True, eq=False)
class Changes:
    """Rows (y0, x0, y1, x1, label, thickness) that an update took away, added, and gave another thickness."""

    removed: NDArray[np.int64]
    added: NDArray[np.int64]
    rethickened: NDArray[np.int64]
    redone: int = 0
    """Edges that still held but took too many vertices, so that they were done anew."""
    splits: int = 0


def refresh_states(
    grid: OccupancyGrid, store: Store, shift_yx: tuple[int, int], window: tuple[int, int, int, int], specks: int
) -> tuple[tuple[int, int, int, int] | None, tuple[int, int]]:
    """Read the cells of a window, (y0, x0, y1, x1) on the lattice, half open; returns the cells whose state changed.

    Also how many specks were filled there, and their cells.
    """
    from fleetmap.vectorize.refresh_kernels import read_changes, refresh

    oy, ox = store.low_yx
    spans = np.empty((len(store.states), 2), np.int64)
    found = read_changes(
        grid.cells_yx, shift_yx[0] - oy, shift_yx[1] - ox, store.raw,
        window[0] - oy, window[1] - ox, window[2] - oy, window[3] - ox, *grid.limits, spans,
    )  # fmt: skip
    if found == 0:
        return None, (0, 0)
    margin = 4 * specks + 2 * APART_CELLS + 1 if specks else 0
    dirty = np.empty(6, np.int64)
    changed = refresh(store.raw, store.states, spans, specks, APART_CELLS, margin, oy, ox, dirty)
    y0, x0, y1, x1, count, cells = dirty.tolist()
    return ((y0 + oy, x0 + ox, y1 + oy, x1 + ox) if changed else None), (count, cells)


def update_arcs(
    store: Store,
    dirty: tuple[int, int, int, int] | None,
    phase_yx: tuple[int, int],
    moved: bool,
    epsilon2: int,
    share: bool,
) -> Changes:
    """Trace what meets the changed cells again, keep the edges that hold, choose the others, and store all.

    Parameters
    ----------
    dirty : cells (y0, x0, y1, x1) of the lattice, half open, whose state may have changed; None: all
    phase_yx, epsilon2 : see ``build_network``
    moved : whether the phase is another one than the last time
    """
    widen = 0
    while True:
        changes = _try_update(store, dirty, widen, phase_yx, moved, epsilon2, share)
        if changes is not None:
            return changes
        if dirty is None:
            raise AssertionError("a vertex is in the way, and none is kept outside of a window that is everything")
        widen = 4 * widen if widen else WIDEN_CELLS
        if widen > 64 * WIDEN_CELLS:
            dirty = None


def _try_update(
    store: Store,
    dirty: tuple[int, int, int, int] | None,
    widen: int,
    phase_yx: tuple[int, int],
    moved: bool,
    epsilon2: int,
    share: bool,
) -> Changes | None:
    """``update_arcs`` in a window that is wider by some cells; None if a vertex outside of it is in the way."""
    from fleetmap.vectorize.cells_kernels import find_corners, find_cracks
    from fleetmap.vectorize.change_kernels import list_changes
    from fleetmap.vectorize.index_kernels import LABEL
    from fleetmap.vectorize.inverted_kernels import is_inverted, is_turned
    from fleetmap.vectorize.obstacle_kernels import NEAR_STEPS, measure_depth
    from fleetmap.vectorize.redo_kernels import redo_wasteful
    from fleetmap.vectorize.sticky_kernels import keep_edges
    from fleetmap.vectorize.store_kernels import forget, list_corners
    from fleetmap.vectorize.touched_kernels import find_foreign, gather_touched
    from fleetmap.vectorize.window_kernels import trace_window

    oy, ox = store.low_yx
    height, width = store.states.shape
    reach = int(epsilon2**0.5) // 16 + 1
    choose2 = min(epsilon2, max(epsilon2 // 2, CELL2)) if moved else epsilon2
    if dirty is None:
        y0, x0, y1, x1 = 1, 1, height - 1, width - 1
    else:
        # Points: the corners of the changed cells, and some more all around, where nothing changed, so that what is
        # small enough to be turned over lies in the window altogether.
        widen += 2 * reach - 1
        y0, x0 = max(dirty[0] - oy - widen, 1), max(dirty[1] - ox - widen, 1)
        y1, x1 = min(dirty[2] - oy + widen, height - 1), min(dirty[3] - ox + widen, width - 1)
    whole = dirty is None or (y0 == 1 and x0 == 1 and y1 == height - 1 and x1 == width - 1)
    around = NEAR_STEPS + 1 if share else 0
    room = len(store.records) + 1
    touched = np.empty(room, np.int32)
    n_inside = gather_touched(
        store.records, store.buckets, store.links, store.marks, oy, ox, y0 + oy, x0 + ox, y1 + oy, x1 + ox, reach + 1,
        share, around, touched,
    )  # fmt: skip
    n_touched = n_inside
    forced = np.empty(room, np.int32)
    n_forced = 0
    cy0, cx0 = max(y0 - around, 1), max(x0 - around, 1)
    cy1, cx1 = min(y1 + around, height - 1), min(x1 + around, width - 1)
    corners = np.empty((1 << 12, 2), np.int32)
    most = 1 << 13
    for _ in range(PATIENCE):
        # 1. Arcs.
        while True:
            find_cracks(store.states, store.cracks, y0, x0, y1 + 1, x1 + 1)
            count = find_corners(store.cracks.view(np.uint64), store.cracks, cy0, cx0, cy1 + 1, cx1 + 1, corners)
            if count < 0:
                corners = np.empty((4 * len(corners), 2), np.int32)
                continue
            units, leaves = np.empty((most, 2), np.int32), np.empty(most, np.uint8)
            offsets = np.empty(most // 4 + 1, np.int32)
            labels, closed = np.empty(most // 4, np.uint8), np.empty(most // 4, np.uint8)
            first, last = np.empty(most // 4, np.int32), np.empty(most // 4, np.int32)
            arcs, size = trace_window(
                store.states, store.cracks, store.seen, store.table, store.records, count, corners, oy, ox,
                y0, x0, y1, x1, n_forced, whole, share, forced, touched, n_touched, most // 4, units, leaves, offsets,
                labels, closed, first, last,
            )  # fmt: skip
            if arcs >= 0:
                break
            most *= 4
        n_touched = _add_firsts(store, first, arcs, touched, n_touched)

        # 2. Edges that hold.
        at, old_edge, ends = (
            np.empty((size + 1, 2), np.int32),
            np.empty(size + 1, np.int32),
            np.empty(size + 1, np.int32),
        )
        arc_of = np.repeat(np.arange(arcs, dtype=np.int32), np.diff(offsets[: arcs + 1]))
        low_y, low_x, places_height, places_width = _bounds(
            units, size, share, (y0 + oy, x0 + ox, y1 + oy, x1 + ox), labels, offsets, arcs
        )
        keep_edges(
            store.records, store.local, touched, n_touched, units, leaves, offsets, labels, closed, first, last, arcs,
            arc_of, *phase_yx, epsilon2, low_y, low_x, places_height, places_width, at, old_edge, ends,
        )  # fmt: skip
        found = Arcs(
            np.empty((size, 2), np.int32), np.empty(arcs + 1, np.int32), labels[:arcs], closed[:arcs],
            np.zeros(arcs, np.uint8), np.empty(size, np.uint8), np.column_stack([first[:arcs], last[:arcs]]).ravel(),
            np.empty(size, np.uint8), np.empty(size, np.uint8), np.empty(size, np.uint8), np.empty(size, np.int32),
            np.empty((size, 2), np.int32), np.zeros(size, np.uint8),
        )  # fmt: skip
        n = list_corners(
            units, leaves, offsets, old_edge, arcs, closed, at, ends, found.ends, store.cracks, oy, ox, found.points,
            found.offsets, found.special, found.fixed, found.stops, found.kept, found.at, found.old_of,
        )  # fmt: skip
        for name in ("points", "special", "fixed", "stops", "kept", "old_of", "at", "is_vertex"):
            setattr(found, name, getattr(found, name)[:n])
        redone = redo_wasteful(
            found.points, found.offsets, found.closed, arcs, *phase_yx, choose2, REDO_RATIO, found.fixed, found.stops,
            found.kept, found.at, found.old_of,
        )  # fmt: skip

        # 3. The others.
        splits, _ = found.build(store.cracks, (oy, ox), phase_yx, epsilon2, choose2)
        corners_of = found.points, found.offsets, found.closed
        if (
            splits < 0
            or is_inverted(
                store.records, *corners_of, found.labels, arcs, found.ends, found.at, found.is_vertex, share
            )
            or is_turned(
                store.records, store.table, store.marks, *corners_of, arcs, found.ends, found.at, found.is_vertex
            )
        ):  # fmt: skip
            store.marks[touched[:n_touched]] = 0
            return None
        edges, tails, heads, edge_arcs = found.edges()
        stays = _stays(store, found, edges, tails)
        if whole:
            break
        more = np.empty(room, np.int32)
        hit = find_foreign(
            tails, heads, edge_arcs, found.points, found.offsets, found.closed, store.records, store.buckets,
            store.links, store.marks, edges, (~stays).astype(np.uint8), len(tails), oy, ox, reach, more,
        )  # fmt: skip
        if not hit:
            break
        for record in more[:hit].tolist():
            if share and store.records[record, LABEL] == HIDDEN:
                n_touched = _touch_outline(store, record, touched, n_touched)
            else:
                forced[n_forced] = touched[n_touched] = record
                n_forced, n_touched = n_forced + 1, n_touched + 1
    else:
        store.marks[touched[:n_touched]] = 0
        return None

    # 4. Thickness, and what has changed.
    thickness = np.zeros(n, np.uint8)
    if share:
        points = found.points - np.array(store.low_yx, np.int32)
        measure_depth(store.states, points, found.offsets, found.closed, found.labels, arcs, found.thickness)
        thickness[tails] = _settle_thickness(store, found, tails, edge_arcs, stays)
    removed, added, rethickened = (np.empty((k + 1, 6), np.int64) for k in (n_touched, len(tails), len(tails)))
    counts = list_changes(
        store.records, touched, n_touched, edges, tails, edge_arcs, found.labels, thickness, len(tails), removed, added,
        rethickened,
    )  # fmt: skip
    forget(
        store.records, store.table, store.buckets, store.links, store.free_links, store.free, store.used, touched,
        n_touched, store.marks, oy, ox, y0 + oy, x0 + ox, y1 + oy, x1 + ox,
    )  # fmt: skip
    store.remember(found, thickness)
    return Changes(removed[: counts[0]], added[: counts[1]], rethickened[: counts[2]], redone, splits)


HIDDEN = 3 * OCCUPIED + UNKNOWN
"""Label of the backs of walls, and of outlines of hidden obstacles."""


def _touch_outline(store: Store, record: int, touched: NDArray[np.int32], count: int) -> int:
    """Mark and list all of an outline of hidden obstacles, which is traced as a whole; returns the new count."""
    from fleetmap.vectorize.index_kernels import NEXT

    start = record
    while True:
        if store.marks[record] == 0 or record == start:
            touched[count] = record
            count += 1
        store.marks[record] = 2
        record = int(store.records[record, NEXT])
        if record == start:
            return count


def _add_firsts(store: Store, first: NDArray[np.int32], arcs: int, touched: NDArray[np.int32], count: int) -> int:
    """Mark and list the vertices outside of the window from which arcs start; returns the new count."""
    starts = first[:arcs]
    starts = starts[starts >= 0]
    starts = starts[store.marks[starts] == 0]
    store.marks[starts] = 1
    touched[count : count + len(starts)] = starts
    return count + len(starts)


def _bounds(
    units: NDArray[np.int32],
    size: int,
    share: bool,
    window: tuple[int, int, int, int],
    labels: NDArray[np.uint8],
    offsets: NDArray[np.int32],
    arcs: int,
) -> tuple[int, int, int, int]:
    """Where old vertices may find places: the window, and all outlines of hidden obstacles; (y, x, height, width)."""
    y0, x0, y1, x1 = window
    if share:
        for arc in np.flatnonzero(labels[:arcs] == 5).tolist():
            outline = units[offsets[arc] : offsets[arc + 1]]
            y0, x0 = min(y0, int(outline[:, 0].min())), min(x0, int(outline[:, 1].min()))
            y1, x1 = max(y1, int(outline[:, 0].max())), max(x1, int(outline[:, 1].max()))
    return y0 - 1, x0 - 1, y1 - y0 + 3, x1 - x0 + 3


def _stays(store: Store, found: Arcs, edges: NDArray[np.int64], tails: NDArray[np.int32]) -> NDArray[np.bool_]:
    """(m,) which edges are old ones."""
    from fleetmap.vectorize.index_kernels import AT_X, AT_Y, NEXT

    r = found.old_of[tails]
    head = store.records[np.maximum(r, 0), NEXT]
    old = np.concatenate([store.records[r][:, [AT_Y, AT_X]], store.records[head][:, [AT_Y, AT_X]]], axis=1)
    same: NDArray[np.bool_] = (r >= 0) & (old == edges[: len(tails), :4]).all(axis=1)
    return same


def _settle_thickness(
    store: Store, found: Arcs, tails: NDArray[np.int32], arc_of: NDArray[np.int32], stays: NDArray[np.bool_]
) -> NDArray[np.uint8]:
    """(m,) the thickness of each edge: the known one of its arc, unless that is too far off what was measured."""
    from fleetmap.vectorize.index_kernels import THICK

    measured = found.thickness[arc_of].astype(np.int64)
    # An edge that stays knows; a new one takes the thickness of the last one before it on the arc that does.
    own = np.where(stays, store.records[found.old_of[tails], THICK], -1)
    index = np.where(own >= 0, np.arange(len(own)), -1)
    index = np.maximum.accumulate(index) if len(index) else index
    known = np.where(index >= 0, own[index], -1)
    known[(index < 0) | (arc_of[np.maximum(index, 0)] != arc_of)] = -1
    close = (known >= 0) & (np.abs(known - measured) < np.maximum(KNOWN_CHANGE, KNOWN_RATIO * known))
    return np.where(close, known, measured).astype(np.uint8)
