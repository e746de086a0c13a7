"""Counting bytes."""

from fleetmap.accounting.ledger import Count, Ledger, Stats

__all__ = ["Count", "Ledger", "Stats"]
