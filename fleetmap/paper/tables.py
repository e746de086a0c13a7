"""The tables, as text cells: the command line and the page print the same ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from fleetmap.paper.formats import FORMATS
from fleetmap.paper.scores import METRICS

MAPS = {"grid": "grid", "vector_from_grid": "from grid", "vector_from_truth": "from truth"}

SCORE_COLUMNS = tuple(f"{metric} %" for metric in METRICS)
PROPERTY_COLUMNS = ("corners", "skin (p10-p90)", "specks %")
PROPERTY_NOTE = (
    "Corners per crack; skin: median thickness of walls in cells; specks: per cent of all cells in free specks."
)
RATIOS = {
    "pgm_per_plain": "PGM / plain vectors",
    "pgm_zip_per_plain_zip": "zipped PGM / zipped plain vectors",
    "pgm_zip_per_fleetmap": "zipped PGM / fleetmap",
    "plain_per_fleetmap": "plain vectors / fleetmap",
    "plain_zip_per_fleetmap": "zipped plain vectors / fleetmap",
}


@dataclass(frozen=True, slots=True)
class Table:
    """A title, what a reader must know to read it, the columns, and rows as wide as these."""

    title: str
    note: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def make_tables(document: Mapping[str, Any]) -> list[Table]:
    """All tables of a document. None has both generated and real maps in it."""
    profiles = document["profiles"]
    experiments = document["experiments"]
    tables = [
        terrain_table(experiments),
        score_table(document),
        gap_table(document),
        against_table(document),
        size_table(experiments, profiles),
        ratio_table("Times fewer bytes, medians over these terrains", document["medians"]["ratios"]),
        *(published_table(claims, profile) for profile, claims in document["published"].items()),
    ]
    if document["real_maps"]:
        tables += [
            real_property_table(document["real_maps"]),
            real_score_table(document),
            real_size_table(document["real_maps"], profiles),
            ratio_table("Real maps: times fewer bytes, medians over them", document["real_medians"]["ratios"]),
        ]
    return tables


def terrain_table(experiments: Sequence[Mapping[str, Any]]) -> Table:
    """What was surveyed, and how ragged the grids are."""
    rows = []
    for row in experiments:
        survey = row["survey"]
        seen = f"{survey['seen_percent']:.1f}"
        cells = f"{row['width']} x {row['height']}"
        rows.append(
            (
                name(row), cells, f"{survey['travelled_m']:,.0f}", f"{survey['scans']:,}", seen,
                *property_cells(row["properties"]), "yes" if row["properties"]["as_wanted"] else "no",
            )
        )  # fmt: skip
    columns = ("terrain", "cells", "driven m", "scans", "seen %", *PROPERTY_COLUMNS, "wanted")
    note = f"{PROPERTY_NOTE} Wanted: 0.25 to 0.35, 1 to 3 cells, 0.05 to 1 %."
    return Table("Terrains and the grids made of them", note, columns, tuple(rows))


def score_table(document: Mapping[str, Any]) -> Table:
    """The three maps of each terrain against the truth."""
    rows = []
    for row in document["experiments"]:
        rows += [(name(row), label, *values) for label, values in three_maps(row["scores"], document["profiles"])]
    rows += [("median", label, *values) for label, values in three_maps(document["medians"], document["profiles"])]
    note = "100 is best. Reverse: from the truth's cells to the map's, so that what a map lacks counts."
    return Table("Scores against the truth", note, ("terrain", "map", *SCORE_COLUMNS), tuple(rows))


def gap_table(document: Mapping[str, Any]) -> Table:
    """What vectorizing changes of a grid's scores."""
    return by_profile(
        document,
        "vector_minus_grid",
        "What vectorizing changes of a grid's scores",
        "Score of the vector map minus that of the grid that it came from, both against the truth, in points.",
        sign="+",
    )


def against_table(document: Mapping[str, Any]) -> Table:
    """The vector map against its grid."""
    return by_profile(
        document, "vector_against_grid", "Vector map against the grid that it came from", "The grid is the reference."
    )


def by_profile(document: Mapping[str, Any], key: str, title: str, note: str, *, sign: str = "") -> Table:
    """One row a terrain and profile, then the medians."""
    medians = [("median", document["medians"][key])]
    rows = [
        (label, profile, *numbers(found[profile], sign))
        for label, found in [(name(row), row[key]) for row in document["experiments"]] + medians
        for profile in document["profiles"]
    ]
    columns = SCORE_COLUMNS if not sign else METRICS
    return Table(title, note, ("terrain", "profile", *columns), tuple(rows))


