"""The merged map as a picture, with the robots' paths."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from fleetmap.model.mergedmap import MergedMap
from fleetmap.report.charts import colour

if TYPE_CHECKING:
    from PIL.Image import Image

LONGEST_PX = 1600
OVERSAMPLED = 2
"""Drawn larger and then reduced: Pillow draws lines without smoothing."""

FREE_RGB, UNKNOWN_RGB, BLOCKED_RGB = (255, 255, 255), (228, 231, 235), (52, 60, 70)
WALL_RGB, FRONTIER_RGB = (24, 30, 38), (240, 160, 60)


@dataclass(frozen=True, slots=True)
class Trail:
    """Where a robot went: (x, y) in metres, fleet frame; ``dead`` if it was lost at the end of it."""

    robot: str
    points_xy: tuple[tuple[float, float], ...]
    dead: bool = False


def draw_map(merged: MergedMap, trails: tuple[Trail, ...] = ()) -> Image:
    """Free floor white, walls dark, frontiers orange, one coloured path a robot; y points up."""
    from PIL import Image, ImageDraw

    if not len(merged):
        return Image.new("RGB", (400, 200), UNKNOWN_RGB)
    grid = merged.to_grid()
    palette = np.array([FREE_RGB, BLOCKED_RGB, UNKNOWN_RGB], np.uint8)
    cells = Image.fromarray(palette[grid.states_yx()[::-1]])
    scale = max(1, min(8, OVERSAMPLED * LONGEST_PX // max(cells.size)))
    image = cells.resize((cells.width * scale, cells.height * scale), Image.Resampling.NEAREST)
    draw = ImageDraw.Draw(image)

    def pixels(points: object) -> list[tuple[float, float]]:
        local = grid.origin.inverse().apply(np.asarray(points, np.float64)) / grid.resolution_m
        return [(x * scale, (grid.height - y) * scale) for x, y in local.reshape(-1, 2).tolist()]

    line = max(2, round(0.03 / grid.resolution_m * scale))
    for mask, rgb in ((merged.frontier, FRONTIER_RGB), (merged.obstacle, WALL_RGB)):
        for a, b in merged.segments_xy[mask]:
            draw.line(pixels([a, b]), fill=rgb, width=line)
    for k, trail in enumerate(trails):
        if not trail.points_xy:
            continue
        points = pixels(trail.points_xy)
        draw.line(points, fill=colour(k), width=2 * line, joint="curve")
        dot(draw, points[0], 3 * line, colour(k), hollow=True)
        if trail.dead:
            cross(draw, points[-1], 5 * line, colour(k), width=2 * line)
        else:
            dot(draw, points[-1], 4 * line, colour(k))
    smaller = min(1.0, LONGEST_PX / max(image.size))
    size = (math.ceil(image.width * smaller), math.ceil(image.height * smaller))
    return image.resize(size, Image.Resampling.LANCZOS)


def dot(draw: object, at: tuple[float, float], radius: float, fill: str, *, hollow: bool = False) -> None:
    """A disc, or a white one with a coloured rim: where a path ends, or begins."""
    from PIL import ImageDraw

    assert isinstance(draw, ImageDraw.ImageDraw)
    x, y = at
    box = (x - radius, y - radius, x + radius, y + radius)
    draw.ellipse(box, fill="white" if hollow else fill, outline=fill, width=max(1, round(radius / 3)))


def cross(draw: object, at: tuple[float, float], reach: float, fill: str, *, width: int) -> None:
    """Where a robot was lost."""
    from PIL import ImageDraw

    assert isinstance(draw, ImageDraw.ImageDraw)
    x, y = at
    for dx, dy in ((reach, reach), (reach, -reach)):
        draw.line([(x - dx, y - dy), (x + dx, y + dy)], fill=fill, width=width)
