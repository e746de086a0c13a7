"""One tile, step by step: from the states of its cells, and the edges that it had, to the edges that it has."""

from __future__ import annotations

import numpy as np

from fleetmap.model.kernel import kernel
from fleetmap.model.kernel_types import Bytes, Image, Ints, Points, Rows
from fleetmap.vectorize.conflict_kernels import go_around
from fleetmap.vectorize.edge_kernels import EDGE_COLUMNS, list_edges
from fleetmap.vectorize.network_kernels import build_network, farthest_corner
from fleetmap.vectorize.simplify_kernels import simplify_arcs
from fleetmap.vectorize.tiles.boundary_kernels import Boundary, Tile, trace
from fleetmap.vectorize.tiles.keep_kernels import HEAD_X, HEAD_Y, LABEL, TAIL_X, TAIL_Y, Chain, keep
from fleetmap.vectorize.tiles.nodes_kernels import Rules, is_at_border, is_node, place_nodes
from fleetmap.vectorize.tiles.states_kernels import Mosaic, cut_out
from fleetmap.vectorize.tiles.thickness_kernels import settle_thickness

HALO = 52
"""Cells around a tile that it looks at: walls are measured 48 cells deep."""

PATIENCE = 4
"""So often it is tried to find edges that are all found again when they are looked for."""

ATTEMPTS = 3
"""So often edges of a wasteful arc are given up: next to what is new, and at last all of them."""

HISTORY = 1.15
"""An arc whose edges, with those that are kept, are more than so many times the fewest, and one, is done anew."""


@kernel
def junctions_of(old: Rows, size: int) -> Points:
    """Where within a tile old edges met otherwise than one behind the other."""
    degrees = np.zeros((size + 1, size + 1, 2), np.uint8)
    labels = np.zeros((size + 1, size + 1), np.uint8)
    odd = np.zeros((size + 1, size + 1), np.uint8)
    for k in range(len(old)):
        for side in range(2):
            y, x = old[k, 2 * side], old[k, 2 * side + 1]
            degrees[y, x, side] += 1
            if labels[y, x] and labels[y, x] != old[k, LABEL]:
                odd[y, x] = 1
            labels[y, x] = old[k, LABEL]
    found = np.empty((2 * len(old), 2), np.int32)
    count = 0
    for k in range(len(old)):
        for side in range(2):
            y, x = old[k, 2 * side], old[k, 2 * side + 1]
            if is_at_border(y, x, size):
                continue
            if odd[y, x] or degrees[y, x, 0] != 1 or degrees[y, x, 1] != 1:
                odd[y, x] = 0
                degrees[y, x, 0] = degrees[y, x, 1] = 1
                found[count, 0], found[count, 1] = y, x
                count += 1
    return found[:count]


@kernel
def count_edges(boundary: Boundary, chain: Chain, is_vertex: Bytes, arc: int) -> int:
    """How many edges an arc has."""
    start, end = chain.offsets[arc], chain.offsets[arc + 1]
    return np.int64(is_vertex[start:end].sum()) - (not boundary.closed[arc])


@kernel
def fence_in(boundary: Boundary, rules: Rules, size: int) -> tuple[Image, int]:
    """The cracks of all points from ``low`` on each way, the second result; outside of the tile, all four everywhere.

    A vertex that isn't on its own boundary stands where there are none: so in its tile, and on no border.
    """
    rim = int(np.sqrt(float(rules.epsilon2))) // 16 + 8
    fence = np.full((size + 2 * rim, size + 2 * rim), 15, np.uint8)
    inner = fence[rim : rim + size, rim : rim + size]
    inner[:] = boundary.cracks[1 : size + 1, 1 : size + 1]
    for k in range(size):
        inner[0, k] = inner[0, k] if inner[0, k] & 15 else np.uint8(15)
        inner[k, 0] = inner[k, 0] if inner[k, 0] & 15 else np.uint8(15)
    return fence, -rim


