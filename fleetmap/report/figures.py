"""Figures for papers and notebooks, by matplotlib (``pip install fleetmap[plot]``)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fleetmap.model.errors import ConfigError
from fleetmap.model.mergedmap import MergedMap
from fleetmap.model.vectormap import VectorMap

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WALL, FRONTIER, REST = "#2f3640", "#e8891c", "#b5bcc4"


def plot_map(fleet_map: VectorMap | MergedMap, ax: Axes | None = None) -> Axes:
    """Draw a map's edges in metres: walls dark, frontiers orange, all others (backs of walls) grey.

    Parameters
    ----------
    ax : where to draw; a new figure if None

    Returns
    -------
    Axes : with equal scales, to save (``ax.figure.savefig``) or to draw on

    Raises
    ------
    ConfigError : matplotlib is not installed
    """
    try:
        import matplotlib.pyplot as plt
        from matplotlib.collections import LineCollection
    except ImportError:
        raise ConfigError(option="plot", value="matplotlib", reason="missing: pip install 'fleetmap[plot]'") from None
    if ax is None:
        ax = plt.figure(layout="constrained").add_subplot()
    rest = ~(fleet_map.obstacle | fleet_map.frontier)
    for which, colour, width in (
        (rest, REST, 0.5),
        (fleet_map.frontier, FRONTIER, 0.8),
        (fleet_map.obstacle, WALL, 1.0),
    ):
        ax.add_collection(LineCollection(list(fleet_map.segments_xy[which]), colors=colour, linewidths=width))
    ax.autoscale()
    ax.set_aspect("equal")
    ax.set_xlabel("x (m)")
    ax.set_ylabel("y (m)")
    return ax
