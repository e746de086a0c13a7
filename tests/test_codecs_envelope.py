"""Messages: every kind comes back from its bytes; anything else is refused with ``WireError``."""

from __future__ import annotations

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleetmap.codecs import envelope as env
from fleetmap.codecs import messages as msg
from fleetmap.codecs.names import check_name
from fleetmap.model.errors import ConfigError, WireError
from fleetmap.model.lattice import Lattice
from fleetmap.model.pose import Q30, FixedPose

REVISION = msg.Revision(2**64 - 1, 7, 2**63)
TURNED = FixedPose(-(2**39), 5, 0, -Q30)
CHANGE = msg.Change(
    {b"\x01": b"ground.floor", b"\x02": None, b"\xc8unknown": b"\x00\xff", b"k" * 96: b"v" * 1024},
    (
        msg.SubmapChange("0", msg.MapHeader(Lattice(50_000, TURNED), 0.5, "exact"), b"\x00"),
        msg.SubmapChange("a.b", None, b"\x00\x01"),
    ),
)
MESSAGES: list[msg.Message] = [
    msg.Record(7, 2**64 - 1, 2**16 - 1, CHANGE),
    msg.Record(1, 0, 0, msg.Change({}, ())),
    msg.SnapshotChunk(7, 2**64 - 1, 5, 2, 3, b"abc"),
    msg.Heartbeat(0, 2**64 - 1),
    msg.Want("r-1", REVISION),
    msg.Want("r-1", REVISION, (9, 5, 2)),
    msg.RevisionList((("a", REVISION), ("b", msg.Revision(1, 1, 0)))),
    msg.Heartbeat(0, 7, 2**32 - 1, (-(10**9), 5, -3142), (4, -5)),
    msg.Heartbeat(0, 7, 0, None, (4, -5)),
    msg.Heartbeat(0, 7, 0, (1, 2, 3), None),
    msg.Ranges(()),
    msg.Ranges((msg.Range(0, 2, 7), msg.Range(3, 3, rows=(("a", REVISION),)), msg.Range(9, 2**64 - 1, 7))),
    msg.Living((("a", 0), ("b", 2**64 - 1))),
    msg.Relay("a", 7),
    msg.StatsMessage(12_000, 2, 68, 5592, (4, 600, 4), {"delta": (10, 655, 10), "pose": (1, 9, 1)}, {}),
]


@pytest.mark.parametrize("message", MESSAGES, ids=lambda m: type(m).__name__)
def test_a_message_comes_back(message: msg.Message) -> None:
    assert env.decode(env.encode(message), robot="r") == message


def test_a_change_comes_back() -> None:
    assert env.decode_change(env.encode_change(CHANGE), robot="r") == CHANGE


def test_a_heartbeat_is_small() -> None:
    assert len(env.encode(msg.Heartbeat(500, 2**63))) <= 19


@given(st.binary(max_size=80))
def test_random_bytes_raise_nothing_but_wire_errors(data: bytes) -> None:
    for read in (env.decode, env.decode_change):
        try:
            read(data, robot="r")
        except WireError as error:
            assert error.size_bytes == len(data)


_SCALARS = (
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**64 - 1)
    | st.floats()
    | st.binary(max_size=4)
    | st.text(max_size=4)
)
_TREES = st.recursive(_SCALARS, lambda inner: st.lists(inner, max_size=5), max_leaves=12)


@given(st.integers(0, 9), st.lists(_TREES, max_size=6))
def test_any_array_raises_nothing_but_wire_errors(kind: int, fields: list[object]) -> None:
    try:
        message = env.decode(msgpack.packb([16 * env.VERSION + kind, *fields]), robot="r")
    except WireError:
        return
    assert env.decode(env.encode(message), robot="r") == message