def size_table(experiments: Sequence[Mapping[str, Any]], profiles: Sequence[str]) -> Table:
    """Bytes by format."""
    rows = [size_cells(name(row), row, profile) for row in experiments for profile in profiles]
    note = "Of the grid and the vector map made from it. Zip: deflate, level 9. Plain: 4 float32 a segment."
    return Table("Sizes in bytes", note, ("terrain", "profile", "edges", *FORMATS.values()), tuple(rows))


def ratio_table(title: str, medians: Mapping[str, Mapping[str, float]]) -> Table:
    """Medians of the ratios of sizes, one column a profile."""
    rows = [(label, *(f"{found[key]:.1f}" for found in medians.values())) for key, label in RATIOS.items()]
    note = "Median of each map's own ratio. Vectors are lossy, within sqrt(2) cells; grids are not."
    return Table(title, note, ("ratio", *medians), tuple(rows))


def published_table(claims: Sequence[Mapping[str, Any]], profile: str) -> Table:
    """The paper's numbers beside ours."""
    rows = [(c["claim"], c["unit"], interval(c["published"]), interval(c["ours"])) for c in claims]
    note = "Scores: lowest to highest over all terrains. The paper's terrains, robot and SLAM were others."
    columns = ("what", "unit", "published", "ours")
    return Table(f"The paper's numbers beside ours, profile {profile}", note, columns, tuple(rows))


def real_property_table(real_maps: Sequence[Mapping[str, Any]]) -> Table:
    """Real maps: how ragged they are."""
    rows = [
        (
            row["map"],
            f"{row['width']} x {row['height']}",
            f"{row['resolution_m']:g}",
            *property_cells(row["properties"]),
        )
        for row in real_maps
    ]
    return Table("Real maps", PROPERTY_NOTE, ("real map", "cells", "m / cell", *PROPERTY_COLUMNS), tuple(rows))


def real_score_table(document: Mapping[str, Any]) -> Table:
    """Real maps: the vector map against its grid."""
    rows = [
        (row["map"], profile, *numbers(row["vector_against_grid"][profile]))
        for row in document["real_maps"]
        for profile in document["profiles"]
    ]
    medians = document["real_medians"]["vector_against_grid"]
    rows += [("median", profile, *numbers(found)) for profile, found in medians.items()]
    note = "There is no truth for these: the grid is the reference."
    columns = ("real map", "profile", *SCORE_COLUMNS)
    return Table("Real maps: vector map against the grid that it came from", note, columns, tuple(rows))


def real_size_table(real_maps: Sequence[Mapping[str, Any]], profiles: Sequence[str]) -> Table:
    """Bytes by format, of real maps."""
    rows = [size_cells(row["map"], row, profile, row["edges"]) for row in real_maps for profile in profiles]
    columns = ("real map", "profile", "edges", *FORMATS.values())
    return Table("Real maps: sizes in bytes", "As above.", columns, tuple(rows))


def name(row: Mapping[str, Any]) -> str:
    """Of an experiment."""
    return f"{row['terrain']} {row['size_m']} m"


def three_maps(scores: Mapping[str, Any], profiles: Sequence[str]) -> list[tuple[str, list[str]]]:
    """Label and score cells of the grid, and of the vector maps of each profile."""
    found = [(MAPS["grid"], numbers(scores["grid"]))]
    for key in ("vector_from_grid", "vector_from_truth"):
        for profile in profiles:
            label = f"{profile}, {MAPS[key]}"
            found.append((label, numbers(scores[key][profile])))
    return found


def numbers(scores: Mapping[str, float], sign: str = "") -> list[str]:
    """Score cells."""
    return [f"{scores[metric]:{sign}.2f}" for metric in METRICS]


def property_cells(properties: Mapping[str, Any]) -> tuple[str, str, str]:
    """Cells of ``PROPERTY_COLUMNS``."""
    median, p10, p90 = (properties[f"skin_{which}_cells"] for which in ("median", "p10", "p90"))
    skin = f"{median:g} ({p10:g}-{p90:g})"
    return f"{properties['corners_per_crack']:.3f}", skin, f"{properties['free_specks_percent']:.2f}"


def size_cells(
    label: str, row: Mapping[str, Any], profile: str, edges: Mapping[str, int] | None = None
) -> tuple[str, ...]:
    """One row of bytes."""
    edges = edges or row["edges"]["vector_from_grid"]
    sizes = {**row["sizes"]["grid"], **row["sizes"]["vector_from_grid"][profile]}
    return (label, profile, f"{edges[profile]:,}", *(f"{sizes[key]:,}" for key in FORMATS))


def interval(value: float | Sequence[float | None] | None) -> str:
    """A number, or a range, or a bound."""
    if value is None:
        return "-"
    if isinstance(value, int | float):
        return f"{value:,.1f}"
    low, high = value
    return f"above {low:g}" if high is None else f"{low:.2f} to {high:.2f}"
