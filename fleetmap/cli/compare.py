"""``fleetmap compare``: the paper's metrics between two maps."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fleetmap.cli.output import AsJson, print_json, print_table


def compare(
    a: Annotated[Path, typer.Argument(metavar="A", help="A map: map_server .yaml or .fmap.")],
    b: Annotated[Path, typer.Argument(metavar="B", help="The reference: map_server .yaml or .fmap.")],
    as_json: AsJson = False,
) -> None:
    """Compare two maps by the metrics of the paper, in per cent; 100 is best.

    Over the union of both extents, on B's lattice. OPDF and UPDF look from A's cells to B's and forgive
    what A misses, so their reverse always stands beside them.

    Example:  fleetmap compare out.yaml map.yaml
    """
    from fleetmap.cli.maps import read_grid
    from fleetmap.model.metrics import compare as compare_grids

    metrics = compare_grids(read_grid(a), read_grid(b))
    document = {
        name: getattr(metrics, name) for name in ("MS", "CC", "PC", "OPDF", "UPDF", "OPDF_reverse", "UPDF_reverse")
    }
    if as_json:
        print_json({"a": str(a), "b": str(b), **document})
    else:
        print_table(f"{a} against {b}", ["metric", "%"], [[k, f"{v:.3f}"] for k, v in document.items()])
