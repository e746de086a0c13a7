"""Scores of maps against a reference, and what becomes of them over several terrains."""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Mapping
from dataclasses import asdict

from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.metrics import compare
from fleetmap.model.vectormap import VectorMap

METRICS = ("MS", "CC", "PC", "OPDF", "UPDF", "OPDF_reverse", "UPDF_reverse")
PAPER_METRICS = METRICS[:5]

Scores = dict[str, float]
"""Metric to per cent."""


def score(candidate: OccupancyGrid | VectorMap, reference: OccupancyGrid) -> Scores:
    """All metrics of a map against a grid; a vector map is rasterised on the grid's own cells."""
    from fleetmap.vectorize import rasterize

    if isinstance(candidate, VectorMap):
        candidate = rasterize(candidate, like=reference)
    return asdict(compare(candidate, reference))


def difference(a: Mapping[str, float], b: Mapping[str, float]) -> Scores:
    """Percentage points by which ``a`` scores higher than ``b``."""
    return {metric: a[metric] - b[metric] for metric in METRICS}


def medians(rows: Iterable[Mapping[str, float]]) -> Scores:
    """The median of each key over rows that all have the same keys; empty without rows."""
    rows = list(rows)
    return {key: statistics.median(row[key] for row in rows) for key in rows[0]} if rows else {}
