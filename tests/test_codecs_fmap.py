""".fmap files: a map comes back whole, or the error names the file and the field."""

from __future__ import annotations

from pathlib import Path

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleetmap.codecs.fmap import load_fmap, save_fmap
from fleetmap.model.errors import MapFormatError
from fleetmap.model.lattice import Lattice
from fleetmap.model.mergedmap import ORIGIN_UM, MergedMap
from fleetmap.model.pose import FixedPose, Pose2
from fleetmap.model.vectormap import VectorMap

VECTOR = VectorMap(
    Lattice(20_000, FixedPose.from_pose(Pose2(-3.0, 2.0, 0.5))),
    np.array([(0, 0, 0, 9, 1), (0, 9, 7, 9, 1), (0, 0, 7, 9, 3), (2, 2, 3, 3, 5)], np.int32),
    np.array([4, 4, 7, 0], np.uint8),
    0.5,
    "full",
)
MERGED = MergedMap(
    np.array([(-(2**20), -5, 2**20, 5, 0, 1, 1, 40), (3, 9, 3, 11, 0, 0, 1, 0), (3, 9, 4, -7, 2, 0, 0, 0)], np.int32),
    20_000,
    13,
)


def test_a_vector_map_comes_back(tmp_path: Path) -> None:
    save_fmap(VECTOR, tmp_path / "v.fmap")
    back = load_fmap(tmp_path / "v.fmap")
    assert isinstance(back, VectorMap)
    assert back.digest == VECTOR.digest
    assert (back.lattice, back.epsilon_cells, back.profile) == (VECTOR.lattice, 0.5, "full")
    assert np.array_equal(back.thickness, VECTOR.thickness)


FAR = MergedMap(
    MERGED.edges, 20_000, 13, origin_um=(488 * ORIGIN_UM, -3 * ORIGIN_UM), left_out=((("a", 1, "0"), "why"),)
)
ORDINARY = (
    "464d415095010293cd4e200d03c414e31460e09461906460146191e7e164d260600000cf12ed1f96b91a387c",
    [(-5, -5, 20, 5, 0, 1, 1, 40), (3, 9, 3, 11, 0, 0, 1, 0), (3, 9, 4, -7, 2, 0, 0, 0)],
)
"""The bytes of a merged map whose origin is (0, 0), as they have been before there were others."""


@pytest.mark.parametrize("merged", [MERGED, FAR, MergedMap(np.zeros((0, 8), np.int32))])
def test_a_merged_map_comes_back(tmp_path: Path, merged: MergedMap) -> None:
    save_fmap(merged, tmp_path / "m.fmap")
    back = load_fmap(tmp_path / "m.fmap")
    assert isinstance(back, MergedMap)
    assert back.to_bytes() == merged.to_bytes()
    assert back.origin_um == merged.origin_um
    assert np.array_equal(back.segments_xy, merged.segments_xy)


def test_an_origin_of_0_takes_no_bytes(tmp_path: Path) -> None:
    path, merged = tmp_path / "m.fmap", MergedMap(np.array(ORDINARY[1], np.int32), 20_000, 13)
    save_fmap(merged, path)
    assert path.read_bytes().hex() == ORDINARY[0]
    assert load_fmap(path).digest == "12ed1f96b91a387c" == merged.digest


@pytest.mark.parametrize(
    "about", [[20_000, 13, 3, 1], [20_000, 13, 3, 0, 0], [20_000, 13, 3, 1, 1 << 15], [1, 2, 3, "x", 1]]
)
def test_an_origin_that_is_none_is_refused(tmp_path: Path, about: list[object]) -> None:
    path = tmp_path / "m.fmap"
    save_fmap(FAR, path)
    version, kind, _, columns, digest = msgpack.unpackb(path.read_bytes()[4:])
    path.write_bytes(b"FMAP" + msgpack.packb([version, kind, about, columns, digest]))
    with pytest.raises(MapFormatError, match=r"m\.fmap"):
        load_fmap(path)


def test_a_file_that_is_replaced_is_never_half_written(tmp_path: Path) -> None:
    path = tmp_path / "m.fmap"
    save_fmap(MERGED, path)
    with pytest.raises(AttributeError):
        save_fmap(None, path)  # type: ignore[arg-type]
    assert isinstance(load_fmap(path), MergedMap)
    assert list(tmp_path.iterdir()) == [path]


@given(st.sampled_from([VECTOR, MERGED, FAR]), st.data())
def test_a_damaged_file_is_refused(
    tmp_path_factory: pytest.TempPathFactory, fleet_map: VectorMap | MergedMap, data: st.DataObject
) -> None:
    path = tmp_path_factory.mktemp("fmap") / "x.fmap"
    save_fmap(fleet_map, path)
    whole = bytearray(path.read_bytes())
    place = data.draw(st.integers(0, len(whole) - 1))
    flipped = whole[place] ^ data.draw(st.integers(1, 255))
    whole[place] = flipped
    path.write_bytes(whole)
    try:
        back = load_fmap(path)
    except MapFormatError as error:
        assert str(path) in str(error)
    else:  # a map header's error bound and profile are not in the digest
        assert back.digest == fleet_map.digest


@pytest.mark.parametrize("data", [b"", b"FMAP", b"FMAP\xc1", b"PK\x03\x04", b"FMAP\x95\x01\x03\x90\xc4\x00\x00"])
def test_what_is_no_fmap_file_is_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "x.fmap"
    path.write_bytes(data)
    with pytest.raises(MapFormatError, match=r"x\.fmap"):
        load_fmap(path)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(MapFormatError, match="No such file"):
        load_fmap(tmp_path / "none.fmap")
