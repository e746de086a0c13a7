"""Nobody's map holds up the fold: what would is left out, leaves no trace, and honest maps stay."""

import importlib.util
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetmap.merge import Source, afford, fold, verify
from fleetmap.merge.arrange import lower_end_first
from fleetmap.merge.tiles import Tiles, levels_of, tiles_of_edges, tiles_of_points
from fleetmap.model.lattice import Lattice
from fleetmap.model.map_server import load_map
from fleetmap.model.pose import FixedPose, Pose2
from fleetmap.vectorize import vectorize

SCRIPT = Path(__file__).parent.parent / "benchmarks" / "hostile_fold.py"
spec = importlib.util.spec_from_file_location("hostile_fold", SCRIPT)
hostile_fold = importlib.util.module_from_spec(spec)
spec.loader.exec_module(hostile_fold)

EDGES = 4000
"""Of each hostile map; the benchmark takes as many as one name may add."""

UNAFFORDABLE = ("combs", "parallel combs", "needles", "star", "grating", "spiral", "triangles", "rooms of 10 m")


@pytest.fixture(scope="module")
def good():
    return hostile_fold.honest(hostile_fold.office(15.0), robots=4)


def left_out(merged):
    return {frame[0] for frame, _ in merged.left_out}


@pytest.mark.parametrize("shape", hostile_fold.SHAPES)
def test_honest_maps_stay_whatever_six_names_say(good, shape):
    bad = hostile_fold.hostile(shape, names=6, edges=EDGES)
    merged = fold([*bad, *good])
    out = left_out(merged)
    assert out <= {source.frame[0] for source in bad}
    choice = afford.choose(afford.weighed([*good, *bad])[0])
    assert choice.spent <= choice.room
    if out == {source.frame[0] for source in bad}:
        assert replace(merged, left_out=()).to_bytes() == fold(good).to_bytes()


@pytest.mark.parametrize("shape", UNAFFORDABLE)
def test_what_would_hold_up_all_others_is_left_out_and_leaves_no_trace(good, shape):
    bad = hostile_fold.hostile(shape, names=3, edges=48_000)
    merged = fold([*good, *bad])
    assert left_out(merged) == {source.frame[0] for source in bad}
    assert all(reason.startswith("edges: ") for _, reason in merged.left_out)
    assert merged.to_bytes() == fold(good).to_bytes()


def test_sixty_names_push_out_no_honest_map(good):
    bad = [
        Source((f"x{i}-{shape}", 1, "0"), source.T_fleet_frame, source.vector_map)
        for shape in ("combs", "wide combs", "wider combs", "salt", "rooms", "dashed lines")
        for i, source in enumerate(hostile_fold.hostile(shape, names=10, edges=200))
    ]
    assert not left_out(fold([*bad, *good])) & {source.frame[0] for source in good}


def test_of_two_crossing_combs_one_is_left_out():
    combs = hostile_fold.hostile("short combs", names=2, edges=EDGES)
    merged = fold(combs)
    assert [frame for frame, _ in merged.left_out] in ([("x00", 1, "0")], [("x01", 1, "0")])
    kept = [source for source in combs if source.frame not in {frame for frame, _ in merged.left_out}]
    assert merged.to_bytes() == fold(kept).to_bytes()


def test_small_maps_that_cross_are_all_kept():
    combs = [hostile_fold.strips(80, pitch=2, length=40, upright=upright) for upright in (False, True)]
    sources = [Source((f"r{i}", 1, "0"), FixedPose(), vector_map) for i, vector_map in enumerate(combs)]
    merged = fold(sources)
    assert merged.left_out == ()
    assert verify(sources, merged) == []


