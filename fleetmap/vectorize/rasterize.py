"""Vector map to grid."""

from __future__ import annotations

from fleetmap.model.checks import check_type
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.pose import Pose2
from fleetmap.model.raster import vector_map_states
from fleetmap.model.vectormap import VectorMap
from fleetmap.vectorize.phase import place_on_lattice


def rasterize(vector_map: VectorMap, *, like: OccupancyGrid | None = None) -> OccupancyGrid:
    """Make a grid of cells free, occupied or unknown: each by what its centre lies in.

    Parameters
    ----------
    vector_map : any
    like : a grid whose origin and size the result shall have; without it, the extent of the map

    Raises
    ------
    ConfigError : ``like`` has another resolution or yaw than the map, or one of them is something else
    MapFormatError : the map is too large
    """
    check_type("vector_map", vector_map, VectorMap, hint="a MergedMap has .to_grid()")
    lattice = vector_map.lattice
    if like is not None:
        check_type("like", like, OccupancyGrid)
        low_yx, phase_yx = place_on_lattice(like, lattice)
        shape = like.height, like.width
        states, _ = vector_map_states(vector_map, low_yx=low_yx, shape=shape, phase_yx=phase_yx)
        return OccupancyGrid.from_states(states, lattice.resolution_m, like.origin)
    states, (low_y, low_x) = vector_map_states(vector_map)
    corner = Pose2(low_x * lattice.resolution_m, low_y * lattice.resolution_m)
    return OccupancyGrid.from_states(states, lattice.resolution_m, lattice.T_frame_lattice.to_pose() @ corner)
