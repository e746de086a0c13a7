"""``fleetmap paper`` run as a user runs it, on the smallest terrains; and every command that docs/paper.md shows."""

import json
import os
import re
import shlex
import signal
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

DOCUMENT = Path(__file__).parent.parent / "docs" / "paper.md"
METRICS = {"MS", "CC", "PC", "OPDF", "UPDF", "OPDF_reverse", "UPDF_reverse"}

pytest.importorskip("matplotlib", reason="matplotlib is an extra")


class Tags(HTMLParser):
    """Open elements must close in order; pictures must be inside the page."""

    EMPTY = ("meta", "link", "img", "br")

    def __init__(self):
        super().__init__()
        self.open, self.images, self.text = [], 0, []

    def handle_starttag(self, tag, attrs):
        if tag == "img":
            self.images += 1
            assert dict(attrs)["src"].startswith("data:image/png;base64,")
        if tag not in self.EMPTY:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def test_the_experiments_give_rows_figures_and_one_page(fleetmap_command, map_folder):
    run = fleetmap_command(
        "paper", "--sizes", "10", "--maps", ".", "--out", "results", "--json", cwd=map_folder, timeout_s=300
    )
    assert run.code == 0, run.err
    found = run.document
    assert [(row["terrain"], row["size_m"]) for row in found["experiments"]] == [
        ("maze", 10), ("office", 10), ("unstructured", 10),
    ]  # fmt: skip
    for row in found["experiments"]:
        assert set(row["scores"]["grid"]) == METRICS
        assert set(row["sizes"]["grid"]) == {"pgm", "pgm_zip"}
        for profile in found["profiles"]:
            assert set(row["vector_against_grid"][profile]) == METRICS
            assert set(row["sizes"]["vector_from_grid"][profile]) == {"plain", "plain_zip", "fleetmap"}
    (real,) = found["real_maps"]
    assert real["width"] == 120
    assert set(found["real_medians"]["vector_against_grid"]["share"]) == METRICS
    published = {claim["claim"]: claim["published"] for claim in found["published"]["share"]}
    assert 39.2 in published.values()
    assert 2532.4 in published.values()

    folder = map_folder / "results"
    assert json.loads((folder / "paper.json").read_text()) == found
    names = {path.name for path in folder.iterdir()}
    pictures = {"detail.png", "terrains.png", "grids.png", "sizes.png", "scores.png"}
    assert names >= pictures | {"report.html", "terrains"} | {f"vectors_{p}.png" for p in found["profiles"]}
    page = Tags()
    page.feed((folder / "report.html").read_text())
    assert page.open == []
    assert page.images == len(pictures) + len(found["profiles"])
    assert "unstructured 10 m" in page.text


def test_it_also_speaks_to_people(fleetmap_command, tmp_path):
    run = fleetmap_command("paper", "--sizes", "10", cwd=tmp_path, timeout_s=300)
    assert run.code == 0, run.err
    for expected in ("Scores against the truth", "Sizes in bytes", "2,532.4", "office 10 m", "paper/report.html"):
        assert expected in run.out
    assert "maze 10 m" in run.err
    assert (tmp_path / "paper" / "report.html").exists()


def test_help_has_an_example(fleetmap_command, tmp_path):
    run = fleetmap_command("paper", "--help", cwd=tmp_path)
    assert run.code == 0
    assert "fleetmap paper --out paper" in " ".join(run.out.split())


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (["--out", "map.yaml"], 2, "is a file"),
        (["--maps", "empty"], 2, "no map.yaml"),
        (["--maps", "nowhere"], 2, "no folder"),
        (["--maps", "broken"], 1, "broken"),
        (["--sizes", "20"], 2, "sizes"),
        (["--sizes", "large"], 2, "sizes"),
    ],
)
def test_a_wrong_input_gets_a_clear_error(fleetmap_command, map_folder, arguments, code, says):
    (map_folder / "empty").mkdir()
    (map_folder / "broken").mkdir()
    (map_folder / "broken" / "map.yaml").write_bytes(np.random.default_rng(0).bytes(200))
    sizes = [] if "--sizes" in arguments else ["--sizes", "10"]
    run = fleetmap_command("paper", *sizes, *arguments, "--json", cwd=map_folder)
    assert run.code == code, run.err
    assert says in run.document["error"]["message"]
    assert run.document["error"]["exit_code"] == code
    assert not (map_folder / "paper").exists()


def test_without_matplotlib_it_says_what_to_install(tmp_path):
    code = "import sys; sys.modules['matplotlib'] = None; from fleetmap.cli.main import main; main()"
    run = subprocess.run(
        [sys.executable, "-c", code, "paper", "--sizes", "10", "--json"],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert run.returncode == 2, run.stderr
    assert "fleetmap[plot]" in json.loads(run.stdout)["error"]["message"]
    assert not (tmp_path / "paper").exists()


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_run_says_so_and_leaves_nothing(tmp_path, timeout_factor, how):
    command = [sys.executable, "-m", "fleetmap", "paper", "--json"]
    with subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ
    ) as run:
        try:
            assert any(line.startswith("maze 40 m") for line in run.stderr)
            run.send_signal(how)
            out, _ = run.communicate(timeout=60 * timeout_factor)
        finally:
            run.kill()
    assert run.returncode == 130
    assert json.loads(out)["error"]["type"] == "Interrupted"
    assert list(tmp_path.iterdir()) == []


def test_every_command_of_its_page_runs_on_the_smallest_terrains(fleetmap_command, map_folder):
    blocks = re.findall(r"```sh\n(.*?)```", DOCUMENT.read_text(), re.DOTALL)
    commands = [line for block in blocks for line in block.splitlines()]
    assert len(commands) >= 4
    for command in commands:
        program, *arguments = shlex.split(command)
        assert program == "fleetmap"
        if arguments[0] == "paper" and "--sizes" not in arguments:
            arguments += ["--sizes", "10"]
        run = fleetmap_command(*arguments, cwd=map_folder, timeout_s=300)
        assert run.code == 0, f"{command}: {run.err}"
