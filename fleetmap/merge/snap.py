"""Step 2: draw the maps of different robots together where they tell of the same wall.

Two maps of one wall differ by noise, by where each cut it into edges, and by the error of the start poses.
Vertices move onto vertices of other sources, and edges are led through such vertices, where they are at most
``reach_cells`` apart and the boundaries run the same way (free space on the same side: the two faces of a thin
wall never meet). Nothing moves within one source alone, so one map stays as it is; nothing moves farther than
the reach, so no gap wider than twice that can close (law 4).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fleetmap.merge.arrange import pack, unpack
from fleetmap.merge.place import Placed
from fleetmap.merge.tiles import levels_of, tiles_of_points


def snap(sources: list[Placed], *, reach_cells: int) -> list[Placed]:
    """Snap the sources, in canonical order, to each other; ``reach_cells`` is 0 to 2 (see ``pair_cell``)."""
    from fleetmap.merge.snap_kernels import close_pairs, stars, through_vertices

    if len(sources) < 2 or reach_cells == 0:
        return sources
    ends = np.concatenate([s.ends for s in sources])
    cell = np.array([s.cell for s in sources])
    owner = np.repeat(np.arange(len(sources)), [len(s.ends) for s in sources])

    # 1. The vertices of all sources, ascending by place, then by source; and how the boundary runs there.
    keys = np.column_stack([pack(ends.reshape(-1, 2)), np.repeat(owner, 2)])
    order = np.lexsort((keys[:, 1], keys[:, 0]))
    new = np.ones(len(keys), bool)
    new[1:] = (keys[order[1:]] != keys[order[:-1]]).any(axis=1)
    vertex = np.empty(len(keys), np.int64)
    vertex[order] = np.cumsum(new) - 1
    at, source = unpack(keys[order[new], 0]), keys[order[new], 1]
    tangent = np.zeros_like(at)
    np.add.at(tangent, vertex, np.repeat(ends[:, 2:] - ends[:, :2], 2, axis=0))

    # 2. Vertices onto vertices: the nearest pairs first, ties by place.
    level = levels_of(cell)
    levels = np.unique(level)
    pairs = close_pairs(at, source, tangent, cell, levels, *tiles_of_points(at, level[source]), reach_cells)
    pairs = pairs[np.lexsort(pairs.T[::-1])]
    moved = at[stars(pairs, source)]
    after = np.ascontiguousarray(moved[vertex].reshape(-1, 4))

    # 3. Edges through the vertices of others.
    by_place = np.lexsort((source, pack(moved)))
    places, first = np.unique(pack(moved[by_place]), return_index=True)
    first = np.append(first, len(by_place))
    at, source, tangent = unpack(places), source[by_place], tangent[by_place]
    coarsest = np.maximum.reduceat(level[source], first[:-1])  # of the vertices that share a place
    pieces, edge = through_vertices(
        ends, after, owner, at, first, source, tangent, cell, levels, *tiles_of_points(at, coarsest), reach_cells
    )

    start = np.searchsorted(owner[edge], np.arange(len(sources) + 1))
    offset = np.searchsorted(owner, np.arange(len(sources)))
    out = []
    for k, s in enumerate(sources):
        of_source = slice(start[k], start[k + 1])
        inherited = edge[of_source] - offset[k]
        out.append(
            replace(
                s,
                ends=pieces[of_source],
                winds=s.winds[inherited],
                wall=s.wall[inherited],
                thickness=s.thickness[inherited],
            )
        )
    return out
