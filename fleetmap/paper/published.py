"""What the paper published, as far as this project repeats it, and our figure beside each.

Baizid, Lozenguez, Fabresse, Bouraqadi: Vector Maps: a Lightweight and Accurate Map Format for Multi-Robot Systems,
2016.
"""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from typing import Any

from fleetmap.paper.scores import PAPER_METRICS

LARGEST_M = 80

GRID_KB, VECTOR_KB = 2532.4, 39.2
"""Means over the terrains of 80 m; the paper doesn't say of how many bytes its KB are."""

SCORE_RANGES: dict[str, tuple[float, float | None]] = {
    "MS": (91.0, None),
    "OPDF": (91.0, None),
    "UPDF": (91.0, None),
    "CC": (49.0, 63.0),
    "PC": (49.0, 63.0),
}
"""Per cent: lowest and highest over maps and terrains; None: the paper says only "above"."""

WITHIN_PERCENT = 1.0
"""A vector map scores within this of the grid that it came from."""


def beside_ours(rows: Sequence[dict[str, Any]], profile: str) -> list[dict[str, Any]]:
    """Each published number with ours: means over the terrains of 80 m for sizes, the range over all rows for scores.

    ``ours`` is None where the rows have nothing to say, such as without terrains of 80 m.
    """
    largest = [row["sizes"] for row in rows if row["size_m"] == LARGEST_M]
    grid_kb, vector_kb, own_kb = (
        statistics.mean(sizes) / 1000 if (sizes := list(found)) else None
        for found in (
            (sizes["grid"]["pgm"] for sizes in largest),
            (sizes["vector_from_grid"][profile]["plain"] for sizes in largest),
            (sizes["vector_from_grid"][profile]["fleetmap"] for sizes in largest),
        )
    )
    where = f"mean over terrains of {LARGEST_M} m"
    claims: list[dict[str, Any]] = [
        {"claim": f"grid as PGM, {where}", "unit": "kB", "published": GRID_KB, "ours": grid_kb},
        {"claim": f"vector map, plain, {where}", "unit": "kB", "published": VECTOR_KB, "ours": vector_kb},
        {"claim": f"vector map, fleetmap, {where}", "unit": "kB", "published": None, "ours": own_kb},
        {
            "claim": "PGM / plain vector map",
            "unit": "x",
            "published": GRID_KB / VECTOR_KB,
            "ours": grid_kb / vector_kb if grid_kb and vector_kb else None,
        },
    ]
    for name, key in (("grid", "grid"), ("vector map from the grid", "vector_from_grid")):
        for metric in PAPER_METRICS:
            values = [pick(row["scores"][key], profile)[metric] for row in rows]
            claims.append(
                {
                    "claim": f"{metric} of the {name}",
                    "unit": "%",
                    "published": list(SCORE_RANGES[metric]),
                    "ours": [min(values), max(values)],
                }
            )
    for metric in PAPER_METRICS:
        gaps = [row["vector_minus_grid"][profile][metric] for row in rows]
        claims.append(
            {
                "claim": f"{metric} of the vector map minus that of its grid",
                "unit": "points",
                "published": [-WITHIN_PERCENT, WITHIN_PERCENT],
                "ours": [min(gaps), max(gaps)],
            }
        )
    return claims


def pick(scores: dict[str, Any], profile: str) -> dict[str, float]:
    """The scores themselves, whether they are of a grid or by profile."""
    found: dict[str, float] = scores.get(profile, scores)
    return found
