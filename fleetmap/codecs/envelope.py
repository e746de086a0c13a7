"""Messages: msgpack arrays, version and kind first. Every field is checked before anything is made of it.

``encode`` writes any message, ``decode`` reads one and raises nothing but ``WireError``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeVar

import msgpack

from fleetmap.codecs.facts.facts import MAX_KEY_BYTES, MAX_VALUE_BYTES
from fleetmap.codecs.messages import (
    CHECK_MASK,
    MAX_CHUNK_BYTES,
    MAX_CHUNKS,
    MAX_COUNT,
    MAX_COUNTER,
    MAX_EPSILON_CELLS,
    MAX_LIFE,
    MAX_MESSAGE_BYTES,
    MAX_MM,
    MAX_PROBLEM_BYTES,
    MAX_PROBLEMS,
    MAX_RANGE_ROWS,
    MAX_RANGES,
    MAX_ROWS,
    MAX_SEQ,
    MAX_TALLIES,
    PROFILES,
    Change,
    Heartbeat,
    Living,
    MapHeader,
    Message,
    Range,
    Ranges,
    Record,
    Relay,
    Revision,
    RevisionList,
    Row,
    SnapshotChunk,
    StatsMessage,
    SubmapChange,
    Tally,
    Want,
)
from fleetmap.codecs.names import NAME
from fleetmap.model.errors import FleetmapError, WireError
from fleetmap.model.lattice import Lattice
from fleetmap.model.pose import MAX_UM, Q30, FixedPose

VERSION = 2
LONE = "0"
"""The submap of robots that have one; its payload may stand without its name."""

HEAD_BYTES = 32
"""More than an array's header, version and kind, seq and link take."""

T = TypeVar("T")


class _OtherVersion(ValueError):
    def __init__(self, version: int) -> None:
        self.version = version
        super().__init__(f"version {version}; this one reads {VERSION}")


def encode(message: Message) -> bytes:
    """A message as bytes."""
    match message:
        case Record(seq, link, check, change):
            fields = [seq, link, check, *_change_out(change)]
        case SnapshotChunk(seq, digest, link, index, count, data):
            fields = [seq, digest, link, index, count, data]
        case Heartbeat(seq, held, alive, pose, goal):
            where = [] if pose is None and goal is None else [pose and list(pose), goal and list(goal)]
            fields = [seq, held, alive, *where]
        case Want(robot, revision, partial):
            fields = [robot, *_revision_out(revision), *(partial or ())]
        case RevisionList(revisions):
            fields = [_rows_out(revisions)]
        case Ranges(ranges):
            fields = [_ranges_out(ranges)]
        case Living(tokens):
            fields = [[list(token) for token in tokens]]
        case Relay(robot, life):
            fields = [robot, life]
        case StatsMessage(age_ms, links, edges, explored_dm2, watched, sent, grids, problems):
            told = [text.encode() for text in problems]
            fields = [age_ms, links, edges, explored_dm2, watched, dict(sent), dict(grids), told]
    packed: bytes = msgpack.packb([VERSION << 4 | message.KIND, *fields])
    return packed


def decode(data: bytes, *, robot: str) -> Message:
    """The message in ``data``, which came from ``robot``.

    Raises
    ------
    WireError : the bytes are not a message of this version, or a field is out of its bounds
    """
    return _guarded(data, robot, lambda: _read_message(_unpack(data)))