@settings(max_examples=4)
@given(st.randoms(use_true_random=False))
def test_what_is_left_out_depends_on_contents_alone(random):
    shapes = [hostile_fold.SHAPES["short combs"](1600 + 80 * i, i) for i in range(4)]
    names = [f"r{i}" for i in range(4)]
    random.shuffle(names)
    sources = [Source((name, 1, "0"), FixedPose(), shape) for name, shape in zip(names, shapes, strict=True)]
    expected = {id(s.vector_map) for s in sources if s.frame[0] in left_out(fold(sources))}
    assert expected
    copies = [Source((f"c{i}", 1, "0"), s.T_fleet_frame, s.vector_map) for i, s in enumerate(sources)]
    shuffled = [*sources, *copies]
    random.shuffle(shuffled)
    if random.random() < 0.5:
        afford._known.clear()
    again = fold(shuffled)
    assert {id(s.vector_map) for s in shuffled if s.frame[0] in left_out(again)} == expected
    assert again.to_bytes() == fold(sources).to_bytes()


def test_a_weight_is_found_once_and_forgotten_with_the_map(monkeypatch):
    afford._known.clear()
    placed = []
    monkeypatch.setattr(afford, "place", lambda source, place=afford.place: placed.append(source) or place(source))
    bad = hostile_fold.hostile("star", names=3, edges=EDGES)
    for _ in range(3):
        assert len(left_out(fold(bad))) == 3
    assert len(placed) == 3
    turned = [Source(s.frame, FixedPose(x_um=k), s.vector_map) for s in bad[:1] for k in range(20)]
    fold(turned)
    assert len(afford._known[bad[0].vector_map]) <= afford.POSES_KEPT
    del bad, turned
    placed.clear()
    assert len(afford._known) == 0


def test_the_cost_of_a_fold_is_what_counting_all_pairs_says():
    rng = np.random.default_rng(3)
    for _ in range(8):
        # Spread, so that most maps don't cross themselves.
        maps = [hostile_fold.polygons(rng.integers(0, 60, (4, 3, 2)) + 70 * np.arange(4)[:, None, None]) for _ in "abc"]
        poses = [FixedPose.from_pose(Pose2(*rng.uniform(-1, 1, 2), rng.uniform(-3, 3))) for _ in maps]
        sources = [Source((f"r{i}", 1, "0"), p, m) for i, (p, m) in enumerate(zip(poses, maps, strict=True))]
        candidates, _ = afford.weighed(sources)
        choice = afford.choose(candidates)
        assert len(choice.taken) == len(candidates)
        ends = [lower_end_first(c.place().ends)[0] for c in candidates]
        entries = [np.repeat(t.keys, np.diff(t.start)) for t in map(tiles_of_edges, ends)]
        _, together = np.unique(np.concatenate(entries), return_counts=True)
        crossings = sum(cross(a, b) for one, two in combinations(ends, 2) for a in one.tolist() for b in two.tolist())
        assert choice.spent == (
            afford.SOURCE * len(ends)
            + afford.ENTRY * sum(map(len, entries))
            + (together**2).sum()
            + afford.CROSSING * crossings
        )


def cross(a, b):
    """Whether the insides of two edges cross."""

    def side(e, y, x):
        return (e[3] - e[1]) * (y - e[0]) - (e[2] - e[0]) * (x - e[1])

    return side(a, *b[:2]) * side(a, *b[2:]) < 0 and side(b, *a[:2]) * side(b, *a[2:]) < 0


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), st.sampled_from([20, 300, 5000]))
def test_an_edge_is_in_each_tile_that_it_passes(seed, reach):
    rng = np.random.default_rng(seed)
    ends = lower_end_first(rng.integers(-reach, reach, (20, 4)))[0]
    level = rng.integers(0, 3, len(ends))
    tiles = tiles_of_edges(ends, level)
    held = {
        (int(k), int(i)) for t, k in enumerate(tiles.keys) for i in tiles.items[tiles.start[t] : tiles.start[t + 1]]
    }
    for i, (y0, x0, y1, x1) in enumerate(ends.tolist()):
        t = np.linspace(0, 1, 4 * reach)
        points = np.column_stack([y0 + t * (y1 - y0), x0 + t * (x1 - x0)])
        passed = tiles_of_points(np.floor(points + 0.5).astype(np.int64), np.int64(level[i]))
        assert {(int(k), i) for k in passed.keys} <= held


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.sampled_from([60, 1000, 20_000]))
def test_close_pairs_and_crossings_are_those_of_all_pairs(seed, reach):
    from fleetmap.merge.arrange_kernels import crossings
    from fleetmap.merge.place import pair_cell
    from fleetmap.merge.snap_kernels import close_pairs

    rng = np.random.default_rng(seed)
    n = 60
    at = rng.integers(-reach, reach, (n, 2))
    at = at[np.lexsort(at.T[::-1])]
    cell = np.array([1, 10, 11, 300, 2000])
    source, tangent = rng.integers(0, len(cell), n), rng.integers(-3, 4, (n, 2))
    level = levels_of(cell)
    tiles = tiles_of_points(at, level[source])
    found = close_pairs(at, source, tangent, cell, np.unique(level), *tiles, 2)
    expected = {
        (int(d @ d), i, j)
        for i, j in combinations(range(n), 2)
        for d in [at[j] - at[i]]
        if source[i] != source[j]
        and tangent[i] @ tangent[j] > 0
        and d @ d <= (2 * pair_cell(int(cell[source[i]]), int(cell[source[j]]))) ** 2
    }
    assert sorted(map(tuple, found.tolist())) == sorted(expected)

    ends = lower_end_first(rng.integers(-reach, reach, (30, 4)))[0]
    assert len(crossings(ends, *tiles_of_edges(ends))) == sum(cross(a, b) for a, b in combinations(ends.tolist(), 2))


