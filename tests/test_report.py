"""The report: self-contained, well-formed, and saying what it was given."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from xml.etree import ElementTree

import numpy as np
import pytest

from fleetmap.model.mergedmap import MergedMap
from fleetmap.report import Chart, Curve, Report, Trail, colour, draw_map, write_report
from fleetmap.report.charts import chart_svg, nice_ticks
from fleetmap.report.picture import UNKNOWN_RGB


def square() -> MergedMap:
    """A room of 4 m x 3 m: walls on three sides, a frontier on the right."""
    wide, high = 800, 600
    return MergedMap(
        np.array(
            [
                # y0, x0, y1, x1, left, right, obstacle, thickness
                [0, 0, 0, wide, 0, 1, 1, 10],
                [0, 0, high, 0, 1, 0, 1, 10],
                [0, wide, high, wide, 0, 2, 0, 0],
                [high, 0, high, wide, 1, 0, 1, 10],
            ],
            np.int32,
        )
    )


def report(**changes: object) -> Report:
    curves = (Curve("r0", ((0, 0), (10, 50), (20, 100)), colour(0)), Curve("<b>", ((0, 1), (20, 2)), colour(1)))
    fields: dict[str, object] = {
        "title": "two robots & one <room>",
        "subtitle": "seed 1",
        "merged": square(),
        "trails": (Trail("r0", ((1.0, 1.0), (2.0, 2.0))), Trail("r1", ((1.0, 2.0), (3.0, 2.0)), dead=True)),
        "tiles": (("covered", "99 %", "of the floor"),),
        "charts": (Chart("Coverage", "%", curves), Chart("Bytes", "kB", curves, logarithmic=True)),
        "table": (("robot", "driven m"), ("r0", "12.5")),
        "notes": ("r1 was lost after 30 s",),
    }
    return Report(**{**fields, **changes})  # type: ignore[arg-type]


class Checker(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.links: list[str] = []
        self.tags: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.links += [value or "" for name, value in attrs if name in ("src", "href", "srcset", "data")]
        if tag not in ("meta", "link", "img", "br", "line", "polyline"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag in self.open:
            assert self.open.pop() == tag


def test_the_page_is_one_file_that_refers_to_nothing_else_and_runs_nothing(tmp_path) -> None:
    write_report(report(), tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    checker = Checker()
    checker.feed(text)
    assert checker.open == []
    assert "script" not in checker.tags
    assert checker.links
    assert all(link.startswith("data:") for link in checker.links)
    assert "url(" not in text
    assert "@import" not in text


def test_the_page_says_what_it_was_given_and_nothing_is_taken_for_markup(tmp_path) -> None:
    write_report(report(), tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    for expected in ("two robots &amp; one &lt;room&gt;", "r1 was lost after 30 s", "99 %", "12.5", "r1 (lost)"):
        assert expected in text
    assert "<room>" not in text
    assert "<b></li>" not in text


@pytest.mark.parametrize("logarithmic", [False, True])
def test_a_chart_is_well_formed_and_its_points_lie_inside(logarithmic: bool) -> None:
    chart = Chart("t", "u", (Curve("a", ((0, 0), (30, 7), (100, 4200)), "#123456"),), logarithmic=logarithmic)
    svg = re.match(r"<svg.*</svg>", chart_svg(chart))
    assert svg
    root = ElementTree.fromstring(svg.group())
    _, _, width, height = map(float, root.attrib["viewBox"].split())
    points = [tuple(map(float, p.split(","))) for p in root.find("polyline").attrib["points"].split()]
    assert len(points) == (2 if logarithmic else 3)
    assert all(0 <= x <= width and 0 <= y <= height for x, y in points)
    assert [y for _, y in points] == sorted((y for _, y in points), reverse=True)


def test_an_empty_run_still_has_a_report(tmp_path) -> None:
    empty = MergedMap(np.zeros((0, 8), np.int32))
    write_report(
        report(merged=empty, trails=(), charts=(Chart("c", "u", ()), Chart("d", "u", (), logarithmic=True)), table=()),
        tmp_path / "report.html",
    )
    assert (tmp_path / "report.html").stat().st_size > 1000


@pytest.mark.parametrize("most", [0.003, 0.9, 1.0, 7.0, 100.0, 462.0, 12345.0])
def test_ticks_are_round_and_reach_the_maximum(most: float) -> None:
    ticks = nice_ticks(most)
    assert ticks[0] == 0
    assert most <= ticks[-1] * (1 + 1e-9)
    assert ticks[-1] <= most * 1.5
    assert 3 <= len(ticks) <= 8


def test_the_picture_shows_free_floor_walls_and_paths_with_y_up() -> None:
    image = draw_map(square(), (Trail("r0", ((1.0, 0.5), (3.0, 0.5))),))
    pixels = np.asarray(image).astype(int)
    height, width, _ = pixels.shape
    assert width > height
    assert (pixels[height // 3, width // 2] == 255).all()
    assert pixels[height // 3 : height * 2 // 3, :12].min() < 80  # the wall on the left
    path = np.array([int(colour(0)[k : k + 2], 16) for k in (1, 3, 5)])
    rows, _ = np.nonzero((np.abs(pixels - path) < 12).all(axis=2))
    assert rows.mean() > height * 0.6  # low y, so low in the picture
    assert (np.asarray(draw_map(MergedMap(np.zeros((0, 8), np.int32))))[0, 0] == UNKNOWN_RGB).all()
