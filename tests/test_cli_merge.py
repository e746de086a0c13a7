"""Maps that become one by the command line: as the library merges them, where they are told to lie or found to."""

import json
import math

import numpy as np
import pytest
import yaml
from buildings import CELL_M, make_pair, random_pose, sample, view, with_walls
from conftest import two_rooms
from PIL import Image
from scipy.spatial import cKDTree

from fleetmap.align.evidence import Evidence
from fleetmap.align.protocol import Alignment
from fleetmap.cli import placing
from fleetmap.cli.main import app
from fleetmap.cli.maps import check_resolution, read_plan, read_vector_map
from fleetmap.cli.merge import names_of
from fleetmap.codecs.fmap import load_fmap, save_fmap
from fleetmap.merge.fold import fold
from fleetmap.merge.protocol import Source
from fleetmap.model.errors import ConfigError, FleetmapError, MapFormatError
from fleetmap.model.lattice import FREE, OCCUPIED
from fleetmap.model.map_server import load_map, save_map
from fleetmap.model.mergedmap import FLEET_UM
from fleetmap.model.pose import FixedPose, Pose2
from fleetmap.model.vectormap import VectorMap
from fleetmap.sims.worlds import make_world
from fleetmap.vectorize import rasterize, vectorize

PLAN_M = 20.0


@pytest.fixture(scope="module")
def pair():
    return make_pair("same", 1)


@pytest.fixture
def folder(tmp_path, pair):
    """``a.yaml`` and ``b.fmap``, whose place in it is known, and ``other.yaml`` of another building."""
    save_map(pair.a, tmp_path / "a.yaml")
    save_fmap(vectorize(pair.b, profile="full"), tmp_path / "b.fmap")
    save_map(make_pair("different", 0).b, tmp_path / "other.yaml")
    return tmp_path


@pytest.fixture
def small(tmp_path, monkeypatch):
    """The current folder, with ``a.yaml``, ``b.fmap`` and a ``plan.png`` that is none."""
    save_map(two_rooms(), tmp_path / "a.yaml")
    save_fmap(vectorize(two_rooms()), tmp_path / "b.fmap")
    (tmp_path / "plan.png").write_bytes(b"no picture")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def with_plan(tmp_path):
    """A floor plan, a robot's map of a part of it, and where that lies in the plan."""
    rng = np.random.default_rng(2)
    solid = make_world("office", size_m=PLAN_M, seed=2).solid
    T_plan_robot = random_pose(rng, solid.shape)
    save_map(
        sample(solid, with_walls(view(solid, rng, 0.6), solid), T_plan_robot, rng, bent=False), tmp_path / "robot.yaml"
    )
    Image.fromarray(np.where(solid[::-1], 0, 255).astype(np.uint8)).save(tmp_path / "plan.png")
    return T_plan_robot


def call(*arguments):
    """The command in this process: its exit code, or the error that ``main`` would tell."""
    return app([str(a) for a in arguments], prog_name="fleetmap", standalone_mode=False) or 0


def folded(path, *maps):
    """The bytes of the file of the library's own fold."""
    sources = [Source((f"r{k}", 0, "0"), FixedPose.from_pose(p), m) for k, (p, m) in enumerate(maps)]
    save_fmap(fold(sources), path)
    return path.read_bytes()


def pose_of(entry):
    return Pose2(entry["x_m"], entry["y_m"], entry["yaw_rad"])


def farthest_m(walls_xy, of_xy):
    """How far some walls are from others at most, both as points."""
    return cKDTree(of_xy).query(walls_xy)[0].max()


def points_of(segments_xy):
    """Points along segments, 2 cm apart at most."""
    start, along = segments_xy[:, 0], segments_xy[:, 1] - segments_xy[:, 0]
    count = 2 + int(np.hypot(*along.T).max() / 0.02)
    return (start[:, None] + np.linspace(0, 1, count)[:, None] * along[:, None]).reshape(-1, 2)


