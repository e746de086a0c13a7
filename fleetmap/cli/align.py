"""``fleetmap align``: where one map lies in another."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fleetmap.cli.output import AsJson, print_json, stderr
from fleetmap.model.errors import ConfigError
from fleetmap.model.pose import Pose2

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from PIL.Image import Image

    from fleetmap.align.evidence import Evidence
    from fleetmap.align.protocol import Alignment
    from fleetmap.model.grid import OccupancyGrid
    from fleetmap.model.vectormap import VectorMap

LEVEL = "L1"
"""What Open-RMF's traffic editor calls the first level."""

LONGEST_PX = 1600
LINE_PX = 18
INK_BOTH, PAPER = (40, 40, 40), (246, 246, 246)
INK_A, INK_B, FREE_A, FREE_B = (30, 60, 120), (200, 70, 40), (214, 226, 244), (250, 224, 214)


def align(
    a: Annotated[
        Path, typer.Argument(metavar="A", help="A map: map_server .yaml, .fmap or .fgrid; or a floor plan, .png.")
    ],
    b: Annotated[Path, typer.Argument(metavar="B", help="Another map, to be laid over it.")],
    resolution: Annotated[
        float | None, typer.Option(metavar="M", help="Metres a pixel, if A is the picture of a floor plan.")
    ] = None,
    png: Annotated[Path | None, typer.Option(metavar="OUT.png", help="Draw one over the other.")] = None,
    rmf: Annotated[
        bool, typer.Option("--rmf", help="Print only the YAML that a fleet adapter of Open-RMF needs: A is its map.")
    ] = False,
    level: Annotated[
        str | None, typer.Option(metavar="NAME", show_default="L1", help="With --rmf: the level that A shows.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Find where map B lies in map A, without being told anything; or say why that can't be told.

    Prints the transform, p_a = R(yaw) p_b + (x, y), what speaks for it and against it, and the outcome: `committed`,
    `ambiguous` (it fits at several places, or slides along a corridor), `conflict` (where it fits best, walls stand in
    what the other saw as free) or `too_small`. Ends with 1 unless it is committed.

    For instance:  fleetmap align monday.yaml tuesday.yaml --png both.png

    A may be a floor plan: dark pixels are walls, all others free, and its lower left corner is at (0, 0).

    For instance:  fleetmap align plan.png robot.yaml --resolution 0.05

    With --rmf, `reference_coordinates` for the config.yaml of a fleet adapter. Of a floor plan they are those of RMF's
    traffic editor, if its scale is the same: from the upper left corner, y up.

    For instance:  fleetmap align plan.png robot.yaml --resolution 0.05 --rmf >> config.yaml
    """
    from fleetmap.align.align import align as find
    from fleetmap.cli.maps import check_output, check_resolution, read_vector_map
    from fleetmap.model.kernel_cache import modules_of
    from fleetmap.model.kernel_compiler import compile_ahead
    from fleetmap.vectorize import rasterize

    if png is not None:
        check_output(png, ".png", inputs=(a, b))
    check_resolution(a, resolution)
    _check_rmf(rmf, level, as_json)
    compile_ahead(modules_of("model", "vectorize", "codecs", "align"))
    map_a, map_b = read_vector_map(a, resolution), read_vector_map(b)
    found = find(map_a, map_b)
    document = as_document(a, b, found)
    if png is not None and found.T_a_b is not None:
        picture = overlay(rasterize(map_a), rasterize(map_b), found.T_a_b)
        legend(picture, a, b, f"{found.outcome}: {found.text}").save(png)
        document["png"] = str(png)
    committed = found.outcome == "committed"
    if as_json:
        print_json(document)
    elif rmf:
        stderr.print(f"{found.outcome}: {found.text}", markup=False, highlight=False, soft_wrap=True)
        if committed and found.T_a_b is not None:
            typer.echo(as_rmf(rmf_frame(a, resolution) @ found.T_a_b, map_b, level or LEVEL), nl=False)
    else:
        _print(document)
    if not committed:
        raise typer.Exit(1)


def _check_rmf(rmf: bool, level: str | None, as_json: bool) -> None:
    if level is not None and not rmf:
        raise ConfigError(option="level", value=level, reason="goes with --rmf")
    if rmf and as_json:
        raise ConfigError(option="rmf", value=rmf, reason="prints YAML, and --json JSON: leave one of them out")


def rmf_frame(a: Path, resolution_m: float | None) -> Pose2:
    """T_rmf_a: a floor plan's upper left corner is at (0, 0) in RMF, its lower left corner here."""
    from fleetmap.cli.maps import read_plan

    if resolution_m is None:
        return Pose2()
    return Pose2(0.0, -read_plan(a, resolution_m).height * resolution_m)


def as_rmf(T_rmf_robot: Pose2, robot_map: VectorMap, level: str) -> str:
    """The transform as a fleet adapter of Open-RMF reads it: points of both frames in YAML, for `nudged` to fit."""
    import numpy as np
    import yaml

    walls = robot_map.segments_xy[robot_map.obstacle].reshape(-1, 2)
    (x0, y0), (x1, y1) = np.round(walls.min(axis=0), 3).tolist(), np.round(walls.max(axis=0), 3).tolist()
    robot = [[x0, y0], [x1, y0], [x1, y1], [x0, y1]]
    points = {"rmf": np.round(T_rmf_robot.apply(robot), 4).tolist(), "robot": robot}
    return str(yaml.safe_dump({"reference_coordinates": {level: points}}, default_flow_style=None, sort_keys=False))


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
        "covariance": [list(row) for row in found.covariance] if found.outcome == "committed" else None,
        "middle_xy": list(found.middle_xy) if found.outcome == "committed" else None,
        "evidence": _evidence(found.evidence),
        "second": _evidence(found.second),
    }


def _evidence(evidence: Evidence | None) -> dict[str, float] | None:
    if evidence is None:
        return None
    names = ("explained_m", "conflict_m", "visible_m", "fixed_m", "rms_m", "lines", "long_m", "score_m")
    return {name: round(float(getattr(evidence, name)), 4) for name in names}


def _print(document: dict[str, Any]) -> None:
    typer.echo(f"{document['outcome']}: {document['text']}")
    if document["x_m"] is None:
        return
    x, y, yaw = document["x_m"], document["y_m"], document["yaw_rad"]
    where = f"x {x:.3f} m, y {y:.3f} m, yaw {math.degrees(yaw):.3f} degrees"
    if document["outcome"] != "committed":
        typer.echo(f"the best guess, which is not to be relied on: b in a: {where}")
        return
    typer.echo(f"b in a: {where}")
    typer.echo(
        f"as a transform of ROS 2: ros2 run tf2_ros static_transform_publisher --x {x:.4f} --y {y:.4f} "
        f"--yaw {yaw:.6f} --frame-id a --child-frame-id b"
    )


def overlay(grid_a: OccupancyGrid, grid_b: OccupancyGrid, T_a_b: Pose2) -> Image:
    """Both maps in the frame of a: walls of a blue, of b red, what both have dark, free floor of either pale."""
    import numpy as np
    from PIL import Image
    from scipy.ndimage import maximum_filter

    from fleetmap.align.evidence import NEAR_M
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
    picture = np.full((rows * columns, 3), PAPER, np.uint8)
    inks = ((grid_a, grid_a.origin, FREE_A, INK_A), (grid_b, T_a_b @ grid_b.origin, FREE_B, INK_B))
    walls: list[NDArray[np.bool_]] = []
    for state in (FREE, OCCUPIED):  # walls over floors
        for grid, T_a_grid, pale, dark in inks:
            cells = np.floor(T_a_grid.inverse().apply(points) / grid.resolution_m).astype(int)
            inside = (cells >= 0).all(axis=1) & (cells[:, 0] < grid.width) & (cells[:, 1] < grid.height)
            hit = np.zeros(len(points), bool)
            hit[inside] = grid.states_yx()[cells[inside, 1], cells[inside, 0]] == state
            picture[hit] = np.minimum(picture[hit], pale) if state == FREE else np.array(dark, np.uint8)
            walls += [hit.reshape(rows, columns)] if state == OCCUPIED else []
    near = 2 * math.ceil(NEAR_M / step) + 1
    both = [wall & maximum_filter(other, near) for wall, other in (walls, walls[::-1])]
    picture[(both[0] | both[1]).ravel()] = INK_BOTH
    return Image.fromarray(picture.reshape(rows, columns, 3)[::-1])


def legend(picture: Image, a: Path, b: Path, verdict: str) -> Image:
    """The picture with what its colours mean below it, and the outcome."""
    from PIL import Image, ImageDraw

    lines = [
        (INK_BOTH, "walls that both have"),
        (INK_A, f"walls of A alone: {Path(*a.parts[-2:])}"),
        (INK_B, f"walls of B alone: {Path(*b.parts[-2:])}"),
        (None, verdict),
    ]
    width = max(picture.width, *(30 + 7 * len(text) for _, text in lines))
    whole = Image.new("RGB", (width, picture.height + LINE_PX * len(lines) + 8), PAPER)
    whole.paste(picture, (0, 0))
    draw = ImageDraw.Draw(whole)
    for k, (ink, text) in enumerate(lines):
        y = picture.height + 4 + LINE_PX * k
        if ink is not None:
            draw.rectangle((6, y + 3, 18, y + 13), fill=ink)
        draw.text((26 if ink is not None else 6, y), text, fill="black", font_size=13)
    return whole
