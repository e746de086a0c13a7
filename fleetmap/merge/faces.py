"""Step 4: what lies on the two sides of each piece: free if any source says so, else occupied, else unknown."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.merge.arrange import Arrangement
from fleetmap.merge.tiles import keys_of, tiles_of_edges
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN


def side_states(arrangement: Arrangement) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """States (n,) of the left and of the right side of each piece, seen from its lower end.

    A side is FREE if the winding number of any source is positive there. Else it is OCCUPIED if a source
    puts a wall there, or UNKNOWN: within one face that isn't free the two may stand side by side.
    """
    from fleetmap.merge.arrange_kernels import free_sides
    from fleetmap.model.sort_kernels import order_of

    a = arrangement
    tiles = tiles_of_edges(a.ends)
    keys = keys_of((a.ends[:, :2] + a.ends[:, 2:]) >> 1)
    middles = order_of(keys)
    first_middle = np.searchsorted(keys[middles], np.append(tiles.keys, np.iinfo(np.int64).max))
    free_left, free_right = free_sides(a.ends, a.first, a.source, a.winding, *tiles, middles, first_middle, a.n_sources)
    left = np.where(free_left, FREE, np.where(a.wall_left, OCCUPIED, UNKNOWN))
    right = np.where(free_right, FREE, np.where(a.wall_right, OCCUPIED, UNKNOWN))
    return left, right
