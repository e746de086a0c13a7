"""The paper's nine experiments, run again: terrains, grids, vector maps, scores, sizes, tables and figures."""

from fleetmap.paper.experiment import Experiment, run_experiment
from fleetmap.paper.run import PaperConfig, run_paper
from fleetmap.paper.tables import Table, make_tables
from fleetmap.paper.terrains import Terrain, choose_terrains

__all__ = [
    "Experiment", "PaperConfig", "Table", "Terrain", "choose_terrains", "make_tables", "run_experiment", "run_paper",
]  # fmt: skip