def test_nothing_lies_in_no_tile():
    none = np.zeros(0, np.int64)
    assert [len(a) for a in Tiles.sorted_by(none, none)] == [0, 1, 0]


def test_a_wall_of_very_many_pieces_becomes_few_edges():
    source = Source(("a", 1, "0"), FixedPose(), hostile_fold.dashed(EDGES, 1))
    merged = fold([source])
    assert 4 <= len(merged) <= EDGES // 32 + 8
    assert verify([source], merged) == []


def test_edges_that_are_hundreds_of_kilometres_long_together_are_refused_before_they_are_cut():
    vector_map = hostile_fold.strips(1000, pitch=2, length=500, upright=False, resolution_um=10_000_000)
    merged = fold([Source(("a", 1, "0"), FixedPose(), vector_map)])
    assert len(merged) == 0
    ((_, reason),) = merged.left_out
    assert "km long together; at most 335 km" in reason


@pytest.mark.parametrize("yaw", [0.0, 0.785, 1.571])
def test_a_hall_of_long_racks_that_thirty_robots_saw_has_all_of_them(yaw):
    """Each also saw a nook that nobody else did; edges are few, and 60 m long."""

    def ring(x0, y0, x1, y1):
        return hostile_fold.rectangles(np.array([x0]), np.array([y0]), x1 - x0, y1 - y0)

    rng, sources = np.random.default_rng(0), []
    for i in range(30):
        hall = [ring(0, 0, 1400, 780), ring(0, -200 - 60 * i, 40, -160 - 60 * i)]
        outer = hostile_fold.polygons(np.concatenate(hall)).edges
        racks = np.concatenate([ring(100, 60 + 72 * r, 1300, 84 + 72 * r) for r in range(10)])
        inner = hostile_fold.polygons(racks).edges
        inner[:, 4] = 4 - inner[:, 4]  # free around them
        rows = np.concatenate([outer, inner])
        vector_map = hostile_fold.VectorMap(Lattice(50_000), rows, np.full(len(rows), 4, np.uint8))
        pose = Pose2(*rng.uniform(-0.03, 0.03, 2), yaw + rng.uniform(-0.0017, 0.0017))
        sources.append(Source((f"r{i}", 1, "0"), FixedPose.from_pose(pose), vector_map))
    assert fold(sources).left_out == ()


@pytest.mark.data
@pytest.mark.filterwarnings("ignore::fleetmap.model.errors.MapWarning")
def test_eight_robots_that_hold_all_of_a_real_map_take_less_than_half_of_the_room(real_map):
    sources = hostile_fold.honest(vectorize(load_map(real_map), profile="full"), robots=8)
    candidates, refused = afford.weighed(sources)
    assert refused == []
    choice = afford.choose(candidates)
    assert len(choice.taken) == 8
    assert choice.spent < choice.room / 2
