import gzip
import importlib.util
import io
import math
import subprocess
import sys
import zlib

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from PIL import Image

from fleetmap.codecs import baselines, context_grid
from fleetmap.codecs.baselines import (
    GRID_BASELINES,
    HEADER_BYTES,
    VECTOR_BASELINES,
    available,
    exact_changed_rectangle,
    gzip_changed_rectangle,
    gzip_grid,
    png_grid,
    protocol,
    unavailable,
)
from fleetmap.codecs.baselines.lines import LATTICE_BYTES
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import UNKNOWN, Lattice
from fleetmap.model.pose import FixedPose, Pose2
from fleetmap.model.vectormap import VectorMap
from fleetmap.vectorize import vectorize

CELLS = np.random.default_rng(5).choice(np.array([-1, 0, 100], np.int8), (40, 30))


def grid(cells: np.ndarray, *, row: int = 0, column: int = 0, yaw_rad: float = 0.0) -> OccupancyGrid:
    """A grid whose cell (0, 0) lies on cell (row, column) of a lattice that is turned by ``yaw_rad``."""
    place = Pose2(3.0, -1.0, yaw_rad) @ Pose2(column * 0.05, row * 0.05)
    return OccupancyGrid(cells, 0.05, Pose2(place.x_m, place.y_m, yaw_rad))


def message(cells: np.ndarray) -> int:
    return HEADER_BYTES + len(gzip.compress(np.ascontiguousarray(cells).tobytes(), 6, mtime=0))


def test_the_whole_grid_is_one_byte_a_cell_and_a_header() -> None:
    assert gzip_grid(grid(CELLS)) == message(CELLS)
    assert gzip_grid(grid(CELLS), 9) <= gzip_grid(grid(CELLS), 1)


def test_an_unchanged_grid_is_not_sent() -> None:
    assert gzip_changed_rectangle(grid(CELLS), grid(CELLS.copy())) == 0


def test_the_smallest_rectangle_around_all_changes_is_sent() -> None:
    new = CELLS.copy()
    new[[7, 20, 11], [4, 9, 25]] = 50
    assert gzip_changed_rectangle(grid(CELLS), grid(new)) == message(new[7:21, 4:26])


@pytest.mark.parametrize("yaw_rad", [0.0, 0.7, math.pi])
def test_new_cells_count_as_changed_wherever_the_grid_grew(yaw_rad: float) -> None:
    old = grid(CELLS[5:, :28], row=5, yaw_rad=yaw_rad)
    assert gzip_changed_rectangle(old, grid(CELLS, yaw_rad=yaw_rad)) == message(CELLS)
    above = grid(CELLS[:30], yaw_rad=yaw_rad)
    assert gzip_changed_rectangle(above, grid(CELLS, yaw_rad=yaw_rad)) == message(CELLS[30:])
    left = grid(CELLS[:, 3:], column=3, yaw_rad=yaw_rad)
    assert gzip_changed_rectangle(left, grid(CELLS, yaw_rad=yaw_rad)) == message(CELLS[:, :3])


def test_a_grid_that_only_shrank_costs_a_header() -> None:
    assert gzip_changed_rectangle(grid(CELLS), grid(CELLS[2:-1, 1:], row=2, column=1)) == HEADER_BYTES


def test_without_a_common_lattice_the_whole_grid_is_sent() -> None:
    new = grid(CELLS)
    whole = gzip_grid(new)
    assert gzip_changed_rectangle(None, new) == whole
    assert gzip_changed_rectangle(OccupancyGrid(CELLS, 0.1, new.origin), new) == whole
    assert gzip_changed_rectangle(OccupancyGrid(CELLS, 0.05, Pose2(3.02, -1.0)), new) == whole
    assert gzip_changed_rectangle(OccupancyGrid(CELLS, 0.05, Pose2(3.0, -1.0, 0.1)), new) == whole
    assert gzip_changed_rectangle(grid(CELLS, row=1000, column=-1000), new) == whole


