"""``report.html`` of the experiments: tables and figures on one page that needs nothing but itself."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

from fleetmap.paper.tables import Table, make_tables
from fleetmap.report.html import STYLE, table

MORE_STYLE = """
main { max-width: 1280px; }
section.card { margin-bottom: 14px; overflow-x: auto; }
section.card img { width: 100%; height: auto; display: block; margin-top: 12px; }
section.card.narrow img { max-width: 900px; margin-left: auto; margin-right: auto; }
table { font-size: 13px; } th, td { padding: 5px 9px; white-space: nowrap; }
"""

NARROW = ("sizes.png", "scores.png")


def write_page(document: Mapping[str, Any], figures: Mapping[str, str], path: Path) -> None:
    """Write the page. ``figures``: name of a PNG beside the page, which goes into it, to its caption."""
    path.write_text(render(document, figures, path.parent), encoding="utf-8")


def render(document: Mapping[str, Any], figures: Mapping[str, str], folder: Path) -> str:
    """The page's text."""
    count = len(document["experiments"])
    tables = make_tables(document)
    first, rest = tables[:1], tables[1:]
    bars = {name: caption for name, caption in figures.items() if name in NARROW}
    maps = {name: caption for name, caption in figures.items() if name not in NARROW}
    body = [
        tiles(document),
        *(table_card(found) for found in first),
        *(figure_card(folder / name, caption) for name, caption in list(maps.items())[:1]),
        *(figure_card(folder / name, caption) for name, caption in bars.items()),
        *(table_card(found) for found in rest),
        *(figure_card(folder / name, caption) for name, caption in list(maps.items())[1:]),
    ]
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>The paper's experiments</title>
<link rel="icon" href="data:,">
<style>{STYLE}{MORE_STYLE}</style>
</head>
<body>
<main>
<h1>The paper's experiments</h1>
<p class="soft">“Vector Maps: a Lightweight and Accurate Map Format for Multi-Robot Systems” (2016), run again on \
{count} generated terrains, in cells of 5 cm</p>
{"".join(body)}
</main>
</body>
</html>
"""


def tiles(document: Mapping[str, Any]) -> str:
    """What a reader looks for first, of the first profile."""
    profile = document["profiles"][0]
    medians = document["medians"]
    gaps, ratios = medians["vector_minus_grid"][profile], medians["ratios"][profile]
    scores = medians["vector_from_grid"][profile]
    found = [
        (
            "zipped PGM / our bytes",
            f"{ratios['pgm_zip_per_fleetmap']:.1f} x",
            f"median; plain segments against PGM: {ratios['pgm_per_plain']:.0f} x",
        ),
        ("MS of the vector map", f"{scores['MS']:.1f} %", f"median; {gaps['MS']:+.2f} points against its grid"),
        ("OPDF, UPDF", f"{scores['OPDF']:.1f}, {scores['UPDF']:.1f} %", f"median; {gaps['OPDF']:+.2f}, "
         f"{gaps['UPDF']:+.2f} points against its grid"),
        ("CC, PC", f"{scores['CC']:.1f}, {scores['PC']:.1f} %", f"median; {gaps['CC']:+.2f}, {gaps['PC']:+.2f} points "
         "against its grid"),
    ]  # fmt: skip
    cards = "".join(
        f'<div class="card"><div class="name">{escape(name)}</div><b>{escape(value)}</b>'
        f'<div class="soft">{escape(about)}</div></div>'
        for name, value, about in found
    )
    return f'<div class="tiles">{cards}</div>'


def table_card(found: Table) -> str:
    """A table with its title and note."""
    rows = table((found.columns, *found.rows))
    return (
        f'<section class="card"><h2>{escape(found.title)}</h2><p class="soft">{escape(found.note)}</p>{rows}</section>'
    )


def figure_card(path: Path, caption: str) -> str:
    """A figure, inside the page."""
    from PIL import Image

    with Image.open(path) as image:
        width, height = image.size
    data = base64.b64encode(path.read_bytes()).decode()
    size = f'width="{width}" height="{height}"'
    narrow = " narrow" if path.name in NARROW else ""
    return (
        f'<section class="card{narrow}"><h2>{escape(caption)}</h2>'
        f'<img alt="{escape(caption)}" {size} src="data:image/png;base64,{data}"></section>'
    )
