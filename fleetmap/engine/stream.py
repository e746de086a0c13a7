"""All that an author says in one life, as one immutable value, its digest, and the steps between its revisions.

The digest is a sum mod 2^64 of one hash for each of these (``model.hashing`` has the hash; salts in brackets):

- each fact: (its value's bytes) [its key, salted with the author: robot and life]
- each submap: (digest of its vector map, epsilon in 1e-9 cells, profile number) [its name, salted with the author]

So equal edges in two frames hash differently, and a record that was meant for another robot can't fit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache

from fleetmap.codecs import protocol
from fleetmap.codecs.facts import (
    Facts,
    State,
    anchor_of,
    check_facts,
    forgotten_streams,
    level_of,
    named_lives,
    start_of,
    start_sigma_of,
    superseded_lives,
)
from fleetmap.codecs.messages import PROFILES, Change, MapHeader, Revision, SubmapChange
from fleetmap.model.delta import MapDelta, apply, diff
from fleetmap.model.density import MAX_EDGES, MAX_EDGES_IN_SQUARE, check_density
from fleetmap.model.errors import FleetmapError, WireError
from fleetmap.model.hashing import hash_bytes, hash_ints, hash_text
from fleetmap.model.pose import FixedPose
from fleetmap.model.vectormap import VectorMap

Key = tuple[str, int]
"""(robot, life) of a stream."""

SALT_AUTHOR, SALT_SUBMAP = 16, 17
EPSILON_PER_CELL = 10**9
MAX_SUBMAPS = 1024
MOST_OF_SNAPSHOT = 0.6
"""A delta that takes a larger share of a snapshot's bytes goes as one: it asks nothing of the receiver's base."""

_MASK = (1 << 64) - 1


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class Stream:
    """One revision of what an author says. ``seq`` 0 is the empty stream before its first record.

    Parameters
    ----------
    robot, life : whose
    seq : which revision
    facts : what is said beside edges
    submaps : name -> vector map
    link : what proves that the author has come to ``seq`` (``engine.chain``); not in the digest
    """

    robot: str
    life: int
    seq: int = 0
    facts: Facts = field(default_factory=Facts)
    submaps: Mapping[str, VectorMap] = field(default_factory=dict)
    link: int = 0
    digest: int = field(init=False)
    edges: int = field(init=False)
    """Number of edges in all submaps; a peer adds up those of a thousand streams at each word."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "edges", sum(map(len, self.submaps.values())))
        if self.seq == 0:
            object.__setattr__(self, "link", self.life)
        object.__setattr__(self, "digest", _digest(self))

    @property
    def key(self) -> Key:
        """(robot, life)."""
        return self.robot, self.life

    @property
    def revision(self) -> Revision:
        """(life, seq, digest)."""
        return Revision(self.life, self.seq, self.digest)

    @property
    def state(self) -> State:
        """(seq, link): what facts of others name it by."""
        return self.seq, self.link

    @property
    def level(self) -> str:
        """Of all its maps."""
        return level_of(self.facts)

    @property
    def start(self) -> FixedPose | None:
        """T_fleet_robot; None while it is unknown."""
        return start_of(self.facts)

    @property
    def start_sigma(self) -> tuple[int, int]:
        """How exact it is: standard deviations, micrometres and microradians."""
        return start_sigma_of(self.facts)

    def anchor(self, submap: str) -> FixedPose:
        """T_robot_submap."""
        return anchor_of(self.facts, submap)

    @property
    def names(self) -> frozenset[int]:
        """Former lives of its robot that its author holds."""
        return named_lives(self.facts)

    @property
    def supersedes(self) -> dict[int, State]:
        """Former lives of its robot that it replaces."""
        return superseded_lives(self.facts)

    @property
    def forgets(self) -> dict[Key, State]:
        """Streams that an operator forgot at every peer."""
        return forgotten_streams(self.facts)


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """From one revision of a stream to a later one: found or decoded once, and handed on to whoever listens.

    Parameters
    ----------
    before, after : the revisions
    deltas : by submap, against its map in ``before``, or against the empty map where it is in ``restarted``
    restarted : submaps that are new, or begin anew on another lattice
    """

    before: Stream
    after: Stream
    deltas: Mapping[str, MapDelta]
    restarted: frozenset[str] = frozenset()


def change_between(old: Stream, new: Stream) -> tuple[Change, Step]:
    """The change that makes ``new`` of ``old``, and the step; from the stream with seq 0 it is a snapshot."""
    submaps, deltas, restarted = [], {}, set()
    for name, vector_map in sorted(new.submaps.items()):
        before = old.submaps.get(name)
        if before is vector_map:
            continue
        map_header, payload, delta = _encode_map(before, vector_map)
        if payload is None:
            continue
        submaps.append(SubmapChange(name, map_header, payload))
        deltas[name] = delta
        if before is None or before.lattice != vector_map.lattice:
            restarted.add(name)
    return Change(old.facts.step_to(new.facts), tuple(submaps)), Step(old, new, deltas, frozenset(restarted))