def test_a_rounded_origin_is_no_change() -> None:
    rounded = OccupancyGrid(CELLS, 0.05, Pose2(3.0004, -0.9997))
    assert gzip_changed_rectangle(rounded, grid(CELLS)) == 0


@pytest.mark.parametrize("most", [7, 29, 30, 31, 200, 1199, 1200])
def test_differences_beyond_one_payload_count_as_several(monkeypatch: pytest.MonkeyPatch, most: int) -> None:
    states = grid(CELLS).states_yx()
    monkeypatch.setattr(context_grid, "MAX_CELLS", most)
    parts = context_grid.split(states.shape)
    seen = np.zeros(states.shape, int)
    for part in parts:
        seen[part] += 1
        assert states[part].size <= most
    assert (seen == 1).all()
    base = np.full_like(states, UNKNOWN)
    sizes = [HEADER_BYTES + len(context_grid.encode_states(states[part], base[part])) for part in parts]
    changed = grid(CELLS)
    assert (states[[0, -1]] != UNKNOWN).any(axis=1).all()
    assert (states[:, [0, -1]] != UNKNOWN).any(axis=0).all()
    assert exact_changed_rectangle(None, changed) == sum(sizes)
    assert len(parts) > 1 or most == 1200


SMALL = st.tuples(st.integers(1, 6), st.integers(1, 6)).flatmap(
    lambda shape: arrays(np.int8, shape, elements=st.sampled_from([-1, 0, 100]))
)


@given(SMALL, SMALL, st.integers(-8, 8), st.integers(-8, 8))
def test_the_rectangle_agrees_with_a_cell_by_cell_count(
    old: np.ndarray, new: np.ndarray, row: int, column: int
) -> None:
    known = {(i + row, j + column): value for (i, j), value in np.ndenumerate(old)}
    changed = [cell for cell, value in np.ndenumerate(new) if known.get(cell) != value]
    found = gzip_changed_rectangle(grid(old, row=row, column=column), grid(new))
    if changed:
        (i0, j0), (i1, j1) = np.min(changed, axis=0), np.max(changed, axis=0)
        assert found == message(new[i0 : i1 + 1, j0 : j1 + 1])
    else:
        assert found == (0 if (row, column) == (0, 0) and old.shape == new.shape else HEADER_BYTES)


def test_png_is_a_grey_image_of_one_byte_a_cell() -> None:
    file = io.BytesIO()
    Image.fromarray(CELLS.view(np.uint8)).save(file, format="PNG", optimize=True)
    assert png_grid(grid(CELLS)) == HEADER_BYTES + len(file.getvalue())


def of(codecs: dict) -> pytest.MarkDecorator:
    """Each codec of a registry; one whose package is missing is skipped, and says so."""
    missing = unavailable()
    return pytest.mark.parametrize(
        "codec",
        [
            pytest.param(codec, id=name, marks=pytest.mark.skipif(name in missing, reason=missing.get(name, "")))
            for name, codec in codecs.items()
        ],
    )


def rooms(height: int, width: int) -> np.ndarray:
    """A map as robots leave it: rooms, walls, doors, unknown space around."""
    cells = np.full((height, width), -1, np.int8)
    cells[3:-4, 2:-3] = 0
    cells[3:-4:9, 2:-3] = 100
    cells[3:-4, 2:-3:11] = 100
    cells[5:-4:9, 2:-3] = 0
    cells[7, 5::7] = 37
    return cells


def assert_holds(codec: baselines.GridBaseline, cells: np.ndarray) -> None:
    sent = grid(cells, row=4, yaw_rad=0.3)
    data = codec.encode(sent)
    found = codec.decode(data)
    kept = sent.cells_yx if codec.keeps == "cells" else sent.states_yx()
    assert found.dtype == kept.dtype
    np.testing.assert_array_equal(found, kept)
    assert codec.encode(sent) == data


