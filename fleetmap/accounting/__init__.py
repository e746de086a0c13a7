"""Counting bytes."""

from fleetmap.accounting.compare import BASELINES, Comparison, compare, together, with_heartbeats
from fleetmap.accounting.ledger import Count, Ledger, Stats
from fleetmap.accounting.wire import Transport, WireBytes, grids_instead, wire_bytes

__all__ = [
    "BASELINES",
    "Comparison",
    "Count",
    "Ledger",
    "Stats",
    "Transport",
    "WireBytes",
    "compare",
    "grids_instead",
    "together",
    "wire_bytes",
    "with_heartbeats",
]
