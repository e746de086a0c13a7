"""Figures show every edge of a map, in metres."""

import numpy as np
import pytest

from fleetmap.model.lattice import Lattice
from fleetmap.model.vectormap import VectorMap
from fleetmap.report import plot_map


def test_a_figure_holds_every_edge_in_metres(tmp_path):
    matplotlib = pytest.importorskip("matplotlib", reason="matplotlib is an extra")
    matplotlib.use("Agg")
    edges = np.array([[0, 0, 0, 40, 1], [0, 40, 20, 40, 2], [0, 0, 20, 40, 6]])
    ax = plot_map(VectorMap(Lattice(50_000), edges, np.zeros(3, np.uint8)))
    drawn = np.concatenate([np.array(c.get_segments()).reshape(-1, 2, 2) for c in ax.collections if c.get_segments()])
    assert len(drawn) == 3
    assert drawn.reshape(-1, 2).max(axis=0).tolist() == [2.0, 1.0]
    ax.figure.savefig(tmp_path / "map.png")
    assert (tmp_path / "map.png").stat().st_size > 1000
