"""What robots say to each other, as values, and the bounds of every field. ``envelope`` turns them into bytes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from fleetmap.codecs.facts.facts import FactsStep
from fleetmap.model.lattice import EPSILON_CELLS, Lattice
from fleetmap.model.pose import MAX_UM

MAX_MESSAGE_BYTES = 4 << 20
MAX_CHUNK_BYTES = 2 << 10
"""What arrived is not lost when a link breaks: who asks again says which chunks it has. 2 s over 9.6 kbit/s."""
MAX_CHUNKS = 2048
"""A snapshot has at most 4 MB."""
MAX_ROWS = 4096
"""Longest list in a message: submaps of a record, revisions of a list."""
MAX_RANGES, MAX_RANGE_ROWS = 1024, 1024
"""Of a message: ranges, and rows in all of them."""
MAX_COUNTER = (1 << 32) - 1
MAX_COUNT = (1 << 53) - 1
"""Bytes, messages, milliseconds: what is whole for every reader of JSON, too."""
MAX_LIFE = (1 << 64) - 1
MAX_SEQ = 1 << 18
"""Revisions of one life: who hears of a life first hashes as its seq says (``engine.chain``), 0.1 s at most."""
CHECK_MASK = (1 << 16) - 1
MAX_MM = MAX_UM // 1000
PROFILES = ("share", "full", "exact")
MAX_EPSILON_CELLS = 1000.0


@dataclass(frozen=True, slots=True)
class MapHeader:
    """What a vector map is besides its edges; the empty map of this header is a snapshot's base."""

    lattice: Lattice
    epsilon_cells: float = EPSILON_CELLS
    profile: str = "share"


@dataclass(frozen=True, slots=True)
class SubmapChange:
    """What changed in one submap.

    With a ``map_header`` the payload is a delta from the empty map of that header, else from the submap's map.
    """

    submap: str
    map_header: MapHeader | None
    payload: bytes


@dataclass(frozen=True, slots=True)
class Change:
    """The step from one revision of a stream to the next, or from nothing to a revision."""

    facts: FactsStep
    submaps: tuple[SubmapChange, ...]


@dataclass(frozen=True, slots=True)
class Revision:
    """Which state of an author's stream: its life, sequence number (0: nothing yet) and 64-bit digest."""

    life: int
    seq: int
    digest: int

    @property
    def check(self) -> int:
        """The lowest 16 bits of the digest."""
        return self.digest & CHECK_MASK


@dataclass(frozen=True, slots=True)
class Record:
    """One revision of an author's stream, as a change from the revision before it.

    ``link`` proves that the author has come to this seq (``engine.chain``). ``check`` are the lowest 16 bits of the
    revision's digest: records are most of the traffic, and a short one is half envelope. One in 65536 of the records
    that come from the author and don't fit gets past it; then the heartbeats' hashes differ.
    """

    KIND: ClassVar[int] = 1
    seq: int
    link: int
    check: int
    change: Change


@dataclass(frozen=True, slots=True)
class SnapshotChunk:
    """Part ``index`` of ``count`` of a packed change from nothing to a revision; ``link`` as in records."""

    KIND: ClassVar[int] = 2
    seq: int
    digest: int
    link: int
    index: int
    count: int
    data: bytes

    @property
    def check(self) -> int:
        """The lowest 16 bits of the digest."""
        return self.digest & CHECK_MASK


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """How far the sender is, and where.

    Parameters
    ----------
    seq : of its own stream
    held : one hash over the revisions of all streams that it holds
    alive : one hash of 32 bits over who lives, as it sees it, itself too
    pose : x mm, y mm, yaw mrad, in the map frame of its life; None: it announces none
    goal : where it is going, x mm, y mm; None: nowhere
    """

    KIND: ClassVar[int] = 3
    seq: int
    held: int
    alive: int = 0
    pose: tuple[int, int, int] | None = None
    goal: tuple[int, int] | None = None


@dataclass(frozen=True, slots=True)
class Want:
    """The revision of a stream that the asker has, seq 0 for none; the answer is what it lacks.

    ``partial`` is (seq, digest, n) of a snapshot of which the asker has the first n chunks.
    """

    KIND: ClassVar[int] = 4
    robot: str
    revision: Revision
    partial: tuple[int, int, int] | None = None


Row = tuple[str, Revision]
"""A stream as somebody holds it."""


@dataclass(frozen=True, slots=True)
class RevisionList:
    """All streams that the sender keeps: (robot, revision), ascending."""

    KIND: ClassVar[int] = 5
    revisions: tuple[Row, ...]


@dataclass(frozen=True, slots=True)
class Range:
    """What the sender holds of the streams whose places (``engine.ranges``) are from ``first`` to ``last``.

    Either ``held``, a hash over their revisions, or ``rows``, all of them.
    """

    first: int
    last: int
    held: int | None = None
    rows: tuple[Row, ...] | None = None


@dataclass(frozen=True, slots=True)
class Ranges:
    """Ranges, ascending, in which the sender may hold something else than whoever reads it."""

    KIND: ClassVar[int] = 6
    ranges: tuple[Range, ...]


@dataclass(frozen=True, slots=True)
class Living:
    """The (robot, life) of all that the sender sees, itself too, ascending."""

    KIND: ClassVar[int] = 7
    tokens: tuple[tuple[str, int], ...]


@dataclass(frozen=True, slots=True)
class Relay:
    """For a while: hand on what the life of a robot says, whom the asker has no link to."""

    KIND: ClassVar[int] = 9
    robot: str
    life: int


Tally = tuple[int, int, int]
"""Messages, their payload bytes, and the TCP segments that they take."""
MAX_TALLIES = 64
MAX_PROBLEMS, MAX_PROBLEM_BYTES = 16, 400


@dataclass(frozen=True, slots=True)
class StatsMessage:
    """What a robot has counted of itself since it joined: the answer to a watcher.

    Parameters
    ----------
    age_ms : since it joined
    links : living peers that it sees
    edges : of its own map
    explored_dm2 : free floor in the grids that it published last, square decimetres; 0: it published none
    watched : answers to watchers so far; they are not in ``sent``
    sent : by kind, to one receiver
    grids : by name, what its updates would have been as grids; empty if it doesn't count them
    problems : what ``Peer.health`` tells, in words
    """

    KIND: ClassVar[int] = 8
    age_ms: int
    links: int
    edges: int
    explored_dm2: int
    watched: Tally
    sent: Mapping[str, Tally]
    grids: Mapping[str, Tally]
    problems: tuple[str, ...] = ()


Message = Record | SnapshotChunk | Heartbeat | Want | RevisionList | Ranges | Living | Relay | StatsMessage