@given(st.sampled_from(MESSAGES), st.data())
def test_damaged_messages_raise_nothing_but_wire_errors(message: msg.Message, data: st.DataObject) -> None:
    raw = bytearray(env.encode(message))
    raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    for damaged in (bytes(raw), bytes(raw[: data.draw(st.integers(0, len(raw)))])):
        try:
            env.decode(damaged, robot="r")
        except WireError as error:
            assert error.robot == "r"


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ([0x13, 1, 1], "version 1; this one reads 2"),
        ([0x33, 1, 1], "version 3"),
        ([0x2F], "unknown kind"),
        ([True], "version and kind"),
        ([], "version and kind"),
        ([0x23, True, 1, 1], "whole number"),
        ([0x23, 2**18 + 1, 1, 1], "whole number"),
        ([0x23, -1, 1, 1], "whole number"),
        ([0x23, 1, 1], "array of 3"),
        ([0x23, 1, 1, 2**32], "whole number"),
        ([0x26, [[5, 9], [5, 9, 12]]], "whole number"),
        ([0x26, [[5, 2**64 - 1], [5, 2**64 - 1]]], "whole number"),
        ([0x22, 1, 1, 1, 3, 3, b""], "whole number"),
        ([0x22, 1, 1, 1, 0, msg.MAX_CHUNKS + 1, b""], "whole number"),
        ([0x22, 0, 1, 1, 0, 1, b""], "whole number"),
        ([0x22, 1, 1, 1, 0, 1, b"x" * (msg.MAX_CHUNK_BYTES + 1)], "bytes"),
        ([0x24, "r", 1, 1], "array of 4"),
        ([0x24, "r", 1, 1, 1, 5, 5], "array of 4"),
        ([0x24, "r", 1, 1, 1, 5, 5, 0], "whole number"),
        ([0x24, "a b", 1, 1, 1], "name"),
        ([0x25, [["a/b", 1, 1, 1]]], "name"),
        ([0x25, [["a" * 65, 1, 1, 1]]], "64"),
        ([0x27, [1]], "array of 2"),
        ([0x28, 1, 1, 1, 1, [1, 1, 1], {"a/b": [1, 1, 1]}, {}, []], "name"),
        ([0x28, 1, 1, 1, 1, [1, 1, 1], {"a": [1, 1]}, {}, []], "array of 3"),
        ([0x28, 1, 1, 1, 1, [1, 1, 2**53], {}, {}, []], "whole number"),
        ([0x28, 1, 1, 1, 1, [1, 1, 1], {}, {str(i): [1, 1, 1] for i in range(65)}, []], "at most 64"),
        ([0x28, 1, 1, 1, 1, [1, 1, 1], [], {}, []], "at most 64"),
        ([0x28, 1, 1, 1, 1, [1, 1, 1], {}, {}, [b""] * 17], "at most 16"),
        ([0x28, 1, 1, 1, 1, [1, 1, 1], {}, {}, [bytes(401)]], "at most 400"),
        ([0x28, 1, 1, 1, 1, [1, 1, 1], {}, {}, [b"\xff"]], "utf-8"),
        ([0x21, 0, 1, 1, {}], "whole number"),
        ([0x21, 1, 1, 2**16, {}], "whole number"),
        ([0x21, 1, 1], "a seq, a link, a check and a change"),
        ([0x21, 1, 1, 1, []], "map of submaps"),
        ([0x21, 1, 1, 1, {}, {}, {}], "map of submaps"),
        ([0x21, 1, 1, 1, {}, []], "map of facts"),
        ([0x21, 1, 1, 1, {}, {"a": b""}], "key of 1 to 96 bytes"),
        ([0x21, 1, 1, 1, {}, {b"": b""}], "key of 1 to 96 bytes"),
        ([0x21, 1, 1, 1, {}, {b"k" * 97: b""}], "key of 1 to 96 bytes"),
        ([0x21, 1, 1, 1, {}, {b"k": b"v" * 1025}], "at most 1024 bytes"),
        ([0x21, 1, 1, 1, {}, {b"k": 1}], "at most 1024 bytes"),
        ([0x21, 1, 1, 1, {"0": [b"", [5, [], 1.0, 0]]}], "0.1 mm"),
        ([0x21, 1, 1, 1, {"0": [b"", [50000, [0, 0, 1, 1], 1.0, 0]]}], "rotation"),
        ([0x21, 1, 1, 1, {"0": [b"", [50000, [], float("nan"), 0]]}], "error bound"),
        ([0x21, 1, 1, 1, {"0": [b"", [50000, [], 1.0, 3]]}], "whole number"),
        ([0x21, 1, 1, 1, {"a/b": b""}], "name"),
        ([0x21, 1, 1, 1, {"0": 5}], "array of 2"),
    ],
)
def test_a_field_out_of_bounds_is_named(fields: list[object], reason: str) -> None:
    with pytest.raises(WireError, match=reason):
        env.decode(msgpack.packb(fields), robot="r")


def test_long_lists_and_maps_are_refused() -> None:
    for fields in ([0x25, [0] * 5000], {1: 2}, [0x25, {}], [0x21, 1, 1, 1, {f"{i}": b"" for i in range(5000)}]):
        with pytest.raises(WireError):
            env.decode(msgpack.packb(fields), robot="r")


@pytest.mark.parametrize("tail", [[{"a": b"x", "b": b"y"}], [{}, {b"a": b"x", b"b": b"y"}]])
def test_what_is_named_twice_is_refused(tail: list[object]) -> None:
    raw = msgpack.packb([0x21, 1, 1, 1, *tail])
    with pytest.raises(WireError, match="twice"):
        env.decode(raw.replace(b"b", b"a"), robot="r")


def test_a_record_takes_17_bytes_beside_its_payload() -> None:
    """Of which 9 are the link."""
    record = msg.Record(100, 2**64 - 1, 2**16 - 1, msg.Change({}, (msg.SubmapChange("0", None, b"x" * 40),)))
    assert len(env.encode(record)) == 17 + 40


@pytest.mark.parametrize("name", ["", "a/b", "a b", "é", "a" * 65, "*", None])
def test_what_is_no_name_is_refused(name: str) -> None:
    with pytest.raises(ConfigError, match="robot"):
        check_name("robot", name)
