"""Streams, replicas and the decisions of the exchange; no I/O, no thread, no clock."""

from fleetmap.engine.engine import Engine
from fleetmap.engine.outputs import Ask, Changed, EpochChanged, NameTaken, Output, PeersChanged, Put
from fleetmap.engine.stream import Stream, Submap

__all__ = [
    "Ask",
    "Changed",
    "Engine",
    "EpochChanged",
    "NameTaken",
    "Output",
    "PeersChanged",
    "Put",
    "Stream",
    "Submap",
]
