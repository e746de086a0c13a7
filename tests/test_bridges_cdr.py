"""ROS messages as bytes, of friends and of anybody: each comes back, or is refused, and no lie takes memory."""

import dataclasses
import math
import struct
import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleetmap.bridges import cdr, grids, said
from fleetmap.model.errors import WireError
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.mergedmap import MergedMap
from fleetmap.model.pose import Pose2
from fleetmap.peer import TeammateInfo
from fleetmap.peer.health import Problem

pytest.importorskip("rosbags")

NOW_NS = 1_700_000_000_123_456_789
GRID = OccupancyGrid(np.array([[0, 100, -1], [50, 1, 99]], np.int8), 0.05, Pose2(1.0, -2.0, 0.7))
CHANGED = OccupancyGrid(np.array([[0, 100, -1], [50, 0, 98]], np.int8), 0.05, Pose2(1.0, -2.0, 0.7))
MERGED = MergedMap(np.array([(-5, -5, 20, 5, 0, 1, 1, 40), (3, 9, 3, 11, 0, 0, 1, 0), (3, 9, 4, -7, 2, 0, 0, 0)]))
MATES = [TeammateInfo("r1", Pose2(1, 2, 3), None, 0.1), TeammateInfo("r2", None, None, 9.0)]
WHEN = {"frame_id": "fleet", "stamp_ns": NOW_NS}

POSE = cdr.make(
    cdr.POSE,
    header=cdr.header("map", NOW_NS),
    pose=cdr.make(
        "geometry_msgs/msg/PoseWithCovariance", pose=grids.pose_message(Pose2(1, 2, 3)), covariance=np.arange(36.0)
    ),
)
SPOKEN = {
    "clock": (cdr.CLOCK, cdr.make(cdr.CLOCK, clock=cdr.time_of(NOW_NS))),
    "diagnostics": (
        cdr.DIAGNOSTICS,
        said.diagnostics("r1", "site", [Problem("version", "r2", "é")], {"peers": 2}, stamp_ns=NOW_NS),
    ),
    "map": (cdr.MAP, grids.map_message(GRID, **WHEN)),
    "update": (cdr.MAP_UPDATE, grids.update_message(GRID, CHANGED, **WHEN)),
    "walls": (cdr.MARKERS, said.walls(MERGED, **WHEN)),
    "names": (cdr.MARKERS, said.names(MATES, **WHEN)),
    "poses": (cdr.POSES, said.poses(MATES, **WHEN)),
    "pose": (cdr.POSE, POSE),
    "text": (cdr.TEXT, cdr.make(cdr.TEXT, data="grüße")),
    "transform": (cdr.TF, said.transform(Pose2(1, 2, 3), parent="fleet", child="map", stamp_ns=NOW_NS)),
    "number": (cdr.WHOLE_NUMBER, cdr.make(cdr.WHOLE_NUMBER, data=2**64 - 1)),
}
EACH = pytest.mark.parametrize(("type_name", "message"), SPOKEN.values(), ids=SPOKEN)