@kernel
def split(boundary: Boundary, chain: Chain, stops: Bytes, k: int, tail: int, head: int, arc: int, edges: Rows) -> bool:
    """Make a stop of the corner that is farthest from edge k, or else put its ends onto the boundary.

    Whether anything was left to do.
    """
    chain.kept[tail] = 0
    chain.old[tail] = -1
    m = farthest_corner(chain.points, chain.offsets[arc], chain.offsets[arc + 1], tail, head, edges, k)
    if m >= 0:
        stops[m] = 1
        chain.at[m] = chain.points[m]
        return True
    found = False
    for m in (tail, head):
        is_end = not boundary.closed[arc] and (m == chain.offsets[arc] or m == chain.offsets[arc + 1] - 1)
        if not is_end and not (stops[m] and (chain.at[m] == chain.points[m]).all()):
            stops[m] = 1
            chain.at[m] = chain.points[m]
            found = True
    return found


@kernel
def mend_borders(boundary: Boundary, chain: Chain, at: Points, is_vertex: Bytes, stops: Bytes, size: int) -> bool:
    """Split edges that lie on a border of another tile, or around a node in another order than their cracks.

    The cracks of other tiles, which end there, are among them. Whether any edge was split.
    """
    arcs = len(boundary.labels)
    most = int(is_vertex.sum()) + 1
    tails, heads, arc_of = np.empty(most, np.int32), np.empty(most, np.int32), np.empty(most, np.int32)
    edges = np.empty((most, EDGE_COLUMNS), np.int64)
    count = list_edges(chain.points, chain.offsets, boundary.closed, arcs, at, is_vertex, tails, heads, arc_of, edges)
    found = False
    for k in range(count):
        if (edges[k, 0] == size and edges[k, 2] == size) or (edges[k, 1] == size and edges[k, 3] == size):
            found |= split(boundary, chain, stops, k, tails[k], heads[k], arc_of[k], edges)
    # Edges at a point of the lower or left border where another tile's cracks end: two at least are needed.
    owner = np.empty(8, np.int64)
    crack, away = np.empty(8, np.int64), np.empty((8, 2), np.int64)
    for e in range(2 * count):
        y, x = edges[e // 2, 4 + 2 * (e & 1)], edges[e // 2, 5 + 2 * (e & 1)]
        if (y != 0 and x != 0) or not is_node(boundary, y, x, size) or y == size or x == size:
            continue
        n = 0
        for other in range(2 * count):
            k, side = other // 2, other & 1
            if edges[k, 4 + 2 * side] == y and edges[k, 5 + 2 * side] == x and n < 6:
                owner[n] = k
                crack[n] = (edges[k, 8] >> 2) + 2 & 3 if side else edges[k, 8] & 3
                away[n, 0] = edges[k, 2 - 2 * side] - edges[k, 2 * side]
                away[n, 1] = edges[k, 3 - 2 * side] - edges[k, 2 * side + 1]
                n += 1
        own = n
        bits = boundary.cracks[y + 1, x + 1]
        for d, is_other in ((3, y == 0), (2, x == 0)):
            if is_other and bits >> d & 1:
                owner[n], crack[n] = -1, d
                away[n, 0], away[n, 1] = -np.int64(d == 3), -np.int64(d == 2)
                n += 1
        if own < 2 or go_around(crack[:n], away[:n], owner[:n], n):
            continue
        for q in range(n):
            k = owner[q]
            if k >= 0:
                found |= split(boundary, chain, stops, k, tails[k], heads[k], arc_of[k], edges)
    return found


@kernel
def build(boundary: Boundary, chain: Chain, rules: Rules, size: int) -> Chain:
    """Choose the vertices: as few edges as hold between those that are kept, and none that meets another.

    In the result ``stops`` are all vertices, ``kept`` and ``old`` tell of the edges that did stay.
    """
    n, arcs = len(chain.points), len(boundary.labels)
    fence, low = fence_in(boundary, rules, size)
    special, fixed = np.zeros(n, np.uint8), np.zeros(n, np.uint8)
    for m in range(n):
        bits = boundary.cracks[chain.points[m, 0] + 1, chain.points[m, 1] + 1] & 15
        special[m] = bits in (7, 11, 13, 14, 15)
    for arc in range(arcs):
        for m in (np.int64(chain.offsets[arc]), np.int64(chain.offsets[arc + 1] - 1)):
            if not boundary.closed[arc]:
                fixed[m] = is_node(boundary, chain.points[m, 0], chain.points[m, 1], size)
    stops = chain.stops.copy()
    while True:
        at, is_vertex = chain.at.copy(), np.zeros(n, np.uint8)
        splits, _ = build_network(
            fence, low, low, chain.points, chain.offsets, boundary.closed, boundary.labels, special, arcs,
            rules.phase_y, rules.phase_x, rules.epsilon2, rules.choose2, fixed, stops, chain.kept, at, is_vertex,
        )  # fmt: skip
        if splits < 0:
            raise AssertionError("a node beside its point is in the way, where nothing is")
        if not mend_borders(boundary, chain, at, is_vertex, stops, size):
            break
    return Chain(chain.points, chain.offsets, at, is_vertex, chain.kept.copy(), chain.old)


@kernel
def find_wasteful(boundary: Boundary, chain: Chain, built: Chain, rules: Rules, size: int) -> Bytes:
    """(arcs,) which arcs have far more edges, with those that are kept, than without any."""
    arcs = len(boundary.labels)
    fence, low = fence_in(boundary, rules, size)
    found = np.zeros(arcs, np.uint8)
    for arc in range(arcs):
        start, end = np.int64(chain.offsets[arc]), np.int64(chain.offsets[arc + 1])
        kept = np.int64(chain.kept[start:end].sum())
        edges = count_edges(boundary, chain, built.stops, arc)
        if kept == 0 or edges <= kept:
            continue
        stops = np.zeros(end - start, np.uint8)
        if not boundary.closed[arc]:
            stops[0] = stops[-1] = 1
        at, is_vertex = chain.points[start:end].copy(), np.zeros(end - start, np.uint8)
        at[0], at[-1] = chain.at[start], chain.at[end - 1]
        offsets = np.array([0, end - start], np.int32)
        simplify_arcs(
            fence, low, low, chain.points[start:end], offsets, boundary.closed[arc : arc + 1], 1,
            rules.phase_y, rules.phase_x, rules.choose2, stops, np.zeros(end - start, np.uint8), at, is_vertex,
        )  # fmt: skip
        fewest = np.int64(is_vertex.sum()) - (not boundary.closed[arc])
        found[arc] = edges > HISTORY * fewest + 1
    return found


@kernel
def forget_arc(boundary: Boundary, chain: Chain, arc: int) -> None:
    """Give up what was kept of an arc."""
    start, end = np.int64(chain.offsets[arc]), np.int64(chain.offsets[arc + 1])
    for m in range(start, end):
        is_end = not boundary.closed[arc] and m in (start, end - 1)
        chain.kept[m] = 0
        chain.old[m] = -1
        if not is_end:
            chain.stops[m] = 0
            chain.at[m] = chain.points[m]


@kernel
def forget_beside_gaps(boundary: Boundary, chain: Chain, arc: int) -> None:
    """Give up what was kept of an arc next to what wasn't: there, other edges may take fewer."""
    start, end = np.int64(chain.offsets[arc]), np.int64(chain.offsets[arc + 1])
    stops = start + np.flatnonzero(chain.stops[start:end])
    n = len(stops)
    closed = boundary.closed[arc]
    kept = chain.kept[stops]
    for q in range(n):
        before = kept[q - 1] if q > 0 or closed else np.uint8(1)
        behind = kept[(q + 1) % n] if q + 1 < (n if closed else n - 1) or closed else np.uint8(1)
        if kept[q] and not (before and behind):
            chain.kept[stops[q]] = 0
            chain.old[stops[q]] = -1
    for q in range(n):
        m = stops[q]
        is_end = not closed and (m in (start, end - 1))
        if not is_end and not chain.kept[m] and not chain.kept[stops[q - 1]]:
            chain.stops[m] = 0
            chain.at[m] = chain.points[m]


@kernel
def choose(boundary: Boundary, chain: Chain, rules: Rules, size: int) -> Chain:
    """Choose the vertices; arcs that take far more edges with those that are kept than without give some up, or all."""
    built = build(boundary, chain, rules, size)
    for attempt in range(ATTEMPTS):
        wasteful = find_wasteful(boundary, chain, built, rules, size)
        if not wasteful.any():
            break
        for arc in np.flatnonzero(wasteful):
            if attempt + 1 < ATTEMPTS:
                forget_beside_gaps(boundary, chain, arc)
            else:
                forget_arc(boundary, chain, arc)
        built = build(boundary, chain, rules, size)
    return built


@kernel
def is_complete(boundary: Boundary, chain: Chain, edges: int) -> bool:
    """Whether so many edges are all there are, and all of them are kept."""
    needed = 0
    for arc in range(len(boundary.labels)):
        needed += max(count_edges(boundary, chain, chain.stops, arc), not boundary.closed[arc])
        if boundary.closed[arc] and count_edges(boundary, chain, chain.stops, arc) == 0:
            return False
    kept = 0
    for m in range(len(chain.kept)):
        kept += chain.kept[m]
    return kept == needed and kept == edges


@kernel
def edges_of(boundary: Boundary, built: Chain) -> Rows:
    """(n, 6) the edges of a chain, without thickness."""
    arcs = len(boundary.labels)
    most = int(built.stops.sum()) + 1
    tails, heads, arc_of = np.empty(most, np.int32), np.empty(most, np.int32), np.empty(most, np.int32)
    edges = np.empty((most, EDGE_COLUMNS), np.int64)
    count = list_edges(
        built.points, built.offsets, boundary.closed, arcs, built.at, built.stops, tails, heads, arc_of, edges
    )
    found = np.zeros((count, 6), np.int64)
    for k in range(count):
        found[k, :4] = edges[k, :4]
        found[k, LABEL] = boundary.labels[arc_of[k]]
    return found


@kernel
def list_places(places: Points) -> Points:
    """(2 arcs, 2) the places of all ends."""
    return places.copy().reshape((2 * len(places), 2))


@kernel
def renew_tile(tile: Tile, old: Rows, old_nodes: Points, rules: Rules) -> Rows:
    """(n, 6) the edges of a tile: tail, head (y, x), label with the lesser state on the left, thickness.

    Parameters
    ----------
    old : (m, 6) those that it had
    old_nodes : (k, 2) where nodes were on its borders
    """
    boundary = trace(tile, rules.share)
    places = place_nodes(boundary, old_nodes, junctions_of(old, tile.size), rules, tile.size)
    kept = keep(boundary, places, rules, old, tile.size)
    chosen, count = kept, len(old)
    for _ in range(PATIENCE):
        if is_complete(boundary, kept, count):
            break
        chosen = choose(boundary, kept, rules, tile.size)
        edges = edges_of(boundary, chosen)
        places = place_nodes(boundary, list_places(places), junctions_of(edges, tile.size), rules, tile.size)
        kept, count = keep(boundary, places, rules, edges, tile.size), len(edges)
    found = kept if is_complete(boundary, kept, count) else chosen
    return settle_thickness(tile, boundary, found, old, rules.share)


@kernel
def renew_tiles(
    states: Mosaic, tiles: Rows, old: Rows, old_ends: Ints, nodes: Rows, node_ends: Ints, rules: Rules
) -> tuple[Rows, Ints]:
    """Renew some tiles; their edges one tile after the other, in lattice coordinates, and where those of each end.

    Parameters
    ----------
    tiles : (n, 2) tiles (ty, tx)
    old, old_ends : (m, 6) the edges that they had, one tile after the other, and where those of each end
    nodes, node_ends : (k, 2) where nodes were on their borders, likewise
    """
    size = states.images.shape[1]
    edges, ends = np.empty((64, 6), np.int64), np.empty(len(tiles), np.int64)
    count = 0
    for k in range(len(tiles)):
        low = np.array([size * tiles[k, 0], size * tiles[k, 1]])
        window = cut_out(states, low[0] - HALO, low[1] - HALO, size + 2 * HALO, size + 2 * HALO)
        a, b = np.int64(0) if k == 0 else old_ends[k - 1], old_ends[k]
        own = old[a:b].copy()
        own[:, TAIL_Y : TAIL_X + 1] -= low
        own[:, HEAD_Y : HEAD_X + 1] -= low
        a, b = np.int64(0) if k == 0 else node_ends[k - 1], node_ends[k]
        old_nodes = (nodes[a:b] - low).astype(np.int32)
        found = renew_tile(Tile(window, size, HALO), own, old_nodes, rules)
        found[:, TAIL_Y : TAIL_X + 1] += low
        found[:, HEAD_Y : HEAD_X + 1] += low
        while count + len(found) > len(edges):
            edges = np.concatenate((edges, edges))
        edges[count : count + len(found)] = found
        count += len(found)
        ends[k] = count
    return edges[:count].copy(), ends
