"""The commands on maps, run as a user runs them: results, JSON, exit codes, and errors that say what to do."""

import re
import warnings
from collections import Counter

import numpy as np
import pytest

from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN
from fleetmap.model.map_server import load_map, save_map


def test_a_map_goes_to_vectors_and_back(fleetmap_command, map_folder):
    run = fleetmap_command("vectorize", "map.yaml", "-o", "map.fmap", "--json", cwd=map_folder)
    assert run.code == 0, run.err
    found = run.document
    assert found["valid"] is True
    assert found["violations"] == []
    assert (found["method"], found["reading"]) == ("boundary", None)
    assert found["bytes"] == (map_folder / "map.fmap").stat().st_size
    assert 8 <= found["edges"] <= 40
    assert {"vertices", "ms", "dropped"} <= set(found)

    run = fleetmap_command("rasterize", "map.fmap", "-o", "again.yaml", "--json", cwd=map_folder)
    assert run.code == 0, run.err
    assert abs(run.document["width"] - 104) <= 4
    assert abs(run.document["height"] - 64) <= 4

    run = fleetmap_command("compare", "again.yaml", "map.yaml", "--json", cwd=map_folder)
    assert run.code == 0, run.err
    assert min(run.document[k] for k in ("MS", "OPDF", "UPDF", "OPDF_reverse", "UPDF_reverse")) > 97


def test_with_what_it_leaves_out_a_vector_map_gives_every_cell_back(fleetmap_command, map_folder):
    run = fleetmap_command(
        "vectorize", "map.yaml", "-o", "map.fmap", "--residual", "rest.fgrid", "--json", cwd=map_folder
    )
    assert run.code == 0, run.err
    assert run.document["residual_bytes"] == (map_folder / "rest.fgrid").stat().st_size
    command = ["rasterize", "map.fmap", "-o", "again.yaml"]
    run = fleetmap_command(*command, "--residual", "rest.fgrid", cwd=map_folder)
    assert run.code == 0, run.err
    again, grid = load_map(map_folder / "again.yaml"), load_map(map_folder / "map.yaml")
    assert np.array_equal(again.states_yx(), grid.states_yx())
    assert again.origin == grid.origin

    for wrong, says in (
        (["rasterize", "rest.fgrid", "-o", "again.yaml"], "none was named"),
        ([*command, "--residual", "map.fmap"], "expected b'FGRD'"),
        (["rasterize", "map.yaml", "-o", "again.yaml"], "expected an .fmap or .fgrid file"),
        (["rasterize", "rest.fgrid", "-o", "again.yaml", "--residual", "rest.fgrid"], "is for an .fmap file"),
        (["vectorize", "map.yaml", "-o", "map.fmap", "--residual", "rest.yaml"], "ends in .fgrid"),
    ):
        run = fleetmap_command(*wrong, cwd=map_folder)
        assert run.code in (1, 2)
        assert says in " ".join(run.err.split())


def test_a_graded_map_keeps_its_walls_by_thresholds_and_is_told_what_it_loses(fleetmap_command, map_folder):
    cells = load_map(map_folder / "map.yaml").cells_yx
    graded = np.select([cells == -1, cells == 0], [-1, 40], 60)
    save_map(OccupancyGrid(graded, 0.05), map_folder / "graded.yaml")
    command = ["vectorize", "graded.yaml", "-o", "graded.fmap"]
    run = fleetmap_command(*command, "--json", cwd=map_folder)
    assert run.document["edges"] == 0
    assert run.err.count("0 count as free (below 20) and 0 as occupied (above 64)") == 1

    thresholds = ["--free-below", "50", "--occupied-above", "54"]
    run = fleetmap_command(*command, *thresholds, "--residual", "rest.fgrid", "--json", cwd=map_folder)
    assert (run.code, run.document["valid"], run.document["free_below"]) == (0, True, 50)
    known = (cells >= 0).sum()
    assert run.err.count("warning") == 1
    assert f"{known} of {known} known cells have values between 0 and 100; an .fgrid file holds" in run.err
    run = fleetmap_command("rasterize", "graded.fmap", "-o", "again.yaml", "--residual", "rest.fgrid", cwd=map_folder)
    assert run.code == 0, run.err
    assert (load_map(map_folder / "again.yaml").cells_yx == cells).all()

    run = fleetmap_command(*command, "--free-below", "70", cwd=map_folder)
    assert run.code == 2
    assert "0 < free_below <= occupied_above < 100" in " ".join(run.err.split())


