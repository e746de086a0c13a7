"""The paper's Fig. 4 with our bars: sizes by format, scores by map; published values are marked."""

from __future__ import annotations

import statistics
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from fleetmap.paper.formats import FORMATS
from fleetmap.paper.published import GRID_KB, LARGEST_M, SCORE_RANGES, VECTOR_KB, pick
from fleetmap.paper.scores import PAPER_METRICS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = ("#5b6b7b", "#9aa7b4", "#d1642b", "#eba67c", "#2f6fb0")
"""Of the formats, in their order: grids grey, plain vectors orange, our own blue."""

MAP_COLOURS = (
    ("#5b6b7b", "white"),
    ("#2f6fb0", "white"),
    ("#9dbfe0", "black"),
    ("#3c9264", "white"),
    ("#9ccdb2", "black"),
)
"""Of bars and the figures in them: the grid's, then in pairs a profile those made of the grid and of the truth."""

PUBLISHED = "#111111"


def draw_sizes(document: Mapping[str, Any]) -> Figure:
    """Bytes of each format, one group of bars a terrain size, one panel a profile."""
    from matplotlib.figure import Figure

    profiles = document["profiles"]
    figure = Figure(figsize=(7.2 * len(profiles), 4.0), layout="constrained")
    for k, profile in enumerate(profiles):
        ax = figure.add_subplot(1, len(profiles), k + 1)
        draw_size_bars(ax, document["experiments"], profile)
        ax.set_title(f"Size by format, profile {profile}", fontsize=10)
    return figure


def draw_size_bars(ax: Axes, experiments: list[dict[str, Any]], profile: str) -> None:
    """Fill one panel."""
    sizes_m = sorted({row["size_m"] for row in experiments})
    width = 0.84 / len(FORMATS)
    for f, (key, label) in enumerate(FORMATS.items()):
        where = [k + (f - (len(FORMATS) - 1) / 2) * width for k in range(len(sizes_m))]
        means_kb = [
            statistics.mean(
                {**row["sizes"]["grid"], **row["sizes"]["vector_from_grid"][profile]}[key]
                for row in experiments
                if row["size_m"] == size
            )
            / 1000
            for size in sizes_m
        ]
        bars = ax.bar(where, means_kb, width * 0.94, color=COLOURS[f], label=label)
        ax.bar_label(bars, [f"{kb:,.0f}" if kb >= 100 else f"{kb:.2g}" for kb in means_kb], fontsize=7, padding=2)
        published_kb = {"pgm": GRID_KB, "plain": VECTOR_KB}.get(key)
        if published_kb is not None and LARGEST_M in sizes_m:
            x = where[sizes_m.index(LARGEST_M)]
            first = "_" if key == "pgm" else f"published, {LARGEST_M} m: {GRID_KB:,.1f} and {VECTOR_KB} kB"
            ax.hlines(published_kb, x - 0.6 * width, x + 0.6 * width, color=PUBLISHED, linewidth=2.2, label=first)
    ax.set_yscale("log")
    ax.set_ylabel("kB (1000 bytes)")
    low, high = ax.get_ylim()
    ax.set_ylim(low, high * 12)  # room for the legend
    ax.set_xticks(range(len(sizes_m)), [f"{size} m" for size in sizes_m])
    ax.legend(fontsize=8, ncols=2, loc="upper left", frameon=False)
    tidy(ax)


def draw_scores(document: Mapping[str, Any]) -> Figure:
    """Medians over the terrains of each metric, one bar a map, with the lowest and highest terrain as a line."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 4.2), layout="constrained")
    ax = figure.add_subplot()
    rows = document["experiments"]
    maps = [("grid", "grid", "")]
    for profile in document["profiles"]:
        maps.append((f"vector map of the grid, {profile}", "vector_from_grid", profile))
        maps.append((f"vector map of the truth, {profile}", "vector_from_truth", profile))
    width = 0.8 / len(maps)
    for m, (label, key, profile) in enumerate(maps):
        where = [k + (m - (len(maps) - 1) / 2) * width for k in range(len(PAPER_METRICS))]
        values = [[pick(row["scores"][key], profile)[metric] for row in rows] for metric in PAPER_METRICS]
        middle = [statistics.median(found) for found in values]
        spread = [
            [a - min(found) for a, found in zip(middle, values, strict=True)],
            [max(found) - a for a, found in zip(middle, values, strict=True)],
        ]
        colour, ink = MAP_COLOURS[m % len(MAP_COLOURS)]
        ax.bar(where, middle, width * 0.94, color=colour, label=label)
        ax.errorbar(where, middle, yerr=spread, fmt="none", ecolor=PUBLISHED, elinewidth=0.8, capsize=2)
        for x, a in zip(where, middle, strict=True):
            figures = f"{a:.1f}" if a < 99.95 else "100"
            ax.text(x, 2, figures, ha="center", va="bottom", fontsize=7 if len(maps) < 4 else 6.5, color=ink)
    for k, metric in enumerate(PAPER_METRICS):
        low, high = SCORE_RANGES[metric]
        top = 100.0 if high is None else high
        ax.fill_between([k - 0.47, k + 0.47], low, top, facecolor="none", edgecolor=PUBLISHED, linestyle=(0, (3, 2)),
                        linewidth=1.0, label="published" if k == 0 else None)  # fmt: skip
    ax.set_xticks(range(len(PAPER_METRICS)), PAPER_METRICS)
    ax.set_ylabel("%")
    ax.set_ylim(0, 119)
    ax.set_yticks(range(0, 101, 20))
    ax.set_title("Scores against the truth", fontsize=10)
    ax.legend(fontsize=8, ncols=4, loc="upper center", frameon=False)
    tidy(ax)
    return figure


def tidy(ax: Axes) -> None:
    """Lines only where they help."""
    ax.spines[["top", "right"]].set_visible(False)
    ax.grid(axis="y", color="#e1e5e9", linewidth=0.6)
    ax.set_axisbelow(True)
    ax.tick_params(labelsize=8)
