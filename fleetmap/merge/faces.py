"""Step 4: what lies on the two sides of each piece: free if any source says so, else occupied, else unknown."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.merge.arrange import BAND_SHIFT, Arrangement, bands
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN


def side_states(arrangement: Arrangement) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """States (n,) of the left and of the right side of each piece, seen from its lower end.

    A side is FREE if the winding number of any source is positive there. Else it is OCCUPIED if a source
    puts a wall there, or UNKNOWN: within one face that isn't free the two may stand side by side.
    """
    from fleetmap.merge.arrange_kernels import free_sides

    a = arrangement
    start, items, low = bands(a.ends)
    free_left, free_right = free_sides(a.ends, a.first, a.source, a.winding, start, items, low, BAND_SHIFT, a.n_sources)
    left = np.where(free_left, FREE, np.where(a.wall_left, OCCUPIED, UNKNOWN))
    right = np.where(free_right, FREE, np.where(a.wall_right, OCCUPIED, UNKNOWN))
    return left, right
