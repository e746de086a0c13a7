"""All that an author says, as one immutable value, its digest, and the changes from one revision to the next.

The digest is a sum mod 2^64 of one hash for each of these (``model.hashing`` has the hash; salts in brackets):

- the header: (epoch, start known, its x, y, cos, sin or 0) [the level's name, salted with the robot's]
- each revoked stream: (its epoch) [its robot's name, salted with the author's]
- each submap: (digest of its vector map, epsilon in 1e-9 cells, profile number, anchor x, y, cos, sin)
  [epoch, salted with the submap's name, salted with the robot's: its frame]

So equal edges in two frames hash differently, and a record that was meant for another robot can't fit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from fleetmap.codecs import protocol
from fleetmap.codecs.messages import PROFILES, Change, Header, MapHeader, Revision, SubmapChange
from fleetmap.model.delta import apply, diff
from fleetmap.model.errors import WireError
from fleetmap.model.hashing import hash_ints, hash_text
from fleetmap.model.pose import FixedPose
from fleetmap.model.vectormap import VectorMap

SALT_AUTHOR, SALT_REVOKED = 16, 17
EPSILON_PER_CELL = 10**9
MAX_SUBMAPS = 1024
MOST_OF_SNAPSHOT = 0.6
"""A delta that takes a larger share of a snapshot's bytes goes as one: it asks nothing of the receiver's base."""

_MASK = (1 << 64) - 1


@dataclass(frozen=True, slots=True, eq=False)
class Submap:
    """A vector map, and where its frame lies in the robot's map frame."""

    vector_map: VectorMap
    anchor: FixedPose


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class Stream:
    """One revision of what an author says. ``seq`` 0 is the empty stream before its first record."""

    robot: str
    epoch: int
    seq: int = 0
    header: Header = field(default_factory=Header)
    submaps: Mapping[str, Submap] = field(default_factory=dict)
    digest: int = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "digest", _digest(self))

    @property
    def revision(self) -> Revision:
        """(epoch, seq, digest)."""
        return Revision(self.epoch, self.seq, self.digest)

    @property
    def edges(self) -> int:
        """Number of edges in all submaps."""
        return sum(len(s.vector_map) for s in self.submaps.values())


def change_between(old: Stream, new: Stream) -> Change:
    """The change that makes ``new`` of ``old``; from the stream with seq 0 it is a snapshot."""
    header = new.header if new.header != old.header or old.seq == 0 else None
    submaps = []
    for name, submap in sorted(new.submaps.items()):
        before = old.submaps.get(name)
        if before is not None and before.vector_map is submap.vector_map and before.anchor == submap.anchor:
            continue
        anchor = submap.anchor if before is None or before.anchor != submap.anchor else None
        map_header, payload = _encode_map(None if before is None else before.vector_map, submap.vector_map)
        if anchor or payload:
            submaps.append(SubmapChange(name, anchor, map_header, payload))
    return Change(header, tuple(submaps))


def advance(stream: Stream, change: Change, *, seq: int, digest: int, mask: int = -1) -> Stream:
    """The stream at ``seq``, by the change that leads there.

    Raises
    ------
    WireError : the change doesn't fit this stream, or the result hasn't that digest, in the bits of ``mask``
    """

    def refuse(reason: str) -> WireError:
        size_bytes = sum(len(s.payload or b"") for s in change.submaps)
        return WireError(robot=stream.robot, size_bytes=size_bytes, reason=reason)

    submaps = dict(stream.submaps)
    for part in change.submaps:
        before = submaps.get(part.submap)
        anchor = part.anchor or (before.anchor if before else None)
        if part.map_header is not None:
            h = part.map_header
            base = VectorMap.empty(h.lattice, epsilon_cells=h.epsilon_cells, profile=h.profile)
        elif before is not None:
            base = before.vector_map
        else:
            raise refuse(f"submap {part.submap} is unknown, and the change doesn't start it")
        if anchor is None:
            raise refuse(f"submap {part.submap} has no anchor")
        vector_map = base
        if part.payload is not None:
            delta = protocol.decode(part.payload, base, robot=stream.robot)
            try:
                vector_map = apply(base, delta)
            except ValueError as error:
                raise refuse(str(error)) from None
        submaps[part.submap] = Submap(vector_map, anchor)
    if len(submaps) > MAX_SUBMAPS:
        raise refuse(f"more than {MAX_SUBMAPS} submaps")
    result = Stream(stream.robot, stream.epoch, seq, change.header or stream.header, submaps)
    if (result.digest ^ digest) & mask:
        raise refuse(f"the result has digest {result.digest:x}, not {digest:x}")
    return result


def _encode_map(old: VectorMap | None, new: VectorMap) -> tuple[MapHeader | None, bytes | None]:
    """A delta from the old map; or a snapshot, if most of that is new or the maps can't be compared."""
    header = MapHeader(new.lattice, new.epsilon_cells, new.profile)
    if old is not None and header == MapHeader(old.lattice, old.epsilon_cells, old.profile):
        delta = diff(old, new)
        if len(delta) == 0:
            return None, None
        payload = protocol.encode(delta, old)
        # An edge of a delta takes as much as one of a snapshot, or more.
        if len(delta.removed) + len(delta.added) < MOST_OF_SNAPSHOT * len(new) / 2:
            return None, payload
    else:
        payload = None
    empty = VectorMap.empty(new.lattice, epsilon_cells=header.epsilon_cells, profile=header.profile)
    whole = protocol.encode(diff(empty, new), empty)
    return (None, payload) if payload is not None and len(payload) <= MOST_OF_SNAPSHOT * len(whole) else (header, whole)


def _digest(stream: Stream) -> int:
    author = hash_text(stream.robot, SALT_AUTHOR)
    start = stream.header.start
    total = hash_ints(
        (stream.epoch, int(start is not None), *_pose_fields(start or FixedPose(0, 0))),
        hash_text(stream.header.level, author),
    )
    for robot, epoch in stream.header.forgets:
        total += hash_ints((epoch,), hash_text(robot, author ^ SALT_REVOKED))
    for name, submap in stream.submaps.items():
        vector_map = submap.vector_map
        frame = hash_ints((stream.epoch,), hash_text(name, author))
        epsilon = round(vector_map.epsilon_cells * EPSILON_PER_CELL)
        total += hash_ints(
            (vector_map.digest, epsilon, PROFILES.index(vector_map.profile), *_pose_fields(submap.anchor)), frame
        )
    return total & _MASK


def _pose_fields(pose: FixedPose) -> tuple[int, int, int, int]:
    return pose.x_um, pose.y_um, pose.cos_q30, pose.sin_q30
