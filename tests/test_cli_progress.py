"""What commands say while they work, and how long they let a codec run."""

import io
import threading
import time

import numpy as np
import pytest
from rich.console import Console

from fleetmap.cli import map_stats, output
from fleetmap.codecs import context_grid
from fleetmap.model.grid import OccupancyGrid


class Heard(io.StringIO):
    """A stream that tells when something was written to it."""

    def __init__(self) -> None:
        super().__init__()
        self.lines = threading.Event()

    def write(self, text: str) -> int:
        count = super().write(text)
        if "\n" in text:
            self.lines.set()
        return count


def test_in_a_pipe_what_takes_long_says_what_it_is_and_how_long_it_took(monkeypatch, timeout_factor):
    heard = Heard()
    monkeypatch.setattr(output, "stderr", Console(file=heard))
    monkeypatch.setattr(output, "EVERY_S", 0.01)
    with output.progress("map[1].yaml") as tell:
        tell("webp")
        heard.lines.clear()
        assert heard.lines.wait(10.0 * timeout_factor)
    assert "map[1].yaml: webp, 0 s\n" in heard.getvalue()
    assert threading.active_count() == len([t for t in threading.enumerate() if t.name != "progress"])


def test_what_is_quick_says_nothing_in_a_pipe(monkeypatch):
    heard = Heard()
    monkeypatch.setattr(output, "stderr", Console(file=heard))
    with output.progress("map.yaml") as tell:
        tell("webp")
    assert heard.getvalue() == ""


def test_a_map_beyond_one_payload_of_the_exact_layer_has_all_rows(monkeypatch, tmp_path):
    cells = np.zeros((90, 70), np.int8)
    cells[20:22, 10:60] = 100
    grid = OccupancyGrid(cells, 0.05)
    whole = map_stats.measure_map(tmp_path, grid)
    monkeypatch.setattr(context_grid, "MAX_CELLS", 1000)
    told = []
    split = map_stats.measure_map(tmp_path, grid, told.append)
    assert set(split["codecs"]) == set(whole["codecs"])
    assert 0 < split["codecs"]["exact"] < 7 * whole["codecs"]["exact"]
    assert {"exact", *map_stats.VECTORS} <= set(told)


@pytest.mark.parametrize(("takes_s", "runs"), [(0.01, 5), (0.2, 2), (1.0, 2), (4.0, 1), (300.0, 1)])
def test_a_codec_that_takes_long_runs_once(monkeypatch, takes_s, runs):
    clock, calls = [0.0], []
    monkeypatch.setattr(time, "process_time", lambda: clock[0])

    def work() -> str:
        clock[0] += takes_s
        calls.append(takes_s)
        return "result"

    result, ms = map_stats.timed(work)
    assert (result, len(calls)) == ("result", runs)
    assert ms == pytest.approx(1e3 * takes_s)
