"""``fleetmap align``: where one map lies in another."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fleetmap.cli.output import AsJson, print_json

if TYPE_CHECKING:
    from PIL.Image import Image

    from fleetmap.align.evidence import Evidence
    from fleetmap.align.protocol import Alignment
    from fleetmap.model.grid import OccupancyGrid
    from fleetmap.model.pose import Pose2

LONGEST_PX = 1600
INK_A, INK_B, FREE_A, FREE_B = (30, 60, 120), (200, 70, 40), (214, 226, 244), (250, 224, 214)


def align(
    a: Annotated[Path, typer.Argument(metavar="A", help="A map: map_server .yaml, .fmap or .fgrid.")],
    b: Annotated[Path, typer.Argument(metavar="B", help="Another one, to be laid over it.")],
    png: Annotated[Path | None, typer.Option(metavar="OUT.png", help="Draw one over the other.")] = None,
    as_json: AsJson = False,
) -> None:
    """Find where map B lies in map A, without being told anything; or say why that can't be told.

    Prints the transform, p_a = R(yaw) p_b + (x, y), what speaks for it and against it, and the outcome: `committed`,
    `ambiguous` (it fits at several places, or slides along a corridor), `conflict` (where it fits best, walls stand in
    what the other saw as free) or `too_small`. Ends with 1 unless it is committed.

    For instance:  fleetmap align monday.yaml tuesday.yaml --png both.png
    """
    from fleetmap.align.align import align as find
    from fleetmap.cli.maps import check_output, read_grid
    from fleetmap.model.kernel_cache import modules_of
    from fleetmap.model.kernel_compiler import compile_ahead
    from fleetmap.vectorize import vectorize

    if png is not None:
        check_output(png, ".png")
    compile_ahead(modules_of("model", "vectorize"))
    grid_a, grid_b = read_grid(a), read_grid(b)
    found = find(vectorize(grid_a), vectorize(grid_b))
    document = as_document(a, b, found)
    if png is not None and found.T_a_b is not None:
        overlay(grid_a, grid_b, found.T_a_b).save(png)
        document["png"] = str(png)
    if as_json:
        print_json(document)
    else:
        _print(document)
    if found.outcome != "committed":
        raise typer.Exit(1)


def as_document(a: Path, b: Path, found: Alignment) -> dict[str, Any]:
    """The document of `fleetmap align --json`."""
    pose = found.T_a_b
    return {
        "a": str(a),
        "b": str(b),
        "outcome": found.outcome,
        "text": found.text,
        "x_m": None if pose is None else pose.x_m,
        "y_m": None if pose is None else pose.y_m,
        "yaw_rad": None if pose is None else pose.yaw_rad,
        "covariance": [list(row) for row in found.covariance],
        "middle_xy": list(found.middle_xy),
        "evidence": _evidence(found.evidence),
        "second": _evidence(found.second),
    }


def _evidence(evidence: Evidence | None) -> dict[str, float] | None:
    if evidence is None:
        return None
    names = ("explained_m", "conflict_m", "visible_m", "fixed_m", "rms_m", "score_m")
    return {name: round(float(getattr(evidence, name)), 4) for name in names}


def _print(document: dict[str, Any]) -> None:
    typer.echo(f"{document['outcome']}: {document['text']}")
    if document["x_m"] is None:
        return
    x, y, yaw = document["x_m"], document["y_m"], document["yaw_rad"]
    certain = "" if document["outcome"] == "committed" else " (the best guess; don't rely on it)"
    typer.echo(f"b in a: x {x:.3f} m, y {y:.3f} m, yaw {math.degrees(yaw):.3f} degrees{certain}")
    typer.echo(
        f"as a transform of ROS 2: ros2 run tf2_ros static_transform_publisher --x {x:.4f} --y {y:.4f} "
        f"--yaw {yaw:.6f} --frame-id a --child-frame-id b"
    )


def overlay(grid_a: OccupancyGrid, grid_b: OccupancyGrid, T_a_b: Pose2) -> Image:
    """Both maps in the frame of a: walls of a blue, of b red, free floor of either pale."""
    import numpy as np
    from PIL import Image

    from fleetmap.model.lattice import FREE, OCCUPIED

    step = min(grid_a.resolution_m, grid_b.resolution_m)
    corners = []
    for grid, T_a_grid in ((grid_a, grid_a.origin), (grid_b, T_a_b @ grid_b.origin)):
        height, width = grid.height * grid.resolution_m, grid.width * grid.resolution_m
        corners.append(T_a_grid.apply(np.array([(0, 0), (width, 0), (0, height), (width, height)])))
    low, high = np.vstack(corners).min(axis=0), np.vstack(corners).max(axis=0)
    step = max(step, float((high - low).max()) / LONGEST_PX)
    columns, rows = np.ceil((high - low) / step).astype(int) + 1
    x, y = np.meshgrid(low[0] + (np.arange(columns) + 0.5) * step, low[1] + (np.arange(rows) + 0.5) * step)
    points = np.stack([x, y], axis=-1).reshape(-1, 2)
    picture = np.full((rows * columns, 3), 246, np.uint8)
    inks = ((grid_a, grid_a.origin, FREE_A, INK_A), (grid_b, T_a_b @ grid_b.origin, FREE_B, INK_B))
    for state in (FREE, OCCUPIED):  # walls over floors
        for grid, T_a_grid, pale, dark in inks:
            cells = np.floor(T_a_grid.inverse().apply(points) / grid.resolution_m).astype(int)
            inside = (cells >= 0).all(axis=1) & (cells[:, 0] < grid.width) & (cells[:, 1] < grid.height)
            hit = np.zeros(len(points), bool)
            hit[inside] = grid.states_yx()[cells[inside, 1], cells[inside, 0]] == state
            picture[hit] = np.minimum(picture[hit], pale) if state == FREE else np.array(dark, np.uint8)
    return Image.fromarray(picture.reshape(rows, columns, 3)[::-1])
