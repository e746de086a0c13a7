"""``report.html``: one page that needs nothing but itself."""

from __future__ import annotations

import base64
import io
from dataclasses import dataclass
from html import escape
from pathlib import Path

from fleetmap.model.mergedmap import MergedMap
from fleetmap.report.charts import Chart, chart_svg, colour
from fleetmap.report.picture import Trail, draw_map

STYLE = """
:root { color-scheme: light; --ink: #1c232b; --soft: #66717d; --rule: #e1e5e9; --paper: #fff; --ground: #f4f6f8; }
* { box-sizing: border-box; }
body { margin: 0; background: var(--ground); color: var(--ink); font: 15px/1.5 system-ui, "Segoe UI", sans-serif; }
main { max-width: 1180px; margin: 0 auto; padding: 36px 24px 60px; }
h1 { font-size: 27px; line-height: 1.2; margin: 0 0 4px; letter-spacing: -.01em; }
h2 { font-size: 17px; margin: 0 0 2px; }
p { margin: 0; }
.soft { color: var(--soft); font-size: 13px; }
.tiles { display: grid; grid-template-columns: repeat(auto-fill, minmax(250px, 1fr)); gap: 12px; margin: 26px 0; }
.card { background: var(--paper); border: 1px solid var(--rule); border-radius: 10px; padding: 16px 18px; }
.tiles .card b { display: block; font-size: 25px; font-weight: 650; letter-spacing: -.01em; margin: 1px 0; }
.tiles .name { font-size: 12px; text-transform: uppercase; letter-spacing: .06em; color: var(--soft); }
.note { background: #fff6ec; border: 1px solid #f0c795; border-radius: 10px; padding: 12px 18px; margin-bottom: 12px; }
.map img { width: 100%; height: auto; display: block; margin-top: 12px; border-radius: 6px; }
.pair { display: grid; grid-template-columns: repeat(auto-fit, minmax(420px, 1fr)); gap: 12px; margin: 12px 0; }
svg { width: 100%; height: auto; display: block; margin-top: 8px; }
svg .grid { stroke: var(--rule); } svg .tick { font-size: 11px; fill: var(--soft); }
.legend { list-style: none; display: flex; flex-wrap: wrap; gap: 4px 16px; margin: 8px 0 0; padding: 0;
  font-size: 13px; }
.legend span { display: inline-block; width: 12px; height: 12px; border-radius: 3px; margin-right: 6px;
  vertical-align: -1px; }
table { width: 100%; border-collapse: collapse; margin-top: 8px; font-variant-numeric: tabular-nums; }
th, td { text-align: right; padding: 7px 10px; border-bottom: 1px solid var(--rule); }
th { font-size: 12px; color: var(--soft); font-weight: 600; } th:first-child, td:first-child { text-align: left; }
tr:last-child td { border-bottom: 0; }
"""

SIZES = (
    "to one receiver, over the simulated time. Payload: what was handed to the transport, of grids the grids alone. "
    "Wire: the same on an IP link, with the framing of Zenoh, TCP and IP, acknowledgements and keep-alives; "
    "poses, goals and heartbeats count on all sides"
)
"""What the table of sizes means."""
TRAILS = "; a ring is a start, a disc an end, a cross where a robot was lost"


@dataclass(frozen=True, slots=True)
class Report:
    """All that the page shows.

    Parameters
    ----------
    title, subtitle : the head
    merged, trails : the picture
    tiles : (name, value, explanation) each
    charts : each a card
    table : header and rows
    sizes : header and rows: payload and wire
    notes : what a reader must not miss, such as robots that were lost
    map_title, sizes_about, time_label : words above the picture and the sizes, and under the charts
    """

    title: str
    subtitle: str
    merged: MergedMap
    trails: tuple[Trail, ...]
    tiles: tuple[tuple[str, str, str], ...]
    charts: tuple[Chart, ...]
    table: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()
    sizes: tuple[tuple[str, ...], ...] = ()
    map_title: str = "The merged map and the robots' paths"
    sizes_about: str = SIZES
    time_label: str = "simulated s"


def write_report(report: Report, path: Path) -> None:
    """Write the page; pictures and styles are inside it."""
    path.write_text(render(report), encoding="utf-8")


def render(report: Report) -> str:
    """The page's text."""
    tiles = "".join(
        f'<div class="card"><div class="name">{escape(name)}</div><b>{escape(value)}</b>'
        f'<div class="soft">{escape(about)}</div></div>'
        for name, value, about in report.tiles
    )
    about_sizes = f'<p class="soft">{escape(report.sizes_about)}</p>'
    sizes = f'<section class="card"><h2>Bytes</h2>{about_sizes}{table(report.sizes)}</section>'
    notes = "".join(f'<p class="note">{escape(note)}</p>' for note in report.notes)
    charts = "".join(
        f'<section class="card"><h2>{escape(chart.title)}</h2><p class="soft">{escape(chart.unit)}</p>'
        f"{chart_svg(chart, report.time_label)}</section>"
        for chart in report.charts
    )
    robots = f'<section class="card"><h2>Robots</h2>{table(report.table)}</section>' if report.table else ""
    trail_words = TRAILS if report.trails else ""
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(report.title)}</title>
<link rel="icon" href="data:,">
<style>{STYLE}</style>
</head>
<body>
<main>
<h1>{escape(report.title)}</h1>
<p class="soft">{escape(report.subtitle)}</p>
<div class="tiles">{tiles}</div>
{notes}
<section class="card map"><h2>{escape(report.map_title)}</h2>
<p class="soft">white: free floor; dark: walls; grey: unknown; orange: frontiers that are left{trail_words}</p>
{picture(report)}
<ul class="legend">{trail_legend(report.trails)}</ul></section>
<div class="pair">{charts}</div>
{sizes if report.sizes else ""}
{robots}
</main>
</body>
</html>
"""


def picture(report: Report) -> str:
    """The map as an inline PNG."""
    file = io.BytesIO()
    image = draw_map(report.merged, report.trails)
    image.quantize(128).save(file, "PNG", optimize=True)
    data = base64.b64encode(file.getvalue()).decode()
    size = f'width="{image.width}" height="{image.height}"'
    return f'<img alt="merged map with the robots\' paths" {size} src="data:image/png;base64,{data}">'


def trail_legend(trails: tuple[Trail, ...]) -> str:
    """One entry a robot."""
    return "".join(
        f'<li><span style="background:{colour(k)}"></span>{escape(trail.robot)}{" (lost)" if trail.dead else ""}</li>'
        for k, trail in enumerate(trails)
    )


def table(rows: tuple[tuple[str, ...], ...]) -> str:
    """A table; the first row is its head."""
    if not rows:
        return ""
    head = "".join(f"<th>{escape(cell)}</th>" for cell in rows[0])
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows[1:])
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