@of(GRID_BASELINES)
@pytest.mark.parametrize("shape", [(1, 1), (1, 2), (3, 1), (1, 37), (64, 64), (61, 83)])
def test_a_grid_comes_back(codec: baselines.GridBaseline, shape: tuple[int, int]) -> None:
    assert_holds(codec, np.random.default_rng(6).integers(-1, 101, shape, np.int8))
    assert_holds(codec, np.full(shape, -1, np.int8))


@of(GRID_BASELINES)
def test_a_map_of_odd_sizes_comes_back_and_is_smaller_than_its_cells(codec: baselines.GridBaseline) -> None:
    cells = rooms(101, 147)
    assert_holds(codec, cells)
    assert len(codec.encode(grid(cells))) < cells.size / 4


@of(GRID_BASELINES)
@settings(max_examples=15)
@given(SMALL)
def test_any_small_grid_comes_back(codec: baselines.GridBaseline, cells: np.ndarray) -> None:
    assert_holds(codec, cells)


def test_the_functions_count_the_bytes_of_the_codecs() -> None:
    sent = grid(rooms(101, 147))
    assert gzip_grid(sent, 6) == len(GRID_BASELINES["gzip6"].encode(sent))
    assert gzip_grid(sent, 9) == len(GRID_BASELINES["gzip9"].encode(sent))
    assert png_grid(sent) == len(GRID_BASELINES["png"].encode(sent))


def test_png_has_two_bits_a_cell_in_a_palette() -> None:
    data = GRID_BASELINES["png_states"].encode(grid(CELLS))[HEADER_BYTES:]
    depth_and_colour_type = data[24:26]
    assert depth_and_colour_type == bytes([2, 3])


def test_jpeg_xl_is_at_effort_nine() -> None:
    pylibjxl = pytest.importorskip("pylibjxl")
    sent = grid(rooms(101, 147))
    data = GRID_BASELINES["jpeg_xl"].encode(sent)[HEADER_BYTES:]
    assert data == pylibjxl.encode(sent.states_yx(), effort=9, lossless=True)
    assert data != pylibjxl.encode(sent.states_yx(), effort=7, lossless=True)


def test_a_quadtree_sends_only_the_children_of_mixed_nodes() -> None:
    codec = GRID_BASELINES["quadtree"]
    even = np.zeros((64, 64), np.int8)
    split = even.copy()
    split[0, 0] = 100
    for cells, nodes in ((even, 1), (split, 1 + 4 * 6)):
        data = zlib.decompress(codec.encode(grid(cells))[HEADER_BYTES:], -15)
        assert len(data) == math.ceil(nodes / 4)


TURNED = FixedPose.from_pose(Pose2(-31.2345, 812.5, 0.7))
LINES = np.array([[0, 0, 0, 9, 1], [0, 0, 7, -3, 1], [-5, 40, -5, 900, 2], [-5, 40, 3, 44, 6]], np.int32)
SQUARE = np.array([[0, 0, 0, 2, 1], [0, 0, 2, 0, 3], [0, 2, 2, 2, 1], [2, 0, 2, 2, 3]], np.int32)


def vector_map(edges: np.ndarray, pose: FixedPose = TURNED) -> VectorMap:
    return VectorMap(Lattice(50_000, pose), edges, np.zeros(len(edges), np.uint8))


def assert_same_segments(lines: list[np.ndarray], sent: VectorMap, error_m: float) -> None:
    """Each edge of the map is one step of one line, in either direction, and there are no other steps."""
    steps = np.concatenate([np.stack([line[:-1], line[1:]], axis=1) for line in [np.empty((0, 2)), *lines]])
    place = sent.lattice.T_frame_lattice.to_pose().inverse()
    points = place.apply(steps) / sent.lattice.resolution_m
    assert np.abs(points - points.round()).max(initial=0) * sent.lattice.resolution_m <= error_m + 1e-9
    found = sorted(tuple(sorted(map(tuple, ends))) for ends in points.round().astype(int)[..., ::-1].tolist())
    assert found == sorted((tuple(edge[:2]), tuple(edge[2:4])) for edge in sent.edges.tolist())


