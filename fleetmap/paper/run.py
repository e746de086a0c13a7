"""All of it: the experiments, the real maps if asked for, and what the folder of results holds."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fleetmap.model.errors import ConfigError
from fleetmap.paper.experiment import Experiment, run_experiment
from fleetmap.paper.published import beside_ours
from fleetmap.paper.real_maps import find_maps, run_real_map
from fleetmap.paper.scores import medians
from fleetmap.paper.terrains import SIZES_M, choose_terrains
from fleetmap.paper.vectors import PROFILES


@dataclass(frozen=True, slots=True)
class PaperConfig:
    """What is asked for.

    Parameters
    ----------
    out : folder of the results; made if missing
    sizes_m : which terrains, of 10, 40 and 80
    maps : a folder of real maps, or None

    Raises
    ------
    ConfigError : ``out`` is a file, a size is none of the paper's, or ``maps`` has no map in it
    """

    out: Path
    sizes_m: tuple[int, ...] = SIZES_M
    maps: Path | None = None

    def __post_init__(self) -> None:
        if self.out.exists() and not self.out.is_dir():
            raise ConfigError(option="out", value=str(self.out), reason="is a file; expected a folder, or a new name")
        if not self.sizes_m or not set(self.sizes_m) <= set(SIZES_M):
            expected = ", ".join(map(str, SIZES_M))
            raise ConfigError(option="sizes", value=self.sizes_m, reason=f"expected one or more of {expected}")
        if self.maps is not None:
            find_maps(self.maps)


def run_paper(config: PaperConfig, on_progress: Callable[[str], object] = lambda _: None) -> dict[str, Any]:
    """Run the experiments, write tables, figures, maps and report, and return the JSON document.

    Nothing is written before all is computed: an interrupted run leaves the results of an earlier one whole.

    Raises
    ------
    ConfigError : matplotlib is missing
    MapFormatError : a real map can't be read
    OSError : the folder can't be written
    """
    from fleetmap.paper.figures import need_matplotlib, write_figures
    from fleetmap.paper.page import write_page

    need_matplotlib()
    experiments = []
    for terrain in choose_terrains(config.sizes_m):
        on_progress(terrain.name)
        experiments.append(run_experiment(terrain))
    real_rows = []
    if config.maps is not None:
        for path in find_maps(config.maps):
            on_progress(str(path))
            real_rows.append(run_real_map(path, config.maps))
    document = make_document([experiment.row for experiment in experiments], real_rows)

    on_progress("figures and report")
    config.out.mkdir(parents=True, exist_ok=True)
    for experiment in experiments:
        save_maps(experiment, config.out / "terrains")
    figures = write_figures(experiments, document, config.out)
    write_page(document, figures, config.out / "report.html")
    (config.out / "paper.json").write_text(json.dumps(document, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return document


def make_document(rows: Sequence[dict[str, Any]], real_rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """What ``fleetmap paper --json`` prints. Medians are over the generated terrains, or over the real maps."""
    return {
        "profiles": list(PROFILES),
        "experiments": list(rows),
        "medians": {
            "grid": medians(row["scores"]["grid"] for row in rows),
            **{
                key: {profile: medians(row["scores"][key][profile] for row in rows) for profile in PROFILES}
                for key in ("vector_from_grid", "vector_from_truth")
            },
            **{
                key: {profile: medians(row[key][profile] for row in rows) for profile in PROFILES}
                for key in ("vector_minus_grid", "vector_against_grid")
            },
            "ratios": {profile: medians(ratios(row["sizes"], profile) for row in rows) for profile in PROFILES},
        },
        "published": {profile: beside_ours(rows, profile) for profile in PROFILES},
        "real_maps": list(real_rows),
        "real_medians": {
            "vector_against_grid": {
                profile: medians(row["vector_against_grid"][profile] for row in real_rows) for profile in PROFILES
            },
            "ratios": {profile: medians(ratios(row["sizes"], profile) for row in real_rows) for profile in PROFILES},
        },
    }


def ratios(sizes: dict[str, Any], profile: str) -> dict[str, float]:
    """How many times fewer bytes the vector map made from the grid takes than other formats of the same map."""
    grid, vector = sizes["grid"], sizes["vector_from_grid"][profile]
    return {
        "pgm_per_plain": grid["pgm"] / max(1, vector["plain"]),
        "pgm_zip_per_plain_zip": grid["pgm_zip"] / vector["plain_zip"],
        "pgm_zip_per_fleetmap": grid["pgm_zip"] / vector["fleetmap"],
        "plain_per_fleetmap": vector["plain"] / vector["fleetmap"],
        "plain_zip_per_fleetmap": vector["plain_zip"] / vector["fleetmap"],
    }


def save_maps(experiment: Experiment, folder: Path) -> None:
    """Write the grid, the truth and the vector maps of an experiment as files that the other commands read."""
    from fleetmap.codecs.fmap import save_fmap
    from fleetmap.model.map_server import save_map

    folder = folder / experiment.terrain.name.replace(" ", "_")
    folder.mkdir(parents=True, exist_ok=True)
    save_map(experiment.survey.grid, folder / "grid.yaml")
    save_map(experiment.survey.truth, folder / "truth.yaml")
    for profile in PROFILES:
        save_fmap(experiment.from_grid[profile], folder / f"grid_{profile}.fmap")
        save_fmap(experiment.from_truth[profile], folder / f"truth_{profile}.fmap")
