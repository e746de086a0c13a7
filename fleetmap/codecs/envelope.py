"""Messages: msgpack arrays, version and kind first. Every field is checked before anything is made of it.

``encode`` writes any message, ``decode`` reads one and raises nothing but ``WireError``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import msgpack

from fleetmap.codecs.messages import (
    CHECK_MASK,
    MAX_CHUNK_BYTES,
    MAX_CHUNKS,
    MAX_COUNT,
    MAX_COUNTER,
    MAX_EPSILON_CELLS,
    MAX_MESSAGE_BYTES,
    MAX_MM,
    MAX_ROWS,
    MAX_TALLIES,
    NAME,
    PROFILES,
    Change,
    GoalMessage,
    Header,
    Heartbeat,
    MapHeader,
    Message,
    PoseMessage,
    Record,
    Revision,
    RevisionList,
    SnapshotChunk,
    StatsMessage,
    SubmapChange,
    Tally,
    Want,
)
from fleetmap.model.errors import FleetmapError, WireError
from fleetmap.model.lattice import Lattice
from fleetmap.model.pose import MAX_UM, Q30, FixedPose

VERSION = 1
LONE = "0"
"""The submap of robots that have one; its payload may stand without its name."""

T = TypeVar("T")


def encode(message: Message) -> bytes:
    """A message as bytes."""
    match message:
        case Record(epoch, seq, check, change):
            fields = [epoch, seq, check, *_change_out(change)]
        case SnapshotChunk(revision, index, count, data):
            fields = [*_revision_out(revision), index, count, data]
        case Heartbeat(epoch, seq, held):
            fields = [epoch, seq, held]
        case Want(revision):
            fields = [*_revision_out(revision)]
        case RevisionList(revisions):
            fields = [[[robot, *_revision_out(revision)] for robot, revision in revisions]]
        case PoseMessage(epoch, x_mm, y_mm, yaw_mrad):
            fields = [epoch, x_mm, y_mm, yaw_mrad]
        case GoalMessage(epoch, goal_mm):
            fields = [epoch, list(goal_mm) if goal_mm else None]
        case StatsMessage(epoch, age_ms, links, edges, explored_dm2, watched, sent, grids):
            fields = [epoch, age_ms, links, edges, explored_dm2, watched, dict(sent), dict(grids)]
    packed: bytes = msgpack.packb([VERSION << 4 | message.KIND, *fields])
    return packed


def decode(data: bytes, *, robot: str) -> Message:
    """The message in ``data``, which came from ``robot``.

    Raises
    ------
    WireError : the bytes are not a message of this version, or a field is out of its bounds
    """
    return _guarded(data, robot, lambda: _read_message(_unpack(data)))


def encode_change(change: Change) -> bytes:
    """A change on its own: what the chunks of a snapshot add up to."""
    packed: bytes = msgpack.packb(_change_out(change))
    return packed


def decode_change(data: bytes, *, robot: str) -> Change:
    """The change in ``data``; raises nothing but ``WireError``."""
    return _guarded(data, robot, lambda: _read_change(_unpack(data)))


def map_header_fields(header: MapHeader) -> list[object]:
    """A map header as plain fields, for files."""
    return [
        header.lattice.resolution_um,
        _pose_out(header.lattice.T_frame_lattice),
        float(header.epsilon_cells),
        PROFILES.index(header.profile),
    ]


def read_map_header(fields: object) -> MapHeader:
    """The map header in unpacked fields; ``ValueError`` if they are none."""
    resolution_um, T_frame_lattice, epsilon_cells, profile = _array(fields, 4)
    pose = _read_pose(T_frame_lattice)
    if pose is None:
        raise ValueError("a lattice has no pose")
    if not isinstance(epsilon_cells, float) or not 0 <= epsilon_cells <= MAX_EPSILON_CELLS:
        raise ValueError(f"expected an error bound in [0, {MAX_EPSILON_CELLS}] cells")
    return MapHeader(
        Lattice(_integer(resolution_um, 1, MAX_COUNTER), pose),
        epsilon_cells,
        PROFILES[_integer(profile, 0, len(PROFILES) - 1)],
    )


def _guarded(data: bytes, robot: str, read: Callable[[], T]) -> T:
    try:
        return read()
    except (ValueError, TypeError, OverflowError, FleetmapError, msgpack.exceptions.UnpackException) as error:
        raise WireError(robot=robot, size_bytes=len(data), reason=str(error) or type(error).__name__) from None


def _unpack(data: bytes) -> object:
    if len(data) > MAX_MESSAGE_BYTES:
        raise ValueError("too long")
    unpacked: object = msgpack.unpackb(
        data,
        use_list=False,
        object_pairs_hook=_unlike,
        max_str_len=64,
        max_array_len=MAX_ROWS,
        max_map_len=MAX_ROWS,
        max_ext_len=0,
    )
    return unpacked


def _read_message(fields: object) -> Message:
    if not isinstance(fields, tuple) or not fields or type(fields[0]) is not int:
        raise ValueError("expected an array that starts with version and kind")
    version, kind = fields[0] >> 4, fields[0] & 15
    if version != VERSION:
        raise ValueError(f"version {version}; this one reads {VERSION}")
    body = fields[1:]
    match kind:
        case Record.KIND:
            return Record(
                *_counters(body[:2]),
                _integer(body[2] if len(body) > 2 else None, 0, CHECK_MASK),
                _read_change(body[3:]),
            )
        case SnapshotChunk.KIND:
            a = _array(body, 6)
            count = _integer(a[4], 1, MAX_CHUNKS)
            index = _integer(a[3], 0, count - 1)
            return SnapshotChunk(_read_revision(a[:3]), index, count, _bytes(a[5], MAX_CHUNK_BYTES))
        case Heartbeat.KIND:
            return Heartbeat(*_revision_fields(_array(body, 3)))
        case Want.KIND:
            return Want(_read_revision(_array(body, 3)))
        case RevisionList.KIND:
            rows = [_array(row, 4) for row in _rows(_array(body, 1)[0])]
            return RevisionList(tuple((_name(row[0]), _read_revision(row[1:])) for row in rows))
        case PoseMessage.KIND:
            a = _array(body, 4)
            return PoseMessage(
                _integer(a[0], 0, MAX_COUNTER),
                _integer(a[1], -MAX_MM, MAX_MM),
                _integer(a[2], -MAX_MM, MAX_MM),
                _integer(a[3], -3142, 3142),
            )
        case GoalMessage.KIND:
            a = _array(body, 2)
            goal = None
            if a[1] is not None:
                x_mm, y_mm = _array(a[1], 2)
                goal = (_integer(x_mm, -MAX_MM, MAX_MM), _integer(y_mm, -MAX_MM, MAX_MM))
            return GoalMessage(_integer(a[0], 0, MAX_COUNTER), goal)
        case StatsMessage.KIND:
            a = _array(body, 8)
            epoch, links, edges = (_integer(a[i], 0, MAX_COUNTER) for i in (0, 2, 3))
            age_ms, explored_dm2 = (_integer(a[i], 0, MAX_COUNT) for i in (1, 4))
            return StatsMessage(epoch, age_ms, links, edges, explored_dm2, _tally(a[5]), _tallies(a[6]), _tallies(a[7]))
    raise ValueError(f"unknown kind {kind}")


def _revision_out(revision: Revision) -> list[int]:
    return [revision.epoch, revision.seq, revision.digest]


def _counters(fields: tuple[object, ...]) -> tuple[int, int]:
    epoch, seq = _array(fields, 2)
    return _integer(epoch, 0, MAX_COUNTER), _integer(seq, 0, MAX_COUNTER)


def _revision_fields(fields: tuple[object, ...]) -> tuple[int, int, int]:
    return *_counters(fields[:2]), _integer(fields[2], 0, (1 << 64) - 1)


def _read_revision(fields: tuple[object, ...]) -> Revision:
    return Revision(*_revision_fields(fields))


def _change_out(change: Change) -> list[object]:
    """Submaps by name, and the header if it changed; mostly only the payload of the one submap of its robot does."""
    submaps: dict[str, object] = {}
    for s in change.submaps:
        map_header = map_header_fields(s.map_header) if s.map_header else None
        alone = s.anchor is None and map_header is None and s.payload is not None
        submaps[s.submap] = s.payload if alone else [s.payload, _pose_out(s.anchor), map_header]
    changed = submaps[LONE] if submaps.keys() == {LONE} and isinstance(submaps[LONE], bytes) else submaps
    if change.header is None:
        return [changed]
    return [changed, [change.header.level, _pose_out(change.header.start), [list(f) for f in change.header.forgets]]]


def _read_change(fields: object) -> Change:
    if not isinstance(fields, tuple) or len(fields) not in (1, 2) or not isinstance(fields[0], bytes | dict):
        raise ValueError("expected a map of submaps, and a header if it changed")
    submaps = fields[0] if isinstance(fields[0], dict) else {LONE: fields[0]}
    header = None
    if len(fields) == 2:
        level, start, forgets = _array(fields[1], 3)
        pairs = [_array(pair, 2) for pair in _rows(forgets)]
        header = Header(
            _name(level), _read_pose(start), tuple((_name(r), _integer(e, 0, MAX_COUNTER)) for r, e in pairs)
        )
    return Change(header, tuple(_read_submap(_name(name), what) for name, what in submaps.items()))


def _read_submap(name: str, what: object) -> SubmapChange:
    if isinstance(what, bytes):
        return SubmapChange(name, None, None, _bytes(what, MAX_MESSAGE_BYTES))
    payload, anchor, map_header = _array(what, 3)
    return SubmapChange(
        name,
        _read_pose(anchor),
        None if map_header is None else read_map_header(map_header),
        None if payload is None else _bytes(payload, MAX_MESSAGE_BYTES),
    )


def _unlike(pairs: list[tuple[object, object]]) -> dict[object, object]:
    """A msgpack map, whose keys must differ."""
    result = dict(pairs)
    if len(result) < len(pairs):
        raise ValueError("a map has a key twice")
    return result


def _pose_out(pose: FixedPose | None) -> list[int] | None:
    """None stays None; the identity, which most anchors are, is an empty array."""
    if pose is None:
        return None
    return [] if pose == FixedPose() else [pose.x_um, pose.y_um, pose.cos_q30, pose.sin_q30]


def _read_pose(fields: object) -> FixedPose | None:
    if fields is None or fields == ():
        return None if fields is None else FixedPose()
    x_um, y_um, cos_q30, sin_q30 = _array(fields, 4)
    return FixedPose(
        _integer(x_um, -MAX_UM, MAX_UM),
        _integer(y_um, -MAX_UM, MAX_UM),
        _integer(cos_q30, -Q30, Q30),
        _integer(sin_q30, -Q30, Q30),
    )


def _array(value: object, length: int) -> tuple[object, ...]:
    if not isinstance(value, tuple) or len(value) != length:
        raise ValueError(f"expected an array of {length}")
    return value


def _rows(value: object) -> tuple[object, ...]:
    if not isinstance(value, tuple):
        raise ValueError("expected an array")
    return value


def _integer(value: object, low: int, high: int) -> int:
    # bool is an int to Python, and not to msgpack.
    if type(value) is not int or not low <= value <= high:
        raise ValueError(f"expected a whole number in [{low}, {high}]")
    return value


def _tally(value: object) -> Tally:
    messages, size_bytes, segments = _array(value, 3)
    return _integer(messages, 0, MAX_COUNT), _integer(size_bytes, 0, MAX_COUNT), _integer(segments, 0, MAX_COUNT)


def _tallies(value: object) -> dict[str, Tally]:
    if not isinstance(value, dict) or len(value) > MAX_TALLIES:
        raise ValueError(f"expected a map of at most {MAX_TALLIES} counts")
    return {_name(name): _tally(count) for name, count in value.items()}


def _bytes(value: object, longest: int) -> bytes:
    if not isinstance(value, bytes) or len(value) > longest:
        raise ValueError(f"expected at most {longest} bytes")
    return value


def _name(value: object) -> str:
    if not isinstance(value, str) or not NAME.fullmatch(value):
        raise ValueError("expected a name of 1 to 64 of A-Z a-z 0-9 _ . -")
    return value
