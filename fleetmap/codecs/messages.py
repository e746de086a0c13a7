"""What robots say to each other, as values, and the bounds of every field. ``envelope`` turns them into bytes."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from fleetmap.model.errors import ConfigError
from fleetmap.model.lattice import EPSILON_CELLS, Lattice
from fleetmap.model.pose import MAX_UM, FixedPose

NAME = re.compile(r"[A-Za-z0-9_.-]{1,64}")
"""Names of robots, fleets, levels and submaps."""
MAX_MESSAGE_BYTES = 16 << 20
MAX_CHUNK_BYTES = 256 << 10
MAX_CHUNKS = 64
"""A snapshot has at most 16 MB."""
MAX_ROWS = 4096
"""Longest list in a message: submaps of a record, revisions of a list."""
MAX_COUNTER = (1 << 32) - 1
MAX_COUNT = (1 << 53) - 1
"""Bytes, messages, milliseconds: what is whole for every reader of JSON, too."""
CHECK_MASK = (1 << 32) - 1
CLAIMED_EPOCHS = 1 << 31
"""Claims of others about a robot's epochs count below this: so it always has a higher one to go on with."""
MAX_MM = MAX_UM // 1000
PROFILES = ("share", "full", "exact")
MAX_EPSILON_CELLS = 1000.0


@dataclass(frozen=True, slots=True)
class Header:
    """What holds for a whole stream: level, T_fleet_robot if it is known, and streams that its author revokes.

    ``forgets`` names (robot, epoch): streams of that robot up to that epoch are to be dropped.
    """

    level: str = "0"
    start: FixedPose | None = None
    forgets: tuple[tuple[str, int], ...] = ()


@dataclass(frozen=True, slots=True)
class MapHeader:
    """What a vector map is besides its edges; the empty map of this header is a snapshot's base."""

    lattice: Lattice
    epsilon_cells: float = EPSILON_CELLS
    profile: str = "share"


@dataclass(frozen=True, slots=True)
class SubmapChange:
    """What changed in one submap; None means unchanged.

    With a ``map_header`` the payload is a delta from the empty map of that header, else from the submap's map.
    """

    submap: str
    anchor: FixedPose | None
    map_header: MapHeader | None
    payload: bytes | None


@dataclass(frozen=True, slots=True)
class Change:
    """The step from one revision of a stream to the next, or from nothing to a revision."""

    header: Header | None
    submaps: tuple[SubmapChange, ...]


@dataclass(frozen=True, slots=True)
class Revision:
    """Which state of an author's stream: epoch, sequence number (0: nothing yet) and 64-bit digest."""

    epoch: int
    seq: int
    digest: int

    @property
    def check(self) -> int:
        """The lower half of the digest."""
        return self.digest & CHECK_MASK


@dataclass(frozen=True, slots=True)
class Record:
    """One revision of an author's stream, as a change from the revision before it.

    ``check`` is the lower half of the revision's digest: records are most of the traffic, and a short one is half
    envelope. One in 2^32 of the records that don't fit gets past it; then the heartbeats' hashes differ.
    """

    KIND: ClassVar[int] = 1
    epoch: int
    seq: int
    check: int
    change: Change


@dataclass(frozen=True, slots=True)
class SnapshotChunk:
    """Part ``index`` of ``count`` of a packed change from nothing to a revision."""

    KIND: ClassVar[int] = 2
    revision: Revision
    index: int
    count: int
    data: bytes

    @property
    def epoch(self) -> int:
        """The revision's."""
        return self.revision.epoch

    @property
    def seq(self) -> int:
        """The revision's."""
        return self.revision.seq


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """How far the sender's own stream is, and one hash over the revisions of all streams that it holds."""

    KIND: ClassVar[int] = 3
    epoch: int
    seq: int
    held: int


@dataclass(frozen=True, slots=True)
class Want:
    """The revision of a stream that the asker has; the answer is what it lacks. Epoch 0: it has none."""

    KIND: ClassVar[int] = 4
    revision: Revision


@dataclass(frozen=True, slots=True)
class RevisionList:
    """All streams that the sender holds: (robot, revision), ascending."""

    KIND: ClassVar[int] = 5
    revisions: tuple[tuple[str, Revision], ...]


@dataclass(frozen=True, slots=True)
class PoseMessage:
    """Where the sender is in its map frame of that epoch: millimetres and milliradians."""

    KIND: ClassVar[int] = 6
    epoch: int
    x_mm: int
    y_mm: int
    yaw_mrad: int


@dataclass(frozen=True, slots=True)
class GoalMessage:
    """Where the sender is going, in its map frame, millimetres; None: nowhere."""

    KIND: ClassVar[int] = 7
    epoch: int
    goal_mm: tuple[int, int] | None


Tally = tuple[int, int, int]
"""Messages, their payload bytes, and the TCP segments that they take."""
MAX_TALLIES = 64


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
    """

    KIND: ClassVar[int] = 8
    epoch: int
    age_ms: int
    links: int
    edges: int
    explored_dm2: int
    watched: Tally
    sent: Mapping[str, Tally]
    grids: Mapping[str, Tally]


Message = Record | SnapshotChunk | Heartbeat | Want | RevisionList | PoseMessage | GoalMessage | StatsMessage


def check_name(option: str, name: str) -> str:
    """The name, if it is one.

    Raises
    ------
    ConfigError : it is not 1 to 64 of the characters A-Z a-z 0-9 _ . -
    """
    if not isinstance(name, str) or not NAME.fullmatch(name):
        raise ConfigError(option=option, value=name, reason="expected 1 to 64 of A-Z a-z 0-9 _ . -")
    return name