def step_between(old: Stream, new: Stream) -> Step:
    """The step from one revision to any other, by comparing their maps."""
    deltas, restarted = {}, set()
    for name, vector_map in new.submaps.items():
        before = old.submaps.get(name)
        if before is None or before.lattice != vector_map.lattice:
            before = VectorMap.empty(vector_map.lattice)
            restarted.add(name)
        delta = diff(before, vector_map)
        if len(delta):
            deltas[name] = delta
    return Step(old, new, deltas, frozenset(restarted))


@dataclass(frozen=True, slots=True)
class Limits:
    """What one stream may hold: by default far more than honest maps (``model.density``).

    Parameters
    ----------
    edges : in all submaps
    edges_in_square : in any square of 256 cells of a submap's lattice
    """

    edges: int = MAX_EDGES
    edges_in_square: int = MAX_EDGES_IN_SQUARE


def advance(
    stream: Stream, change: Change, *, seq: int, link: int, digest: int, limits: Limits, mask: int = -1
) -> Step:
    """The step to ``seq``, by the change that leads there.

    Raises
    ------
    WireError : the change doesn't fit this stream, the result is beyond the limits, or it hasn't that digest, in the
        bits of ``mask``
    """

    def refuse(reason: str) -> WireError:
        size_bytes = sum(len(s.payload) for s in change.submaps)
        return WireError(robot=stream.robot, size_bytes=size_bytes, reason=reason)

    facts = stream.facts.after(change.facts)
    if facts is not stream.facts:
        try:
            check_facts(facts)
        except (ValueError, FleetmapError) as error:
            raise refuse(str(error)) from None
    submaps, deltas, restarted = dict(stream.submaps), {}, set()
    if len(submaps.keys() | {part.submap for part in change.submaps}) > MAX_SUBMAPS:
        raise refuse(f"more than {MAX_SUBMAPS} submaps")
    room = limits.edges - stream.edges
    for part in change.submaps:
        before = submaps.get(part.submap)
        if part.map_header is not None:
            h = part.map_header
            base = VectorMap.empty(h.lattice, epsilon_cells=h.epsilon_cells, profile=h.profile)
        elif before is not None:
            base = before
        else:
            raise refuse(f"submap {part.submap} is unknown, and the change doesn't start it")
        delta = protocol.decode(part.payload, base, robot=stream.robot)
        try:
            vector_map = apply(base, delta)
        except ValueError as error:
            raise refuse(str(error)) from None
        # Here and not at the end: a record of many submaps must not be decoded whole before it is refused.
        room -= len(vector_map) - (len(before) if before is not None else 0)
        reason = check_density(vector_map, max_edges=room + len(vector_map), max_edges_in_square=limits.edges_in_square)
        if reason is not None:
            raise refuse(reason)
        submaps[part.submap] = vector_map
        deltas[part.submap] = delta
        if before is None or before.lattice != vector_map.lattice:
            restarted.add(part.submap)
    result = Stream(stream.robot, stream.life, seq, facts, submaps, link)
    if (result.digest ^ digest) & mask:
        # Without the digests: refusals are counted by their reason.
        raise refuse("the result has another digest than is stated")
    return Step(stream, result, deltas, frozenset(restarted))


def _encode_map(old: VectorMap | None, new: VectorMap) -> tuple[MapHeader | None, bytes | None, MapDelta]:
    """A delta from the old map; or a snapshot, if most of that is new or the maps can't be compared."""
    header = MapHeader(new.lattice, new.epsilon_cells, new.profile)
    delta = payload = None
    if old is not None and header == MapHeader(old.lattice, old.epsilon_cells, old.profile):
        delta = diff(old, new)
        if len(delta) == 0:
            return None, None, delta
        payload = protocol.encode(delta, old)
        # An edge of a delta takes as much as one of a snapshot, or more.
        if len(delta.removed) + len(delta.added) < MOST_OF_SNAPSHOT * len(new) / 2:
            return None, payload, delta
    empty = VectorMap.empty(new.lattice, epsilon_cells=header.epsilon_cells, profile=header.profile)
    whole_delta = diff(empty, new)
    whole = protocol.encode(whole_delta, empty)
    if delta is None or payload is None:
        # Where only the error bound or the profile changed, edges can be compared.
        same_lattice = old is not None and old.lattice == new.lattice
        return header, whole, diff(old, new) if same_lattice and old is not None else whole_delta
    return (None, payload, delta) if len(payload) <= MOST_OF_SNAPSHOT * len(whole) else (header, whole, delta)


def _digest(stream: Stream) -> int:
    author = _author_salt(stream.robot, stream.life)
    total = sum(_fact_hash(author, key, value) for key, value in stream.facts.items())
    for name, vector_map in stream.submaps.items():
        epsilon = round(vector_map.epsilon_cells * EPSILON_PER_CELL)
        profile = PROFILES.index(vector_map.profile)
        total += hash_ints((vector_map.digest, epsilon, profile), _submap_salt(author, name))
    return total & _MASK


@lru_cache(4096)
def _author_salt(robot: str, life: int) -> int:
    return hash_ints((life,), hash_text(robot, SALT_AUTHOR))


@lru_cache(4096)
def _submap_salt(author: int, name: str) -> int:
    return hash_text(name, author ^ SALT_SUBMAP)


@lru_cache(8192)
def _fact_hash(author: int, key: bytes, value: bytes) -> int:
    return hash_bytes(value, hash_bytes(key, author))
