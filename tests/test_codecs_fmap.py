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
    "464d415095020293cd4e200d03c414e31460e09461906460146191e7e164d260600000cf12ed1f96b91a387c",
    [(-5, -5, 20, 5, 0, 1, 1, 40), (3, 9, 3, 11, 0, 0, 1, 0), (3, 9, 4, -7, 2, 0, 0, 0)],
)
"""The bytes of a merged map whose origin is (0, 0), as they have been before there were others, but for the version."""
FIRST_VERSION = {
    "vector": (
        "464d415095010194cd4e2094d2ffd23940ce001e8480ce382a500dce1eaee874cb3fe000000000000001c40c01f9ee1ec29d57fc15af49be"
        "cfac7cb19923628160",
        VECTOR,
    ),
    "merged": (
        "464d415095010293cd4e200d03c414e31460e09461906460146191e7e164d260600000cf12ed1f96b91a387c",
        MergedMap(np.array(ORDINARY[1], np.int32), 20_000, 13),
    ),
}
"""Files as version 1 has written them, and what was in them."""


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


@pytest.mark.parametrize("kind", FIRST_VERSION)
def test_files_of_the_first_version_are_read(tmp_path: Path, kind: str) -> None:
    data, fleet_map = FIRST_VERSION[kind]
    path = tmp_path / "old.fmap"
    path.write_bytes(bytes.fromhex(data))
    back = load_fmap(path)
    assert type(back) is type(fleet_map)
    assert back.digest == fleet_map.digest
    # The next one differs in its number alone.
    save_fmap(back, path)
    assert path.read_bytes().hex() == data.replace("464d41509501", "464d41509502")


def with_facts(path: Path, facts: object, *, version: int = 2) -> Path:
    """The file, with a sixth element, as a later version may write it."""
    _, *fields = msgpack.unpackb(path.read_bytes()[4:])
    path.write_bytes(b"FMAP" + msgpack.packb([version, *fields, facts]))
    return path


@pytest.mark.parametrize("fleet_map", [VECTOR, MERGED])
@pytest.mark.parametrize("facts", [{}, {b"\xc8": b""}, {bytes([kind]) + b"x" * 95: b"y" * 100 for kind in range(256)}])
def test_facts_that_this_version_does_not_know_are_read_over(
    tmp_path: Path, fleet_map: VectorMap | MergedMap, facts: dict[bytes, bytes]
) -> None:
    save_fmap(fleet_map, tmp_path / "m.fmap")
    assert load_fmap(with_facts(tmp_path / "m.fmap", facts)).digest == fleet_map.digest


@pytest.mark.parametrize(
    ("facts", "reason"),
    [
        ([], "a map of facts"),
        (None, "a map of facts"),
        ({1: b""}, "."),
        ({b"a": 1}, "facts of bytes"),
        ({b"a": None}, "facts of bytes"),
        ({b"": b""}, "keys of 1 to 96 B"),
        ({b"a" * 97: b""}, "keys of 1 to 96 B"),
        ({b"a": b"x" * 1025}, "at most 1024 B"),
        ({f"{i:04}".encode(): b"" for i in range(2049)}, "."),
        ({f"{i:04}".encode(): b"x" * 1000 for i in range(300)}, "262144 B in all"),
    ],
)
def test_facts_out_of_their_bounds_are_refused(tmp_path: Path, facts: object, reason: str) -> None:
    save_fmap(VECTOR, tmp_path / "m.fmap")
    with pytest.raises(MapFormatError, match=rf"m\.fmap: envelope: .*{reason}"):
        load_fmap(with_facts(tmp_path / "m.fmap", facts))


def test_the_first_version_has_no_facts(tmp_path: Path) -> None:
    save_fmap(VECTOR, tmp_path / "m.fmap")
    with pytest.raises(MapFormatError, match="in version 2"):
        load_fmap(with_facts(tmp_path / "m.fmap", {}, version=1))


@pytest.mark.parametrize("version", [0, 3, None, True])
def test_another_version_is_refused(tmp_path: Path, version: object) -> None:
    save_fmap(VECTOR, tmp_path / "m.fmap")
    _, *fields = msgpack.unpackb((tmp_path / "m.fmap").read_bytes()[4:])
    (tmp_path / "m.fmap").write_bytes(b"FMAP" + msgpack.packb([version, *fields]))
    with pytest.raises(MapFormatError, match="this one reads versions 1 and 2"):
        load_fmap(tmp_path / "m.fmap")


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