def record_head(data: bytes) -> tuple[int, int] | None:
    """(seq, link) of the record in ``data``, without looking at more of it; None if it begins like no record."""
    head = msgpack.Unpacker(max_buffer_size=HEAD_BYTES, max_str_len=0, max_bin_len=0, max_ext_len=0)
    head.feed(data[:HEAD_BYTES])
    try:
        if head.read_array_header() < 5 or head.unpack() != (VERSION << 4 | Record.KIND):
            return None
        return _integer(head.unpack(), 1, MAX_SEQ), _word(head.unpack())
    except (ValueError, TypeError, OverflowError, msgpack.exceptions.UnpackException):
        return None


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
        version = error.version if isinstance(error, _OtherVersion) else None
        reason = str(error) or type(error).__name__
        raise WireError(robot=robot, size_bytes=len(data), reason=reason, version=version) from None


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
        raise _OtherVersion(version)
    body = fields[1:]
    match kind:
        case Record.KIND:
            if len(body) < 4:
                raise ValueError("expected a seq, a link, a check and a change")
            seq, link, check = _integer(body[0], 1, MAX_SEQ), _word(body[1]), _integer(body[2], 0, CHECK_MASK)
            return Record(seq, link, check, _read_change(body[3:]))
        case SnapshotChunk.KIND:
            a = _array(body, 6)
            count = _integer(a[4], 1, MAX_CHUNKS)
            index = _integer(a[3], 0, count - 1)
            seq = _integer(a[0], 1, MAX_SEQ)
            return SnapshotChunk(seq, _word(a[1]), _word(a[2]), index, count, _bytes(a[5], MAX_CHUNK_BYTES))
        case Heartbeat.KIND:
            a = body if len(body) == 5 else (*_array(body, 3), None, None)
            pose = None if a[3] is None else _read_mm_mrad(a[3])
            goal = None if a[4] is None else _read_mm(_array(a[4], 2))
            return Heartbeat(_integer(a[0], 0, MAX_SEQ), _word(a[1]), _integer(a[2], 0, MAX_COUNTER), pose, goal)
        case Want.KIND:
            a = body if len(body) == 7 else _array(body, 4)
            partial = None
            if len(a) == 7:
                partial = (_integer(a[4], 1, MAX_SEQ), _word(a[5]), _integer(a[6], 1, MAX_CHUNKS))
            return Want(_name(a[0]), _read_revision(a[1:4]), partial)
        case RevisionList.KIND:
            return RevisionList(_read_rows(_array(body, 1)[0]))
        case Ranges.KIND:
            return Ranges(_read_ranges(_array(body, 1)[0]))
        case Living.KIND:
            tokens = [_array(token, 2) for token in _rows(_array(body, 1)[0])]
            return Living(tuple((_name(robot), _word(life)) for robot, life in tokens))
        case Relay.KIND:
            asked_for = _array(body, 2)
            return Relay(_name(asked_for[0]), _word(asked_for[1]))
        case StatsMessage.KIND:
            a = _array(body, 8)
            links, edges = (_integer(a[i], 0, MAX_COUNTER) for i in (1, 2))
            age_ms, explored_dm2 = (_integer(a[i], 0, MAX_COUNT) for i in (0, 3))
            counted = _tally(a[4]), _tallies(a[5]), _tallies(a[6])
            return StatsMessage(age_ms, links, edges, explored_dm2, *counted, _texts(a[7]))
    raise ValueError(f"unknown kind {kind}")


def _rows_out(rows: Iterable[Row]) -> list[list[object]]:
    return [[robot, *_revision_out(revision)] for robot, revision in rows]


def _read_rows(fields: object) -> tuple[Row, ...]:
    rows = [_array(row, 4) for row in _rows(fields)]
    return tuple((_name(row[0]), _read_revision(row[1:])) for row in rows)


def _ranges_out(ranges: Iterable[Range]) -> list[list[object]]:
    """A range that follows the one before says only where it ends."""
    out: list[list[object]] = []
    next_first = 0
    for of in ranges:
        where = [of.last] if of.first == next_first else [of.first, of.last]
        out.append([of.held if of.rows is None else _rows_out(of.rows), *where])
        next_first = of.last + 1
    return out


def _read_ranges(fields: object) -> tuple[Range, ...]:
    ranges: list[Range] = []
    next_first = listed_rows = 0
    if len(_rows(fields)) > MAX_RANGES:
        raise ValueError(f"expected at most {MAX_RANGES} ranges")
    for row in _rows(fields):
        a = _rows(row)
        what, first, last = a if len(a) == 3 else (_array(a, 2)[0], next_first, a[1])
        # They ascend: whoever has one place in many ranges would have it looked at so often.
        lower = _integer(first, next_first, MAX_LIFE)
        upper = _integer(last, lower, MAX_LIFE)
        listed = isinstance(what, tuple)
        listed_rows += len(what) if isinstance(what, tuple) else 0
        if listed_rows > MAX_RANGE_ROWS:
            raise ValueError(f"expected at most {MAX_RANGE_ROWS} rows in ranges")
        ranges.append(Range(lower, upper, None if listed else _word(what), _read_rows(what) if listed else None))
        next_first = upper + 1
    return tuple(ranges)


