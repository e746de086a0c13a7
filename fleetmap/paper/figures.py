"""Figures of terrains, grids and vector maps, nine to a page, and one that shows them closely."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.errors import ConfigError
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN
from fleetmap.paper.bars import draw_scores, draw_sizes
from fleetmap.paper.experiment import Experiment
from fleetmap.paper.vectors import PROFILES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WHITE, DARK, GREY = (255, 255, 255), (24, 30, 38), (199, 205, 212)
WALL, FRONTIER, REST, PATH = "#c2361f", "#e8891c", "#7a8794", "#2f6fb0"

PANEL_IN, PANEL_PX = 3.4, 620
DPI = 200


def need_matplotlib() -> None:
    """Say at once if the figures can't be drawn later.

    Raises
    ------
    ConfigError : matplotlib is not installed
    """
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        raise ConfigError(option="plot", value="matplotlib", reason="missing: pip install 'fleetmap[plot]'") from None


def write_figures(experiments: Sequence[Experiment], document: Mapping[str, Any], out: Path) -> dict[str, str]:
    """Write all figures as PNG into ``out``.

    Returns
    -------
    dict : file name to caption, in the order of the page
    """
    captions = {}

    def save(figure: Figure, name: str, caption: str) -> None:
        # No version or time of the library goes into the file.
        figure.savefig(out / name, dpi=DPI, metadata={"Software": None})
        captions[name] = caption

    states = "white: free; dark: occupied; grey: unknown"
    save(draw_detail(experiments), "detail.png", f"The smallest terrains: truth, grid, and vector map ({states}).")
    save(draw_sizes(document), "sizes.png", "Sizes by format, the mean of the terrains of each size (logarithmic).")
    save(draw_scores(document), "scores.png", "Scores against the truth: medians over the terrains, lowest to highest.")
    truths = [(e.terrain.name, e.survey.truth, e.survey.tour.places_xy) for e in experiments]
    save(draw_grids(truths), "terrains.png", f"The terrains, as the truth has them, and the robot's way ({states}).")
    grids = [(e.terrain.name, e.survey.grid, None) for e in experiments]
    save(draw_grids(grids), "grids.png", f"The grids that the mapper made ({states}).")
    for profile in PROFILES:
        save(
            draw_vectors(experiments, profile),
            f"vectors_{profile}.png",
            f"The vector maps of these grids, profile {profile} (red: walls; orange: frontiers; grey: others).",
        )
    return captions


def draw_grids(panels: Sequence[tuple[str, OccupancyGrid, NDArray[np.float64] | None]]) -> Figure:
    """Grids, three to a row, each with its title and, if given, a path in cells (x, y)."""
    figure, axes = panel_figure(len(panels), 3)
    for ax, (title, grid, path_xy) in zip(axes, panels, strict=False):
        show_grid(ax, grid, most_px=PANEL_PX)
        ax.set_title(title, fontsize=9)
        if path_xy is not None:
            ax.plot(*(path_xy * grid.resolution_m).T, color=PATH, linewidth=0.5, alpha=0.8)
    return figure


def draw_vectors(experiments: Sequence[Experiment], profile: str) -> Figure:
    """Vector maps, three to a row, with the number of their edges."""
    figure, axes = panel_figure(len(experiments), 3)
    for ax, experiment in zip(axes, experiments, strict=False):
        show_edges(ax, experiment, profile, line=0.5 if experiment.terrain.size_m > 10 else 1.0)
        ax.set_title(f"{experiment.terrain.name}: {len(experiment.from_grid[profile]):,} edges", fontsize=9)
    return figure


def draw_detail(experiments: Sequence[Experiment]) -> Figure:
    """Of each kind the smallest terrain: truth, grid, and the vector map over the grid."""
    smallest = min(e.terrain.size_m for e in experiments)
    chosen = [e for e in experiments if e.terrain.size_m == smallest]
    figure, axes = panel_figure(3 * len(chosen), 3)
    for k, experiment in enumerate(chosen):
        truth, grid, vector = axes[3 * k : 3 * k + 3]
        show_grid(truth, experiment.survey.truth)
        show_grid(grid, experiment.survey.grid)
        show_grid(vector, experiment.survey.grid, faint=True)
        show_edges(vector, experiment, PROFILES[0], line=1.0)
        for ax, what in ((truth, "truth"), (grid, "grid"), (vector, "vector map of the grid")):
            ax.set_title(f"{experiment.terrain.name}: {what}", fontsize=9)
    return figure


def panel_figure(count: int, columns: int) -> tuple[Figure, list[Axes]]:
    """An empty figure of square panels without ticks, and their axes row by row."""
    from matplotlib.figure import Figure

    rows = math.ceil(count / columns)
    figure = Figure(figsize=(columns * PANEL_IN, rows * (PANEL_IN + 0.22)), layout="constrained")
    axes = [figure.add_subplot(rows, columns, k + 1) for k in range(count)]
    for ax in axes:
        ax.set_xticks([])
        ax.set_yticks([])
    return figure, axes


def show_grid(ax: Axes, grid: OccupancyGrid, *, most_px: int | None = None, faint: bool = False) -> None:
    """A grid in metres; if ``most_px`` is given, with at most so many pixels a side."""
    states = grid.states_yx()
    if most_px is not None:
        states = shrink(states, math.ceil(max(states.shape) / most_px))
    palette = np.array([WHITE, DARK, GREY], np.float64)
    if faint:
        palette = 255 - (255 - palette) * 0.45
    size_m = grid.width * grid.resolution_m, grid.height * grid.resolution_m
    image = palette[states].astype(np.uint8)
    ax.imshow(image, origin="lower", extent=(0, size_m[0], 0, size_m[1]), interpolation="nearest")


def shrink(states: NDArray[np.uint8], factor: int) -> NDArray[np.uint8]:
    """One cell for each ``factor`` x ``factor``: occupied if any of them is, so that thin walls stay in sight."""
    if factor <= 1:
        return states
    height, width = (-(-side // factor) * factor for side in states.shape)
    padded = np.full((height, width), UNKNOWN, np.uint8)
    padded[: states.shape[0], : states.shape[1]] = states
    blocks = padded.reshape(height // factor, factor, width // factor, factor)
    small = np.where((blocks == FREE).mean(axis=(1, 3)) >= 0.5, FREE, UNKNOWN).astype(np.uint8)
    small[(blocks == OCCUPIED).any(axis=(1, 3))] = OCCUPIED
    return small


def show_edges(ax: Axes, experiment: Experiment, profile: str, *, line: float) -> None:
    """The edges of a vector map in metres."""
    from matplotlib.collections import LineCollection

    found, grid = experiment.from_grid[profile], experiment.survey.grid
    rest = ~(found.obstacle | found.frontier)
    for mask, rgb in ((rest, REST), (found.frontier, FRONTIER), (found.obstacle, WALL)):
        ax.add_collection(LineCollection(list(found.segments_xy[mask]), colors=rgb, linewidths=line))
    ax.set_xlim(0, grid.width * grid.resolution_m)
    ax.set_ylim(0, grid.height * grid.resolution_m)
    ax.set_aspect("equal")
