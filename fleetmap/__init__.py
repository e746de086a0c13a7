"""fleetmap: robots of a fleet share vector maps peer to peer, and all hold the same merged map.

The public names are loaded when they are first used, so that ``import fleetmap`` costs next to nothing
beyond numpy (PEP 562).
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from fleetmap.version import __version__

if TYPE_CHECKING:
    from fleetmap import sync
    from fleetmap.merge import fold
    from fleetmap.model.errors import (
        ConfigError,
        FleetmapError,
        LinkError,
        MapFormatError,
        MapWarning,
        NameInUse,
        NoPath,
        WireError,
    )
    from fleetmap.model.grid import OccupancyGrid
    from fleetmap.model.map_server import load_map, save_map
    from fleetmap.model.mergedmap import MergedMap
    from fleetmap.model.metrics import compare
    from fleetmap.model.pose import Pose2
    from fleetmap.model.vectormap import VectorMap
    from fleetmap.peer import JoinOptions, Peer, join
    from fleetmap.planners import plan
    from fleetmap.vectorize import Vectorizer, rasterize

_HOMES = {
    "ConfigError": "fleetmap.model.errors",
    "FleetmapError": "fleetmap.model.errors",
    "JoinOptions": "fleetmap.peer",
    "LinkError": "fleetmap.model.errors",
    "MapFormatError": "fleetmap.model.errors",
    "MapWarning": "fleetmap.model.errors",
    "MergedMap": "fleetmap.model.mergedmap",
    "NameInUse": "fleetmap.model.errors",
    "NoPath": "fleetmap.model.errors",
    "OccupancyGrid": "fleetmap.model.grid",
    "Peer": "fleetmap.peer",
    "Pose2": "fleetmap.model.pose",
    "VectorMap": "fleetmap.model.vectormap",
    "Vectorizer": "fleetmap.vectorize",
    "WireError": "fleetmap.model.errors",
    "compare": "fleetmap.model.metrics",
    "fold": "fleetmap.merge",
    "join": "fleetmap.peer",
    "load_map": "fleetmap.model.map_server",
    "plan": "fleetmap.planners",
    "rasterize": "fleetmap.vectorize",
    "save_map": "fleetmap.model.map_server",
}

__all__ = [
    "ConfigError",
    "FleetmapError",
    "JoinOptions",
    "LinkError",
    "MapFormatError",
    "MapWarning",
    "MergedMap",
    "NameInUse",
    "NoPath",
    "OccupancyGrid",
    "Peer",
    "Pose2",
    "VectorMap",
    "Vectorizer",
    "WireError",
    "__version__",
    "compare",
    "fold",
    "join",
    "load_map",
    "plan",
    "rasterize",
    "save_map",
    "sync",
]

_ROOMS = ("codecs", "merge", "model", "peer", "planners", "sims", "sync", "vectorize")
"""Packages and modules that the documentation names as attributes."""


def __getattr__(name: str) -> object:
    if name in _HOMES:
        value: object = getattr(importlib.import_module(_HOMES[name]), name)
        globals()[name] = value
        return value
    if name in _ROOMS:
        return importlib.import_module(f"{__name__}.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