def test_a_residual_that_will_be_refused_is_refused_before_vectorizing(fleetmap_command, tmp_path):
    save_map(OccupancyGrid(np.zeros((5_793, 5_793), np.int8), 0.05), tmp_path / "map.yaml")  # just above 2^25 cells
    run = fleetmap_command("vectorize", "map.yaml", "-o", "map.fmap", "--residual", "rest.fgrid", cwd=tmp_path)
    assert run.code == 1
    assert "rest.fgrid: grid: expected at most 33554432 cells" in run.err
    assert not (tmp_path / "map.fmap").exists()
    run = fleetmap_command("vectorize", "map.yaml", "-o", "map.fmap", "--residual", "no/rest.fgrid", cwd=tmp_path)
    assert run.code == 1
    assert "there is no folder no" in run.err
    assert not (tmp_path / "map.fmap").exists()


def test_the_papers_method_reports_what_it_breaks_and_writes_the_map_all_the_same(fleetmap_command, map_folder):
    for options, reading in (([], "C"), (["--reading", "B"], "B"), (["--reading", "mended"], "mended")):
        command = ["vectorize", "map.yaml", "-o", "map.fmap", "--method", "paper", *options]
        run = fleetmap_command(*command, "--json", cwd=map_folder)
        assert run.code == 1, run.err
        found = run.document
        assert (found["method"], found["reading"]) == ("paper", reading)
        assert {"edges", "vertices", "bytes", "ms", "valid", "violations", "dropped"} <= set(found)
        kinds = Counter(v["kind"] for v in found["violations"])
        assert found["valid"] is False
        assert ({"uncovered", "astray"} & set(kinds) == set()) == (reading == "mended")
        assert found["bytes"] == (map_folder / "map.fmap").stat().st_size

        run = fleetmap_command(*command, cwd=map_folder)
        assert run.code == 1
        for kind in {"uncovered", "astray", *kinds}:
            assert re.search(rf"{kind}\W+{kinds[kind]}\b", run.out), run.out
        assert len(re.findall(r" at \(", run.err)) <= 20


def test_the_papers_method_exits_with_0_where_its_map_is_valid(fleetmap_command, tmp_path):
    y, x = np.mgrid[:21, :21]
    distance = abs(y - 10) + abs(x - 10)
    states = np.select([distance < 9, distance == 9], [FREE, OCCUPIED], UNKNOWN).astype(np.uint8)
    save_map(OccupancyGrid.from_states(states, 0.05), tmp_path / "map.yaml")
    command = ["vectorize", "map.yaml", "-o", "map.fmap", "--method", "paper", "--reading", "mended"]
    run = fleetmap_command(*command, "--json", cwd=tmp_path)
    assert run.code == 0, run.err
    assert run.document["violations"] == []
    assert fleetmap_command("rasterize", "map.fmap", "-o", "again.yaml", cwd=tmp_path).code == 0


def test_every_command_also_speaks_to_people(fleetmap_command, map_folder):
    for arguments, expected in (
        (["vectorize", "map.yaml", "-o", "map.fmap"], "valid"),
        (["rasterize", "map.fmap", "-o", "again.yaml"], "cells"),
        (["compare", "again.yaml", "map.yaml"], "OPDF_reverse"),
        (["stats", "map.yaml", "again.yaml"], "gzip9"),
    ):
        run = fleetmap_command(*arguments, cwd=map_folder)
        assert run.code == 0, run.err
        assert expected in run.out


def test_stats_of_maps_give_bytes_and_ratios(fleetmap_command, map_folder):
    run = fleetmap_command("stats", "map.yaml", "--json", cwd=map_folder)
    assert run.code == 0, run.err
    (found,) = run.document["maps"]
    assert found["codecs"]["raw"] == 120 * 80
    assert found["ratios"]["gzip9"] == 1.0
    assert found["ratios"]["vector"] == pytest.approx(found["codecs"]["gzip9"] / found["codecs"]["vector"])
    rows = {row["codec"]: row for row in found["rows"]}
    assert rows["exact"]["size_bytes"] == min(row["size_bytes"] for row in rows.values() if row["holds"] != "vector")
    assert found["ratios_same_content"]["exact"] == 1.0
    for row in rows.values():
        lossy = row["holds"] == "vector"
        assert (row["epsilon_cells"] is not None) == (row["metrics"] is not None) == lossy
        assert row["codec"] == "raw" or min(row["encode_ms"], row["decode_ms"]) >= 0
        assert row["size_bytes"] > 0
    assert rows["wkb"]["metrics"] == rows["vector"]["metrics"]
    assert rows["vector_full"]["metrics"]["MS"] >= rows["vector"]["metrics"]["MS"] > 95