@of(VECTOR_BASELINES)
@pytest.mark.parametrize("edges", [LINES, LINES[:1], SQUARE, LINES[:0]], ids=["lines", "one", "loop", "empty"])
def test_lines_come_back(codec: baselines.VectorBaseline, edges: np.ndarray) -> None:
    sent = vector_map(edges)
    data = codec.encode(sent)
    assert_same_segments(codec.decode(data), sent, codec.error_m)
    assert codec.encode(sent) == data


@of(VECTOR_BASELINES)
def test_a_vectorized_map_comes_back(codec: baselines.VectorBaseline) -> None:
    sent = vectorize(grid(rooms(101, 147), yaw_rad=0.2))
    assert len(sent) > 20
    assert_same_segments(codec.decode(codec.encode(sent)), sent, codec.error_m)


COORDINATE = st.integers(-10_000, 10_000)


@of(VECTOR_BASELINES)
@settings(max_examples=15)
@given(st.lists(st.tuples(COORDINATE, COORDINATE, COORDINATE, COORDINATE), max_size=6))
@example([(5, -7, 5, -6)])
def test_any_few_segments_come_back(codec: baselines.VectorBaseline, ends: list[tuple[int, ...]]) -> None:
    edges = np.array([(*end, 1) for end in ends if end[:2] != end[2:]], np.int32).reshape(-1, 5)
    sent = vector_map(edges, FixedPose())
    assert_same_segments(codec.decode(codec.encode(sent)), sent, codec.error_m)


def test_twkb_is_written_as_the_specification_says() -> None:
    sent = vector_map(np.array([[1, 2, 1, 3, 1], [4, -4, 100, -4, 1]], np.int32))
    payload = VECTOR_BASELINES["twkb"].encode(sent)[LATTICE_BYTES:]
    # type, flags, 2 lines; 2 points (2, 1) (+1, 0); 2 points (-7, +3) (0, +96), all in zigzag
    assert payload == bytes([5, 0, 2, 2, 4, 2, 2, 0, 2, 13, 6, 0, 0xC0, 0x01])


def test_a_missing_package_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    find = importlib.util.find_spec
    gone = ("geobuf", "mapbox_vector_tile", "pylibjxl", "zstandard")
    monkeypatch.setattr(protocol, "find_spec", lambda name: None if name in gone else find(name))
    for name in gone:
        monkeypatch.setitem(sys.modules, name, None)
    codecs = ("geobuf", "jpeg_xl", "mvt", "zstd19", "zstd3")
    assert unavailable() == dict.fromkeys(codecs, "fleetmap[baselines]")
    assert available(GRID_BASELINES["webp"])
    for name in codecs:
        codec, sent = (GRID_BASELINES[name], grid(CELLS)) if name in GRID_BASELINES else (VECTOR_BASELINES[name], None)
        with pytest.raises(ImportError, match=r"missing: pip install 'fleetmap\[baselines\]'"):
            codec.encode(sent or vector_map(LINES))


def test_importing_the_baselines_imports_no_library() -> None:
    libraries = ("PIL", "geobuf", "mapbox_vector_tile", "msgpack", "pylibjxl", "scipy", "shapely", "zstandard")
    code = f"import sys, fleetmap.codecs.baselines; print([m for m in {libraries!r} if m in sys.modules])"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"


def test_registries_go_by_the_names_of_their_codecs() -> None:
    for codecs in (GRID_BASELINES, VECTOR_BASELINES):
        assert all(name == codec.name for name, codec in codecs.items())
    assert sorted(baselines.__all__) == sorted(set(baselines.__all__))
    assert all(hasattr(baselines, name) for name in baselines.__all__)