def _read_mm(fields: tuple[object, ...]) -> tuple[int, int]:
    return _integer(fields[0], -MAX_MM, MAX_MM), _integer(fields[1], -MAX_MM, MAX_MM)


def _read_mm_mrad(fields: object) -> tuple[int, int, int]:
    x_mm, y_mm, yaw_mrad = _array(fields, 3)
    return *_read_mm((x_mm, y_mm)), _integer(yaw_mrad, -3142, 3142)


def _revision_out(revision: Revision) -> list[int]:
    return [revision.life, revision.seq, revision.digest]


def _read_revision(fields: tuple[object, ...]) -> Revision:
    life, seq, digest = _array(fields, 3)
    return Revision(_integer(life, 0, MAX_LIFE), _integer(seq, 0, MAX_SEQ), _word(digest))


def _change_out(change: Change) -> list[object]:
    """Submaps by name, and the facts that changed; mostly only the payload of the one submap of its robot does."""
    submaps: dict[str, object] = {
        s.submap: [s.payload, map_header_fields(s.map_header)] if s.map_header else s.payload for s in change.submaps
    }
    lone = submaps.get(LONE)
    changed = lone if submaps.keys() == {LONE} and isinstance(lone, bytes) else submaps
    return [changed, dict(change.facts)] if change.facts else [changed]


def _read_change(fields: object) -> Change:
    if not isinstance(fields, tuple) or len(fields) not in (1, 2) or not isinstance(fields[0], bytes | dict):
        raise ValueError("expected a map of submaps, and one of facts if some changed")
    submaps = fields[0] if isinstance(fields[0], dict) else {LONE: fields[0]}
    facts = fields[1] if len(fields) == 2 else {}
    if not isinstance(facts, dict):
        raise ValueError("expected a map of facts")
    return Change(
        {_key(key): None if value is None else _bytes(value, MAX_VALUE_BYTES) for key, value in facts.items()},
        tuple(_read_submap(_name(name), what) for name, what in submaps.items()),
    )


def _read_submap(name: str, what: object) -> SubmapChange:
    if isinstance(what, bytes):
        return SubmapChange(name, None, _bytes(what, MAX_MESSAGE_BYTES))
    payload, map_header = _array(what, 2)
    return SubmapChange(name, read_map_header(map_header), _bytes(payload, MAX_MESSAGE_BYTES))


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


def _word(value: object) -> int:
    return _integer(value, 0, (1 << 64) - 1)


def _key(value: object) -> bytes:
    if not isinstance(value, bytes) or not 1 <= len(value) <= MAX_KEY_BYTES:
        raise ValueError(f"expected a key of 1 to {MAX_KEY_BYTES} bytes")
    return value


def _tally(value: object) -> Tally:
    messages, size_bytes, segments = _array(value, 3)
    return _integer(messages, 0, MAX_COUNT), _integer(size_bytes, 0, MAX_COUNT), _integer(segments, 0, MAX_COUNT)


def _tallies(value: object) -> dict[str, Tally]:
    if not isinstance(value, dict) or len(value) > MAX_TALLIES:
        raise ValueError(f"expected a map of at most {MAX_TALLIES} counts")
    return {_name(name): _tally(count) for name, count in value.items()}


def _texts(value: object) -> tuple[str, ...]:
    texts = _rows(value)
    if len(texts) > MAX_PROBLEMS:
        raise ValueError(f"expected at most {MAX_PROBLEMS} texts")
    return tuple(_bytes(text, MAX_PROBLEM_BYTES).decode() for text in texts)


def _bytes(value: object, longest: int) -> bytes:
    if not isinstance(value, bytes) or len(value) > longest:
        raise ValueError(f"expected at most {longest} bytes")
    return value


def _name(value: object) -> str:
    if not isinstance(value, str) or not NAME.fullmatch(value):
        raise ValueError("expected a name of 1 to 64 of A-Z a-z 0-9 _ . -")
    return value