def test_the_kernels_are_compiled_and_kept(fleetmap_command, map_folder):
    run = fleetmap_command("warmup", "--json", cwd=map_folder, timeout_s=600)
    assert run.code == 0, run.err
    assert run.document["cached"] is True
    assert "fleetmap.model.raster_kernels" in run.document["modules"]


@pytest.mark.parametrize("command", ["sim", "stats", "vectorize", "rasterize", "compare", "merge", "warmup"])
def test_every_command_has_help_with_an_example(fleetmap_command, tmp_path, command):
    run = fleetmap_command(command, "--help", cwd=tmp_path)
    assert run.code == 0
    assert f"fleetmap {command}" in " ".join(run.out.split())


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (["compare", "nothing.yaml", "map.yaml"], 1, "nothing.yaml"),
        (["compare", "map.txt", "map.yaml"], 1, "map.txt"),
        (["compare", "map.yaml"], 2, "Missing argument"),
        (["vectorize", "map.yaml", "-o", "no/folder/map.fmap"], 1, "no/folder"),
        (["vectorize", "map.yaml", "-o", "map.yaml"], 2, "ends in .fmap"),
        (["vectorize", "map.yaml", "-o", "folder.fmap"], 2, "is a folder"),
        (["vectorize", "map.yaml", "-o", "/proc/map.fmap"], 1, "no file can be written there"),
        (["vectorize", "map.yaml", "-o", "a" * 250 + ".fmap"], 1, "no file can be written there"),
        (["paper", "--out", "/proc/paper"], 1, "no file can be written there"),
        (["paper", "--out", "map.pgm/paper"], 2, "is a file"),
        (["vectorize", "broken.fmap", "-o", "again.fmap"], 1, "is a vector map"),
        (["vectorize", "map.yaml", "-o", "map.fmap", "--epsilon", "0"], 2, "epsilon"),
        (["vectorize", "map.yaml", "-o", "map.fmap", "--method", "paper", "--specks", "3"], 2, "specks"),
        (["vectorize", "map.yaml", "-o", "map.fmap", "--method", "paper", "--epsilon", "5"], 2, "epsilon"),
        (["vectorize", "map.yaml", "-o", "map.fmap", "--method", "paper", "--reading", "A"], 2, "mended"),
        (["vectorize", "map.yaml", "-o", "map.fmap", "--reading", "B"], 2, "--method paper"),
        (["rasterize", "map.yaml", "-o", "again.yaml"], 1, "fmap"),
        (["rasterize", "broken.fmap", "-o", "again.yaml"], 1, "broken.fmap"),
        (["rasterize", "broken.fmap", "-o", "again"], 2, "ends in .yaml"),
        (["stats", "broken.fmap"], 1, "is a vector map"),
        (["stats", "map.yaml", "empty"], 1, "is a folder"),
        (["sim", "--robots", "1", "--world", "map.yaml", "--out", "."], 2, "holds the world's map"),
        (["stats", "empty"], 1, "stats.json"),
        (["sim", "--world", "nowhere", "--out", "RUN"], 2, "nowhere"),
        (["sim", "--robots", "0"], 2, "robots"),
        (["nonsense"], 2, "nonsense"),
    ],
)
def test_a_wrong_input_gets_a_clear_error(fleetmap_command, map_folder, arguments, code, says):
    (map_folder / "broken.fmap").write_bytes(np.random.default_rng(0).bytes(200))
    (map_folder / "empty").mkdir()
    (map_folder / "folder.fmap").mkdir()
    header = (map_folder / "map.yaml").read_bytes()
    run = fleetmap_command(*arguments, cwd=map_folder)
    assert run.code == code
    assert says in run.err
    assert "Traceback" not in run.err
    run = fleetmap_command(*arguments, "--json", cwd=map_folder)
    assert run.code == code
    assert says in run.document["error"]["message"]
    assert run.document["error"]["exit_code"] == code
    assert (map_folder / "map.yaml").read_bytes() == header


def test_real_maps_keep_what_the_metrics_ask_for(real_map):
    from fleetmap.model.map_server import MapWarning, load_map
    from fleetmap.model.metrics import compare
    from fleetmap.vectorize import rasterize, vectorize

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MapWarning)  # nav2_depot's free_thresh of 0.25 deserves it
        grid = load_map(real_map)
    found = compare(rasterize(vectorize(grid)), grid)
    assert min(found.OPDF, found.OPDF_reverse) >= 97
    assert min(found.UPDF, found.UPDF_reverse) >= 99.7