def test_maps_at_poses_that_are_given_are_folded_as_by_the_library(folder, pair, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    truth = pair.T_a_b
    poses = ["--pose", "0,0,0", "--pose", f"{truth.x_m!r},{truth.y_m!r},{truth.yaw_rad!r}"]
    assert call("merge", "a.yaml", "b.fmap", *poses, "-o", "both.fmap", "--png", "both.png") == 0
    maps = (Pose2(), vectorize(load_map(folder / "a.yaml"))), (truth, load_fmap(folder / "b.fmap"))
    assert (folder / "both.fmap").read_bytes() == folded(folder / "same.fmap", *maps)
    merged = load_fmap(folder / "both.fmap")
    assert f"both.fmap: {len(merged)} edges of 2 maps, digest {merged.digest}" in capsys.readouterr().out
    with Image.open("both.png") as image:
        assert image.width > 100


def test_maps_without_poses_are_found_and_every_wall_stays(fleetmap_command, folder, pair):
    run = fleetmap_command("merge", "a.yaml", "b.fmap", "-o", "both.fmap", "--json", cwd=folder)
    assert run.code == 0, run.err
    found, merged = run.document, load_fmap(folder / "both.fmap")
    assert (found["out"], found["digest"], found["edges"]) == ("both.fmap", merged.digest, len(merged))
    assert found["left_out"] == []
    assert [(p["a"], p["b"], p["outcome"]) for p in found["pairs"]] == [("a.yaml", "b.fmap", "committed")]
    poses = [pose_of(entry) for entry in found["maps"]]
    assert poses[0] == Pose2()
    off_xy = poses[1].apply(pair.shared_xy) - pair.T_a_b.apply(pair.shared_xy)
    assert np.hypot(*off_xy.T).max() < 0.1

    tolerance_m = merged.tolerance * FLEET_UM / 1e6 + 0.02
    walls = points_of(merged.segments_xy[merged.obstacle])
    sources = [vectorize(load_map(folder / "a.yaml")), load_fmap(folder / "b.fmap")]
    seen = [pose.apply(points_of(m.segments_xy[m.obstacle])) for pose, m in zip(poses, sources, strict=True)]
    assert max(farthest_m(points, walls) for points in seen) < tolerance_m
    assert farthest_m(walls, np.vstack(seen)) < tolerance_m


def test_a_map_of_another_building_is_refused_and_nothing_written(fleetmap_command, folder, capsys):
    run = fleetmap_command("merge", "a.yaml", "other.yaml", "-o", "both.fmap", "--png", "both.png", cwd=folder)
    assert run.code == 1
    assert "other.yaml: not placed\n  beside a.yaml: " in run.out
    assert "nothing written: left out would be other.yaml; --allow-missing" in run.out
    assert not list(folder.glob("both*"))
    maps = folder / "a.yaml", folder / "other.yaml"
    for extra, code in (([], 1), (["--allow-missing"], 0)):
        assert call("merge", *maps, "-o", folder / "both.fmap", "--json", *extra) == code
        found = json.loads(capsys.readouterr().out)
        assert found["left_out"] == [str(maps[1])]
        assert [entry["placed"] for entry in found["maps"]] == [True, False]
        assert found["pairs"][0]["outcome"] in found["maps"][1]["reason"]
        assert (found["out"] is not None) == (code == 0) == (folder / "both.fmap").exists()
    only = folded(folder / "same.fmap", (Pose2(), read_vector_map(maps[0])))
    assert (folder / "both.fmap").read_bytes() == only


def test_a_reference_gives_the_frame_and_adds_no_walls(tmp_path, with_plan, capsys):
    arguments = ["--reference", tmp_path / "plan.png", "--resolution", CELL_M, "-o", tmp_path / "placed.fmap"]
    assert call("merge", tmp_path / "robot.yaml", *arguments, "--json") == 0
    (entry,) = json.loads(capsys.readouterr().out)["maps"]
    pose, truth = pose_of(entry), with_plan
    assert math.hypot(pose.x_m - truth.x_m, pose.y_m - truth.y_m) < 0.1
    only = folded(tmp_path / "same.fmap", (pose, vectorize(load_map(tmp_path / "robot.yaml"))))
    assert (tmp_path / "placed.fmap").read_bytes() == only


def test_a_reference_that_no_map_lies_in_leaves_nothing_to_write(tmp_path, with_plan, capsys):
    save_map(two_rooms(), tmp_path / "small.yaml")
    out = ["--reference", tmp_path / "robot.yaml", "-o", tmp_path / "out.fmap", "--allow-missing"]
    assert call("merge", tmp_path / "small.yaml", *out) == 1
    assert "nothing written: no map is left" in capsys.readouterr().out
    assert not (tmp_path / "out.fmap").exists()


def test_the_transform_is_given_as_open_rmf_reads_it(tmp_path, with_plan, capsys):
    arguments = ["--resolution", CELL_M, "--rmf", "--level", "B1"]
    assert call("align", tmp_path / "plan.png", tmp_path / "robot.yaml", *arguments) == 0
    points = yaml.safe_load(capsys.readouterr().out)["reference_coordinates"]["B1"]
    rmf, robot = np.array(points["rmf"]), np.array(points["robot"])
    assert rmf.shape == robot.shape == (4, 2)
    assert np.hypot(*(rmf[2] - rmf[0])) == pytest.approx(np.hypot(*(robot[2] - robot[0])), abs=1e-3)
    pixels_xy = rmf * (1, -1) / CELL_M  # of the picture, from its upper left corner
    expected = with_plan.apply(robot) / CELL_M
    height = round(PLAN_M / CELL_M)
    assert pixels_xy == pytest.approx(np.column_stack([expected[:, 0], height - expected[:, 1]]), abs=3)


def test_what_is_not_committed_prints_no_coordinates(tmp_path, folder, capsys):
    assert call("align", folder / "a.yaml", folder / "other.yaml", "--rmf") == 1
    assert capsys.readouterr().out == ""


def test_three_maps_that_contradict_each_other_are_not_merged(tmp_path, monkeypatch, capsys):
    paths = [tmp_path / f"{name}.yaml" for name in "abc"]
    for path in paths:
        save_map(two_rooms(), path)
    monkeypatch.setattr(placing, "align_all", lambda *_: found_of(b=Pose2(1, 0, 0), c=Pose2(2, 0, 0), by=Pose2(0.5)))
    assert call("merge", *paths, "-o", tmp_path / "out.fmap", "--allow-missing") == 1
    says = f"contradict each other: {paths[2]} lies 0.50 m and 0.0 degrees elsewhere by {paths[1]} than by the others"
    assert says in capsys.readouterr().out
    assert not (tmp_path / "out.fmap").exists()


def alignment(T_a_b, explained_m, middle_xy=(0.0, 0.0), outcome="committed"):
    evidence = Evidence(explained_m, 0.0, explained_m, 5.0, 0.01, 9, 12.0)
    return Alignment(outcome, T_a_b, ((0.0,) * 3,) * 3, middle_xy, evidence, None, "")


def found_of(*, b, c, by, middle_xy=(0.0, 0.0)):
    """Three maps: where the first two pairs say, and the third says something else."""
    odd = b.inverse() @ by @ c
    return {(0, 1): alignment(b, 50.0), (0, 2): alignment(c, 40.0), (1, 2): alignment(odd, 30.0, middle_xy)}


def test_maps_are_placed_by_the_pairs_that_explain_most():
    chain = {
        (0, 1): alignment(Pose2(1.0, 0.0, 0.0), 20.0),
        (0, 2): alignment(Pose2(9.0, 9.0, 0.0), 10.0),
        (1, 2): alignment(Pose2(0.0, 2.0, math.pi / 2), 30.0),
        (0, 3): alignment(Pose2(), 90.0, outcome="ambiguous"),
        (1, 3): alignment(Pose2(), 90.0, outcome="conflict"),
        (2, 3): alignment(None, 0.0, outcome="too_small"),
    }
    poses = placing.place(4, chain)
    assert poses == [Pose2(), Pose2(1.0, 0.0, 0.0), Pose2(1.0, 2.0, math.pi / 2), None]
    backwards = {(a, b): chain[a, b] for a, b in reversed(chain)}
    assert placing.place(4, backwards) == poses
    last_first = {(0, 2): alignment(Pose2(1.0, 0.0, math.pi / 2), 1.0), (1, 2): alignment(Pose2(2.0, 0.0, 0.0), 1.0)}
    _, middle, last = placing.place(3, last_first)
    assert last == Pose2(1.0, 0.0, math.pi / 2)
    assert (middle.x_m, middle.y_m) == pytest.approx((1.0, -2.0))


@pytest.mark.parametrize(
    ("by", "middle_xy", "agree"),
    [
        (Pose2(0.29), (0.0, 0.0), True),
        (Pose2(0.31), (0.0, 0.0), False),
        (Pose2(0.0, 0.0, math.radians(2.9)), (0.0, 0.0), True),
        (Pose2(0.0, 0.0, math.radians(2.9)), (80.0, 0.0), False),
        (Pose2(0.0, 0.0, math.radians(-3.1)), (0.0, 0.0), False),
    ],
)
def test_ways_around_a_loop_agree_within_30_cm_and_three_degrees_where_the_walls_are(by, middle_xy, agree):
    found = found_of(b=Pose2(), c=Pose2(), by=by, middle_xy=middle_xy)
    poses = placing.place(3, found)
    assert placing.contradictions(placing.differences(poses, found)) == ([] if agree else [(1, 2)])


def test_robots_are_named_after_files_and_no_two_alike(tmp_path):
    paths = [tmp_path / name for name in ("a.yaml", "x/a.fmap", "2. Stock (süd).yaml", "y" * 90 + ".yaml", "ü.yaml")]
    names = names_of([*paths, paths[3]])
    assert names[:3] == ["a", "a-2", "2._Stock__s_d_"]
    assert len(set(names)) == 6
    assert max(map(len, names)) <= 64


def test_a_vector_map_is_read_as_it_is_and_anything_else_is_vectorized(folder):
    full = load_fmap(folder / "b.fmap")
    assert read_vector_map(folder / "b.fmap").digest == full.digest
    grid = load_map(folder / "a.yaml")
    assert read_vector_map(folder / "a.yaml").digest == vectorize(grid).digest
    merged = fold([Source(("r", 0, "0"), FixedPose(), full)])
    save_fmap(merged, folder / "merged.fmap")
    assert read_vector_map(folder / "merged.fmap").digest == vectorize(merged.to_grid()).digest


def test_of_a_floor_plan_dark_pixels_are_walls_and_clear_ones_paper(tmp_path):
    grey = np.full((40, 30), 128, np.uint8)
    grey[10:12, 5:25] = 127
    Image.fromarray(grey).save(tmp_path / "plan.png")
    clear = np.zeros((40, 30, 4), np.uint8)
    clear[10:12, 5:25, 3] = 255
    Image.fromarray(clear).save(tmp_path / "clear.PNG")
    expected = np.full((40, 30), FREE)
    expected[28:30, 5:25] = OCCUPIED  # row 0 is the lowest
    for name in ("plan.png", "clear.PNG"):
        grid = read_plan(tmp_path / name, 0.1)
        assert np.array_equal(grid.states_yx(), expected)
        assert (grid.origin, grid.resolution_m) == (Pose2(), 0.1)
        check_resolution(tmp_path / name, 0.1)
        drawn = rasterize(read_vector_map(tmp_path / name, 0.1), like=grid).states_yx()
        assert np.array_equal(drawn == OCCUPIED, expected == OCCUPIED)


@pytest.mark.parametrize(
    ("arguments", "kind", "says"),
    [
        (["a.yaml", "b.fmap", "--pose", "0,0,0"], ConfigError, "one for each of 2 maps, in their order; found 1"),
        (["a.yaml", "--pose", "0,0"], ConfigError, "pose='0,0': expected X,Y,YAW"),
        (["a.yaml", "--pose", "0,nan,0"], ConfigError, "expected X,Y,YAW"),
        (["a.yaml", "--pose", "0,east,0"], ConfigError, "expected X,Y,YAW"),
        (["a.yaml", "--pose", "1e9,0,0"], ConfigError, "m from 0"),
        (["a.yaml"], ConfigError, "expected two, or one with --pose or --reference"),
        (["a.yaml", "--pose", "0,0,0", "--reference", "b.fmap"], ConfigError, "goes without --pose"),
        (["a.yaml", "--reference", "plan.png"], ConfigError, "metres a pixel of plan.png"),
        (["a.yaml", "--reference", "b.fmap", "--resolution", "0.05"], ConfigError, "is for the picture"),
        (["a.yaml", "b.fmap", "--resolution", "0.05"], ConfigError, "is for the picture"),
        (["a.yaml", "--reference", "plan.png", "--resolution", "0"], ConfigError, "above 0"),
        (["a.yaml", "--reference", "plan.png", "--resolution", "nan"], ConfigError, "above 0"),
        (["a.yaml", "--reference", "plan.png", "--resolution", "1"], MapFormatError, "plan.png: image: "),
        (["a.yaml", "b.fmap", "-o", "both.yaml"], ConfigError, "ends in .fmap"),
        (["a.yaml", "b.fmap", "-o", "./b.fmap"], ConfigError, "is one of the maps that are read"),
        (["a.yaml", "--reference", "plan.png", "--resolution", "1", "--png", "plan.png"], ConfigError, "is one of"),
        (["a.yaml", "b.fmap", "--png", "both.jpg"], ConfigError, "ends in .png"),
        (["a.yaml", "nothing.fmap"], MapFormatError, "nothing.fmap: file: No such file"),
        (["a.yaml", "nothing.yaml"], MapFormatError, "nothing.yaml"),
        (["a.yaml", "plan.png"], MapFormatError, "plan.png: name: is a picture"),
    ],
)
def test_a_wrong_input_is_named_before_anything_is_written(small, arguments, kind, says):
    before = {path: path.read_bytes() for path in small.iterdir()}
    arguments = arguments if "-o" in arguments else [*arguments, "-o", "both.fmap"]
    with pytest.raises(FleetmapError) as error:
        call("merge", *arguments)
    assert type(error.value) is kind
    assert says in str(error.value)
    assert {path: path.read_bytes() for path in small.iterdir()} == before


@pytest.mark.parametrize("extra", [["--level", "L2"], ["--rmf", "--json"], ["--resolution", "0.1"]])
def test_options_of_align_that_say_nothing_together_are_refused(small, extra):
    with pytest.raises(ConfigError):
        call("align", "a.yaml", "b.fmap", *extra)


def test_a_map_that_the_fold_refuses_is_left_out_by_name(small, capsys):
    whole = load_fmap("b.fmap")
    save_fmap(VectorMap(whole.lattice, whole.edges[:-1], whole.thickness[:-1]), "open.fmap")
    poses = ["--pose", "0,0,0", "--pose", "0,0,0"]
    assert call("merge", "a.yaml", "open.fmap", *poses, "-o", "out.fmap", "--json") == 1
    found = json.loads(capsys.readouterr().out)
    assert found["left_out"] == ["open.fmap"]
    assert "the boundary of free space is not closed" in found["maps"][1]["reason"]
    assert not (small / "out.fmap").exists()


def test_usage_errors_end_with_2_and_one_document(fleetmap_command, small):
    command = ["merge", "a.yaml", "b.fmap", "--pose", "0,0,0", "-o", "both.fmap", "--json"]
    run = fleetmap_command(*command, cwd=small)
    assert run.code == run.document["error"]["exit_code"] == 2
    assert "expected one for each of 2 maps" in run.document["error"]["message"]
