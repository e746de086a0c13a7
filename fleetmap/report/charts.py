"""Line charts as SVG text, by hand: a report needs neither a script nor a plotting library."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

COLOURS = ("#2f6fb0", "#d1642b", "#3c9264", "#a4508b", "#b08a1e", "#5b6b7b", "#c0445c", "#2a9aa5")
"""One a robot, in order, then again; the same in the picture and in the charts."""

WIDTH, HEIGHT = 560, 300
LEFT, RIGHT, TOP, BOTTOM = 52, 14, 12, 34
MOST_POINTS = 400


@dataclass(frozen=True, slots=True)
class Curve:
    """One line: (x, y) points, x ascending, in a colour of CSS."""

    name: str
    points: tuple[tuple[float, float], ...]
    colour: str


@dataclass(frozen=True, slots=True)
class Chart:
    """Some curves over seconds."""

    title: str
    unit: str
    curves: tuple[Curve, ...]
    logarithmic: bool = False


def chart_svg(chart: Chart, time_label: str = "simulated s") -> str:
    """The chart as an ``<svg>`` element, with a legend."""
    points = [p for curve in chart.curves for p in curve.points if p[1] > 0 or not chart.logarithmic]
    x_most = max((x for x, _ in points), default=1.0) or 1.0
    y_most = max((y for _, y in points), default=1.0) or 1.0
    if chart.logarithmic:
        low = math.floor(math.log10(min((y for _, y in points), default=1.0)))
        high = max(math.ceil(math.log10(y_most)), low + 1)
        y_ticks = [10.0**k for k in range(low, high + 1)]
    else:
        y_ticks = nice_ticks(y_most)
    x_ticks = nice_ticks(x_most)

    def place(x: float, y: float) -> tuple[float, float]:
        part = (math.log10(max(y, 10.0**low)) - low) / (high - low) if chart.logarithmic else y / y_ticks[-1]
        across = LEFT + x / x_ticks[-1] * (WIDTH - LEFT - RIGHT)
        return across, HEIGHT - BOTTOM - part * (HEIGHT - TOP - BOTTOM)

    parts = [f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape(chart.title)}">']
    for y in y_ticks:
        _, down = place(0, y)
        parts.append(f'<line class="grid" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{down:.1f}" y2="{down:.1f}"/>')
        parts.append(f'<text class="tick" x="{LEFT - 8}" y="{down + 4:.1f}" text-anchor="end">{number(y)}</text>')
    for x in x_ticks:
        across, _ = place(x, y_ticks[0])
        parts.append(f'<text class="tick" x="{across:.1f}" y="{HEIGHT - 14}" text-anchor="middle">{number(x)}</text>')
    parts.append(
        f'<text class="tick" x="{WIDTH - RIGHT}" y="{HEIGHT - 1}" text-anchor="end">{escape(time_label)}</text>'
    )
    for curve in chart.curves:
        drawn = [place(x, y) for x, y in thinned(curve.points) if y > 0 or not chart.logarithmic]
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in drawn)
        parts.append(f'<polyline points="{path}" fill="none" stroke="{curve.colour}" stroke-width="2"/>')
    parts.append("</svg>")
    legend = "".join(
        f'<li><span style="background:{curve.colour}"></span>{escape(curve.name)}</li>' for curve in chart.curves
    )
    return "".join(parts) + f'<ul class="legend">{legend}</ul>'


def colour(index: int) -> str:
    """The colour of the robot with this index."""
    return COLOURS[index % len(COLOURS)]


def nice_ticks(most: float, count: int = 5) -> list[float]:
    """From 0 to at least ``most``, in steps of 1, 2 or 5 times a power of ten."""
    rough = most / count
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(k * power for k in (1, 2, 5, 10) if k * power >= rough - 1e-12)
    return [k * step for k in range(math.ceil(most / step - 1e-9) + 1)]


def thinned(points: Sequence[tuple[float, float]]) -> Sequence[tuple[float, float]]:
    """At most about ``MOST_POINTS`` of the points, first and last included."""
    step = max(1, len(points) // MOST_POINTS)
    return [*points[:-1:step], *points[-1:]]


def number(value: float) -> str:
    """A short label."""
    return f"{value:,.0f}" if value >= 1 or value == 0 else f"{value:g}"
