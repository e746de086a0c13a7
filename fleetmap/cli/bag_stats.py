"""``fleetmap stats BAG``: what a bag's maps cost, and what they would have cost as vectors."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer

from fleetmap.bridges.bag_stats import BagCost, Thresholds, TopicCost, judge
from fleetmap.cli.output import print_table, progress_bar
from fleetmap.model.kernel_cache import modules_of
from fleetmap.model.kernel_compiler import compile_ahead

NAMES = {
    "bag": "as it is in the bag",
    "grid_gzip_full": "whole grids, gzip -6",
    "grid_gzip_updates": "changed rectangles, gzip -6",
    "vector": "fleetmap: differences of vectors",
}
COLOURS = {"bag": "#9aa4ae", "grid_gzip_full": "#4d5863", "grid_gzip_updates": "#2f6fb0", "vector": "#c0445c"}


def bag_document(path: Path, *, topics: list[str], thresholds: Thresholds, out: Path | None) -> dict[str, Any]:
    """Judge a bag, with a progress bar, and write the report if there is a folder for it."""
    # Here, where it is shown: both processes would wait for the same kernels.
    compile_ahead(modules_of("model", "vectorize", "codecs", *(["merge"] if out else [])))
    with progress_bar(str(path), "messages") as tell:
        cost = judge(path, topics=topics, thresholds=thresholds, on_progress=tell)
    document = as_document(cost)
    if out is not None:
        document["report"] = str(write_bag_report(cost, out))
    return document


def as_document(cost: BagCost) -> dict[str, Any]:
    """The document of `fleetmap stats BAG --json`."""
    return {
        "bag": str(cost.path),
        "duration_s": round(cost.duration_s, 3),
        "topics": [topic_document(topic, cost.duration_s) for topic in cost.topics],
    }


def topic_document(topic: TopicCost, duration_s: float) -> dict[str, Any]:
    """One topic: bytes, how many times as much as the vectors, and bytes a second."""
    codecs = {"bag": topic.size_bytes, **topic.sizes}
    vector = codecs.get("vector", 0)
    return {
        "topic": topic.name,
        "messages": topic.messages,
        "updates": topic.updates,
        "refused": topic.refused,
        "refused_because": topic.reason,
        **topic.about,
        "codecs": codecs,
        "ratios": {name: round(size / vector, 2) for name, size in codecs.items()} if vector else {},
        "bytes_per_s": {name: round(size / duration_s, 2) for name, size in codecs.items()} if duration_s > 0 else {},
        "series": [[round(t_s, 3), sizes] for t_s, sizes in topic.series],
    }


def print_bag(document: dict[str, Any]) -> None:
    """Tables for people."""
    for topic in document["topics"]:
        rows = []
        for name, label in NAMES.items():
            if name not in topic["codecs"]:
                continue
            ratio, rate = topic["ratios"].get(name), topic["bytes_per_s"].get(name)
            times = "" if ratio is None else f"{ratio:,.1f}"
            rows.append([label, f"{topic['codecs'][name]:,}", times, "" if rate is None else f"{rate / 1e3:,.2f}"])
        size = (
            f", at last {topic['width']} x {topic['height']} cells, {topic['edges']:,} edges"
            if "width" in topic
            else ""
        )
        count = f"{topic['messages']:,} maps and {topic['updates']:,} updates in {document['duration_s']:,.0f} s{size}"
        print_table(f"{document['bag']}: {topic['topic']}: {count}", ["", "bytes", "times fleetmap's", "kB/s"], rows)
        if topic["refused"]:
            typer.echo(f"{topic['refused']} messages were no maps: {topic['refused_because']}")


def write_bag_report(cost: BagCost, out: Path) -> Path:
    """``report.html``: curves over time, and the first topic's map; returns its path."""
    from fleetmap.merge import fold
    from fleetmap.merge.protocol import Source
    from fleetmap.model.pose import FixedPose
    from fleetmap.report import Chart, Curve, Report, write_report

    charts, sizes = [], [("topic", *(label for label in NAMES.values()), "times less than in the bag")]
    for topic in cost.topics:
        curves = tuple(
            Curve(label, tuple((t_s, sizes.get(name, 0) / 1e3) for t_s, sizes in topic.series), COLOURS[name])
            for name, label in NAMES.items()
        )
        charts.append(Chart(topic.name, "kB so far, payload to one receiver, logarithmic", curves, logarithmic=True))
        codecs = {"bag": topic.size_bytes, **topic.sizes}
        vector = codecs.get("vector", 0)
        times = f"{topic.size_bytes / vector:,.0f}" if vector else "-"
        sizes.append((topic.name, *(f"{codecs.get(name, 0):,}" for name in NAMES), times))
    name, last = next(
        ((topic.name, topic.vector_map) for topic in cost.topics if topic.vector_map is not None), ("", None)
    )
    merged = fold([] if last is None else [Source(("r0", 0, "0"), FixedPose(), last)])
    tiles = tuple(
        (topic.name, f"{topic.messages:,} maps, {topic.updates:,} updates", f"{topic.refused} refused")
        for topic in cost.topics
    )
    report = Report(
        title=cost.path.name,
        subtitle=f"fleetmap stats · {cost.duration_s:,.0f} s",
        merged=merged,
        trails=(),
        tiles=tiles,
        charts=tuple(charts),
        table=(),
        sizes=tuple(sizes),
        map_title=f"The last map on {name}, as vectors" if name else "No map",
        sizes_about="bytes, payload to one receiver; vectors lie within sqrt(2) cells, grids are lossless",
        time_label="s",
    )
    out.mkdir(parents=True, exist_ok=True)
    write_report(report, out / "report.html")
    return out / "report.html"