def equal(a, b):
    """Field by field; floats as near as float32 has them."""
    if dataclasses.is_dataclass(a):
        return type(a) is type(b) and all(equal(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(a))
    if isinstance(a, list | tuple | np.ndarray):
        return len(a) == len(b) and all(map(equal, a, b))
    return math.isclose(a, b, rel_tol=1e-6) if isinstance(a, float) else a == b


def read(data, type_name):
    """The message, or None where it was refused: nothing but a WireError may leave."""
    try:
        return cdr.decode(data, type_name, topic="/t")
    except WireError as error:
        assert (error.robot, error.size_bytes) == ("/t", len(data))
        return None


@pytest.mark.parametrize("type_name", cdr.HASHES)
def test_hashes_are_those_that_rosbags_makes_of_the_definitions(type_name):
    assert cdr.HASHES[type_name] == cdr.typestore().hash_rihs01(type_name)


@EACH
def test_what_is_said_comes_back(type_name, message):
    data = cdr.encode(message, type_name)
    back = cdr.decode(data, type_name, topic="/t")
    assert equal(message, back)
    assert data[:4] == b"\x00\x01\x00\x00"
    assert cdr.encode(back, type_name) == data


@EACH
def test_the_other_endianness_is_read_too(type_name, message):
    data = bytes(cdr.typestore().serialize_cdr(message, type_name, little_endian=False))
    assert data[:2] == b"\x00\x00"
    assert equal(message, cdr.decode(data, type_name, topic="/t"))


@pytest.mark.parametrize("frame_id", ["", "m", "ma", "map", "r1/map", "a/b/map", "aaaa/map", "aaaaa/map"])
def test_what_stands_in_padding_is_nothing(frame_id):
    data = bytearray(cdr.encode(grids.map_message(GRID, frame_id=frame_id, stamp_ns=NOW_NS), cdr.MAP))
    text_ends = 4 + 8 + 4 + len(frame_id) + 1
    load_time = text_ends + -text_ends % 4
    info_ends = load_time + 8 + 12
    origin = 4 + (info_ends - 4) + -(info_ends - 4) % 8
    assert struct.unpack_from("<dd", data, origin) == (1.0, -2.0)
    for k in (*range(text_ends, load_time), *range(info_ends, origin)):
        data[k] = 0xAB
    back = cdr.decode(bytes(data), cdr.MAP, topic="/t")
    assert equal(back, grids.map_message(GRID, frame_id=frame_id, stamp_ns=NOW_NS))


@EACH
def test_a_message_that_was_cut_is_refused(type_name, message):
    data = cdr.encode(message, type_name)
    assert [size for size in range(len(data)) if read(data[:size], type_name) is not None] == []


@EACH
def test_a_message_with_more_behind_it_is_refused(type_name, message):
    assert read(cdr.encode(message, type_name) + bytes(64), type_name) is None


@given(st.data())
def test_bytes_that_were_flipped_are_refused_or_another_message(data):
    type_name, message = data.draw(st.sampled_from(list(SPOKEN.values())))
    wire = bytearray(cdr.encode(message, type_name))
    for _ in range(data.draw(st.integers(1, 4))):
        wire[data.draw(st.integers(0, len(wire) - 1))] = data.draw(st.integers(0, 255))
    read(bytes(wire), type_name)


@given(st.binary(max_size=300), st.sampled_from(sorted(cdr.HASHES)), st.sampled_from([*cdr.CDR_HEADERS, b""]))
def test_any_bytes_are_refused_or_a_message(body, type_name, header):
    read(header + (b"\x00\x00" if header else b"") + body, type_name)


def peak_bytes(data, type_name):
    tracemalloc.start()
    try:
        read(data, type_name)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@EACH
@pytest.mark.parametrize("length", [0xFFFFFFFF, 0x7FFFFFFF, 0x01000000])
def test_lengths_that_are_lies_take_no_memory(type_name, message, length):
    data = cdr.encode(message, type_name)
    for at in range(4, len(data) - 3, 4):
        lie = data[:at] + struct.pack("<I", length) + data[at + 4 :]
        assert peak_bytes(lie, type_name) < 10 * len(data) + 2**20


MANY = 3000
HOLLOW = TeammateInfo("", Pose2(), None, 0.0)
ZERO = cdr.make("geometry_msgs/msg/Point", x=0.0, y=0.0, z=0.0)
PAIR = cdr.make("diagnostic_msgs/msg/KeyValue", key="", value="")


def many(kind):
    """A message of many elements, each as small on the wire as it gets."""
    where = {"frame_id": "", "stamp_ns": 0}
    if kind == cdr.TF:
        message = said.transform(Pose2(), parent="", child="", stamp_ns=0)
        message.transforms *= MANY
    elif kind == cdr.POSES:
        message = said.poses([HOLLOW] * MANY, **where)
    elif kind == cdr.DIAGNOSTICS:
        message = said.diagnostics("", "", [], {}, stamp_ns=0)
        message.status[0].message, message.status[0].values = "", [PAIR] * MANY
    else:
        message = said.names([HOLLOW], **where)
        message.markers[0].points = [ZERO] * MANY
    return cdr.encode(message, kind)


@pytest.mark.parametrize("type_name", [cdr.TF, cdr.POSES, cdr.DIAGNOSTICS, cdr.MARKERS])
@pytest.mark.parametrize("count", [MANY + 1, 1_000_000, 0x7FFFFFFF, 0xFFFFFFFF])
def test_counts_that_are_lies_are_refused_and_take_no_memory(type_name, count):
    data, true = many(type_name), struct.pack("<I", MANY)
    assert data.count(true) == 1
    lie = data.replace(true, struct.pack("<I", count))
    assert read(data, type_name) is not None
    assert read(lie, type_name) is None
    assert peak_bytes(lie, type_name) < 12 * len(lie) + 2**20


def test_messages_longer_than_the_largest_grid_are_refused_unread(monkeypatch):
    monkeypatch.setattr(cdr, "MAX_MESSAGE_BYTES", 100)
    with pytest.raises(WireError, match="longer than 100 B"):
        cdr.decode(bytes(101), cdr.MAP, topic="/t")
    with pytest.raises(WireError, match="no plain CDR: it begins with 00030000"):
        cdr.decode(b"\x00\x03" + bytes(98), cdr.MAP, topic="/t")


@given(st.integers(0, 2**31 * 10**9 - 1))
def test_times_come_back_to_the_nanosecond(stamp_ns):
    assert cdr.ns_of(cdr.time_of(stamp_ns)) == stamp_ns
