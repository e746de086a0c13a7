"""Streams, replicas and the decisions of the exchange; no I/O, no thread, no clock."""

from fleetmap.engine.engine import Engine
from fleetmap.engine.outputs import Ask, Changed, Detour, EpochChanged, Event, NameTaken, Output, PeersChanged, Put
from fleetmap.engine.stream import Stream, Submap

__all__ = [
    "Ask",
    "Changed",
    "Detour",
    "Engine",
    "EpochChanged",
    "Event",
    "NameTaken",
    "Output",
    "PeersChanged",
    "Put",
    "Stream",
    "Submap",
]
