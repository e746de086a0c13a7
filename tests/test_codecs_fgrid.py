"""``.fgrid`` files: every cell comes back, alone or upon a vector map; anything else is an error that says what."""

from __future__ import annotations

from pathlib import Path

import msgpack
import numpy as np
import pytest
from golden import grid, rooms
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fleetmap.codecs import fgrid
from fleetmap.codecs.fgrid import MAGIC, load_fgrid, save_fgrid
from fleetmap.model.errors import MapFormatError
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.pose import Pose2
from fleetmap.vectorize import rasterize, vectorize

CELLS = OccupancyGrid.from_states(rooms(1), 0.05, Pose2(-3.213, 1.7, 0.3))


def base(cells: OccupancyGrid):
    vector_map = vectorize(cells)
    return vector_map.digest, lambda like: rasterize(vector_map, like=like)


@pytest.mark.parametrize("upon_vectors", [False, True])
def test_every_cell_comes_back(tmp_path: Path, upon_vectors: bool) -> None:
    path = tmp_path / "a.fgrid"
    save_fgrid(CELLS, path, base=base(CELLS) if upon_vectors else None)
    again = load_fgrid(path, base=base(CELLS))
    assert np.array_equal(again.states_yx(), CELLS.states_yx())
    assert (again.resolution_m, again.origin) == (CELLS.resolution_m, CELLS.origin)


def test_a_grid_with_too_many_cells_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fgrid, "MAX_CELLS", 100)
    with pytest.raises(MapFormatError, match="at most 100 cells"):
        save_fgrid(CELLS, tmp_path / "a.fgrid")
    assert list(tmp_path.iterdir()) == []


def test_the_vector_map_must_be_the_same(tmp_path: Path) -> None:
    path = tmp_path / "a.fgrid"
    save_fgrid(CELLS, path, base=base(CELLS))
    for other, says in ((None, "none was named"), (base(grid(rooms(2))), "was named")):
        with pytest.raises(MapFormatError, match=says) as found:
            load_fgrid(path, base=other)
        assert (found.value.path, found.value.field) == (str(path), "base")
    digest, _ = base(CELLS)
    with pytest.raises(MapFormatError, match=r"checksum|states"):
        load_fgrid(path, base=(digest, lambda like: like))


@settings(max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_damaged_files_are_refused(tmp_path: Path, data: st.DataObject) -> None:
    path = tmp_path / "a.fgrid"
    save_fgrid(grid(rooms(3, height=40, width=50)), path)
    raw = bytearray(path.read_bytes())
    raw[data.draw(st.integers(0, len(raw) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    cut = data.draw(st.integers(0, len(raw))) if data.draw(st.booleans()) else len(raw)
    path.write_bytes(raw[:cut])
    try:
        again = load_fgrid(path)
    except MapFormatError as error:
        assert error.path == str(path)
    else:  # in the resolution or the origin, which nothing checks
        assert again.height == 40


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "expected b'FGRD'"),
        (b"FMAP\x90", "expected b'FGRD'"),
        (MAGIC, "envelope"),
        (MAGIC + b"\x90", "array of 6"),
        (MAGIC + b"\x96\x02\x01\x01\x01\x01\x01", "version 2"),
        (MAGIC + b"\x96\x01\x01\x01\x01\x01\x01", "origin of three numbers"),
        (MAGIC + msgpack.packb([1, -0.05, [0.0, 0.0, 0.0], None, 0, b"\x02\x02"]), "resolution_m: expected"),
    ],
)
def test_what_is_no_such_file_is_refused(tmp_path: Path, content: bytes, says: str) -> None:
    path = tmp_path / "a.fgrid"
    path.write_bytes(content)
    with pytest.raises(MapFormatError, match=says) as found:
        load_fgrid(path)
    assert found.value.path == str(path)
    with pytest.raises(MapFormatError, match="No such file"):
        load_fgrid(tmp_path / "none.fgrid")
