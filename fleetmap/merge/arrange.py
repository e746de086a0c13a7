"""Step 3: one planar arrangement of all edges, by exact snap rounding on the fleet lattice.

Every vertex and every rounded intersection is a hot pixel; each edge is led through the hot pixels it meets,
in order (Hobby 1999). Then edges meet only at vertices, overlapping collinear edges have become the same
pieces, and no point has moved by more than half a step along an axis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetmap.merge.place import Placed
from fleetmap.merge.tiles import tiles_of_edges, tiles_of_points
from fleetmap.model.lattice import MAX_COORDINATE


@dataclass(frozen=True, slots=True, eq=False)
class Arrangement:
    """Pieces that meet only at vertices, each once, with what the sources say of it.

    Parameters
    ----------
    ends : (n, 4) int64 rows (y0, x0, y1, x1), (y0, x0) < (y1, x1), ascending
    wall_left, wall_right : (n,) bool; a source says that this side is occupied
    thickness : (n,) int64, the largest that any source gives
    cell : (n,) int64, the cell size of the finest source that has it, lattice steps
    rank : (n,) int64, the first source that sees a wall there; ``n_sources`` where none does
    first, source, winding : ``source[first[i]:first[i + 1]]`` are the sources whose winding number changes
        at piece i, and ``winding`` by how much it is higher on the left
    n_sources : how many there are
    """

    ends: NDArray[np.int64]
    wall_left: NDArray[np.bool_]
    wall_right: NDArray[np.bool_]
    thickness: NDArray[np.int64]
    cell: NDArray[np.int64]
    rank: NDArray[np.int64]
    first: NDArray[np.int64]
    source: NDArray[np.int64]
    winding: NDArray[np.int64]
    n_sources: int


def arrange(sources: list[Placed]) -> Arrangement:
    """Snap-round the edges of all sources into one arrangement."""
    from fleetmap.merge.arrange_kernels import crossings, route

    # 1. All edges, each from its lower end.
    ends = np.concatenate([s.ends for s in sources])
    owner = np.repeat(np.arange(len(sources)), [len(s.ends) for s in sources])
    ends, turned = lower_end_first(ends)

    # 2. Hot pixels: the vertices, and where two edges cross.
    hot = unique_points(np.concatenate([ends.reshape(-1, 2), crossings(ends, *tiles_of_edges(ends))]))

    # 3. Lead every edge through them. Within one row of pixels a piece may run against x, and so from its
    #    upper end.
    routed, edge = route(ends, hot, *tiles_of_points(hot))
    routed, against = lower_end_first(routed)
    turned = turned[edge] ^ against

    # 4. Each piece once: what the sources say of it, added up.
    pieces, piece = unique_edges(routed)
    wall = np.concatenate([s.wall for s in sources])[edge] == 1
    winds = np.concatenate([s.winds for s in sources])[edge]
    thickness = np.zeros(len(pieces), np.int64)
    np.maximum.at(thickness, piece, np.concatenate([s.thickness for s in sources])[edge])
    cell = np.full(len(pieces), MAX_COORDINATE)
    np.minimum.at(cell, piece, np.array([s.cell for s in sources])[owner[edge]])
    rank = np.full(len(pieces), len(sources))
    np.minimum.at(rank, piece[wall], owner[edge][wall])
    wall_left, wall_right = np.zeros(len(pieces), bool), np.zeros(len(pieces), bool)
    wall_left[piece[wall & turned]] = True
    wall_right[piece[wall & ~turned]] = True
    first, source, winding = _windings(len(pieces), piece, owner[edge], np.where(turned, -winds, winds))
    return Arrangement(pieces, wall_left, wall_right, thickness, cell, rank, first, source, winding, len(sources))


def lower_end_first(ends: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Turn edges (n, 4) so that (y0, x0) < (y1, x1); also says which were turned."""
    turned = (ends[:, 0] > ends[:, 2]) | ((ends[:, 0] == ends[:, 2]) & (ends[:, 1] > ends[:, 3]))
    return np.where(turned[:, None], ends[:, [2, 3, 0, 1]], ends), turned


def unique_points(points: NDArray[np.int64]) -> NDArray[np.int64]:
    """(n, 2) points (y, x) -> ascending, each once."""
    return unpack(np.unique(pack(points)))


def unique_edges(ends: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(n, 4) edges -> ascending, each once, and where each went."""
    vertices, ids = np.unique(pack(ends.reshape(-1, 2)), return_inverse=True)
    ids = ids.reshape(-1, 2)
    keys, inverse = np.unique(ids[:, 0] * len(vertices) + ids[:, 1], return_inverse=True)
    lower, upper = np.divmod(keys, max(1, len(vertices)))
    return np.column_stack([unpack(vertices[lower]), unpack(vertices[upper])]), inverse


def pack(points: NDArray[np.int64]) -> NDArray[np.int64]:
    """(n, 2) points (y, x) -> (n,) integers that sort alike."""
    return (points[:, 0] << 32) + points[:, 1] + (1 << 31)


def unpack(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """The points behind ``pack``."""
    return np.column_stack([keys >> 32, (keys & 0xFFFFFFFF) - (1 << 31)])


def _windings(
    n_pieces: int, piece: NDArray[np.int64], owner: NDArray[np.int64], winds: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Add up the windings of each (piece, source), leave out those that are 0, and index them by piece."""
    n_sources = int(owner.max(initial=0)) + 1
    keys, inverse = np.unique(piece * n_sources + owner, return_inverse=True)
    total = np.zeros(len(keys), np.int64)
    np.add.at(total, inverse, winds)
    keys, total = keys[total != 0], total[total != 0]
    first = np.searchsorted(keys, np.arange(n_pieces + 1) * n_sources)
    return first, keys % n_sources, total
