"""All streams that a peer holds: its own, and the replicas of the others, bounded."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field

from fleetmap.codecs.facts import State
from fleetmap.codecs.messages import Revision
from fleetmap.engine.author import Author
from fleetmap.engine.lives import all_named, kept_lives
from fleetmap.engine.ranges import Index, revision_hash
from fleetmap.engine.replica import Replica
from fleetmap.engine.stream import Key, Stream

MAX_STREAMS = 1024
MAX_EDGES_HELD = 4 << 20
"""Of all replicas together; 100 MB."""
MAX_WAITING_BYTES = 8 << 20
"""Early records and parts of snapshots, of all streams together."""
MAX_DROPPED = 4096

SPARED_S = 5.0
"""So long what somebody who is there has said stays merged when others forget or supersede it. It says its next
revision within a second, and what was said of the former one is void: to forget each of them achieves nothing."""

_MASK = (1 << 64) - 1
_Share = tuple[int, int, int]


@dataclass(slots=True)
class Holdings:
    """The own stream and the replicas. Lives of a robot that lives no more stay, as maps of an absent one.

    Parameters
    ----------
    author : of the own stream
    most_edges_of_a_name : of all lives of one name together; beyond it absent ones go, the smallest first

    Attributes
    ----------
    hidden : streams that the user has this peer forget, as they were then
    undecided : robots of whose lives one may have to go, once all of it has come, or it has had time to speak
    changes : how many there were of what is kept; a neighbour that agrees does so as of one of them
    now_s : set by whoever has a clock
    """

    author: Author
    most_edges_of_a_name: int = MAX_EDGES_HELD
    replicas: dict[Key, Replica] = field(default_factory=dict)
    hidden: dict[Key, State] = field(default_factory=dict)
    undecided: set[str] = field(default_factory=set)
    changes: int = 0
    now_s: float = 0.0
    _doubted: dict[Key, tuple[State, float]] = field(default_factory=dict)
    """Forgotten streams of authors who are there: in which state, since when."""
    _ended: dict[Key, tuple[State, float]] = field(default_factory=dict)
    """Superseded ones likewise."""
    _dropped: OrderedDict[Key, Revision] = field(default_factory=OrderedDict)
    """Not asked for again as they were: whoever still offers them has not heard yet why they go."""
    _crowded: OrderedDict[Key, Revision] = field(default_factory=OrderedDict)
    """Dropped for want of room."""
    _by_robot: dict[str, set[Key]] = field(default_factory=dict)
    _touched: set[Key] = field(default_factory=set)
    """Replicas that may have changed since the sums were right."""
    _summed: dict[Key, _Share] = field(default_factory=dict)
    _sum: _Share = (0, 0, 0)
    """What ``_summed`` has by key: hashes over what is kept, edges, and bytes that wait."""
    _forgets: tuple[tuple[int, int], bool] | None = None
    _indexed: tuple[int, Index] | None = None
    """The last index, and the hash over what is in it."""

    @property
    def own(self) -> Stream:
        """What this robot has said."""
        return self.author.stream

    def streams(self) -> list[Stream]:
        """All streams that are kept, the own one too, ascending by robot and life. Any thread may call it."""
        kept = [r.stream for r in list(self.replicas.values()) if r.kept and r.stream.seq > 0]
        return sorted([self.own, *kept], key=lambda s: s.key)

    def held_hash(self) -> int:
        """One hash over the revisions of all streams that are kept: peers with equal hashes hold the same.

        In time proportional to what was touched since the last call: each heartbeat that comes asks for it.
        """
        return (self._sums()[0] + revision_hash(self.own.robot, self.own.revision)) & _MASK

    def _sums(self) -> _Share:
        """Of all replicas: hashes over what is kept, edges, and bytes that wait; brought up to date by what changed."""
        for key in self._touched:
            replica, was = self.replicas.get(key), self._summed.pop(key, (0, 0, 0))
            now = (0, 0, 0) if replica is None else _share(replica)
            self._sum = (self._sum[0] + now[0] - was[0], self._sum[1] + now[1] - was[1], self._sum[2] + now[2] - was[2])
            if any(now):
                self._summed[key] = now
        self._touched.clear()
        return self._sum

    def index(self) -> Index:
        """All streams that are kept, by place."""
        held = self.held_hash()
        if self._indexed is None or self._indexed[0] != held:
            self._indexed = held, Index((s.robot, s.revision) for s in self.streams())
        return self._indexed[1]

    def moved(self, key: Key) -> None:
        """A replica has come to another revision."""
        self.changes += 1
        replica = self.replicas.get(key)
        if replica is not None:
            replica.been.append((self.changes, replica.stream.revision))

    def to_change(self, key: Key) -> Replica:
        """The replica of a stream, for who is about to change it; a new one, not held yet, if there is none."""
        self._touched.add(key)
        return self.replicas.get(key) or Replica(Stream(*key))

    def hold(self, replica: Replica) -> None:
        """Have a replica from now on."""
        self.replicas[replica.key] = replica
        self._by_robot.setdefault(replica.key[0], set()).add(replica.key)
        self._touched.add(replica.key)

    def held(self, key: Key) -> Stream:
        """A replica's stream; with seq 0 if there is none."""
        replica = self.replicas.get(key)
        return replica.stream if replica is not None else Stream(*key)

    def revision(self, key: Key) -> Revision:
        """A replica's revision; with seq 0 if there is none."""
        replica = self.replicas.get(key)
        return replica.stream.revision if replica is not None else Revision(key[1], 0, 0)

    def was_dropped(self, key: Key, revision: Revision) -> bool:
        """Whether this very revision was dropped, and isn't wanted back: not before there is room, if that was why."""
        full = len(self.replicas) >= MAX_STREAMS or self._sums()[1] >= MAX_EDGES_HELD // 2
        dropped = [self._dropped.get(key), self._crowded.get(key) if full else None]
        # A heartbeat says no digest.
        return any(was and was.seq == revision.seq and revision.digest in (0, was.digest) for was in dropped)

    def left_out(self, present: Callable[[Key], bool]) -> set[Key]:
        """Streams that are kept and not merged: the user, or an operator anywhere, has them forgotten as they are.

        Parameters
        ----------
        present : whether an author is there. Then it has ``SPARED_S`` to say that it lives
        """
        if not self.hidden and not self._forgetting():
            self._doubted = {}
            return set()
        streams = {s.key: s for s in self.streams()}
        here = {key for key, state in list(self.hidden.items()) if key in streams and streams[key].state == state}
        said = [item for key, s in streams.items() if key not in here for item in s.forgets.items()]
        there = {key for key, state in said if key in streams and streams[key].state == state} - here
        doubted = {key: self._since(self._doubted, streams[key]) for key in there if present(key)}
        self._doubted = doubted
        return here | {key for key in there if key not in doubted or self._is_over(doubted[key])}

    def _forgetting(self) -> bool:
        """Whether any stream has others forgotten; looked for anew when something changed. Any thread may call it."""
        now = self.changes, self.own.seq
        known = self._forgets
        if known is None or known[0] != now:
            known = self._forgets = now, any(s.forgets for s in self.streams())
        return known[1]

    def _since(self, doubts: dict[Key, tuple[State, float]], stream: Stream) -> tuple[State, float]:
        known = doubts.get(stream.key)
        return known if known is not None and known[0] == stream.state else (stream.state, self.now_s)

    def _is_over(self, doubt: tuple[State, float]) -> bool:
        return self.now_s >= doubt[1] + SPARED_S

    def settle(self, robot: str, lives: Callable[[int], bool], behind: Callable[[Key], bool]) -> list[Stream]:
        """Drop the lives of a robot that need not be kept; returns them as they were.

        Parameters
        ----------
        lives : whether a life's token is there. A superseded one that lives is held on to: it may go
            on, and is kept for ``SPARED_S``
        behind : whether more of a stream is known to be on its way. What it is worth is not known before
        """
        replicas = [r for r in self._of(robot) if r.stream.seq > 0]
        own = [self.own] if robot == self.own.robot else []
        kept = kept_lives([*own, *(r.stream for r in replicas)])
        gone = []
        self.undecided.discard(robot)
        ended = self._ended
        self._ended = {key: doubt for key, doubt in ended.items() if key[0] != robot}
        for replica in replicas:
            was, replica.kept = replica.kept, replica.stream.life in kept
            self._touched.add(replica.key)
            self.changes += was != replica.kept
            if not replica.kept and lives(replica.stream.life):
                self._ended[replica.key] = self._since(ended, replica.stream)
            spared = replica.key in self._ended and not self._is_over(self._ended[replica.key])
            if not replica.kept and (spared or behind(replica.key)):
                replica.kept = True
                self._touched.add(replica.key)  # again: what was asked meanwhile may have looked
                self.undecided.add(robot)
            elif not replica.kept and not lives(replica.stream.life):
                gone.append(self.drop(replica.key))
            elif was and not replica.kept:
                gone.append(replica.stream)
        held = [r.stream for r in replicas if r.key in self.replicas]
        edges = sum(stream.edges for stream in held)
        for least in sorted((s for s in held if not lives(s.life)), key=lambda s: (s.edges, s.life)):
            if edges > self.most_edges_of_a_name:
                edges -= least.edges
                gone.append(self.drop(least.key))
        return gone

    def find_room(self, present: Callable[[Key], bool], *, newcomer: Key | None = None) -> list[Stream]:
        """Drop streams of absent authors, fewest edges first, until the rest has room; returns them as they were.

        If all authors are there, the newcomer goes: holding a replica of somebody vouches for nothing.
        """
        gone: list[Stream] = []
        replicas = self.replicas
        edges = self._sums()[1]
        while len(replicas) > MAX_STREAMS or edges > MAX_EDGES_HELD:
            absent = [r.stream for key, r in replicas.items() if not present(key)]
            if absent:
                least = min(absent, key=lambda s: (s.edges, s.life, s.robot)).key
            elif newcomer in replicas:
                least = newcomer
            else:
                break
            gone.append(self.drop(least, crowded=True))
            edges -= gone[-1].edges
        return gone

    def drop(self, key: Key, *, crowded: bool = False) -> Stream:
        """Hold a replica no longer, for good or for want of room; returns it as it was."""
        stream = self.replicas.pop(key).stream
        self._by_robot[key[0]].discard(key)
        if not self._by_robot[key[0]]:
            del self._by_robot[key[0]]
        self.changes += 1
        self._touched.add(key)
        dropped = self._crowded if crowded else self._dropped
        dropped[key] = stream.revision
        dropped.move_to_end(key)
        if len(dropped) > MAX_DROPPED:
            dropped.popitem(last=False)
        return stream

    def bound_waiting(self) -> int:
        """Give up early records and parts of snapshots where they take too much; returns how many streams lost some."""
        lost = 0
        while self._sums()[2] > MAX_WAITING_BYTES:
            most = max(self._summed, key=lambda key: (self._summed[key][2], key))
            self.replicas[most].forget_waiting()
            self._touched.add(most)
            lost += 1
        return lost

    def _of(self, robot: str) -> list[Replica]:
        """Replicas of all lives of a robot, ascending."""
        return [self.replicas[key] for key in sorted(self._by_robot.get(robot, ()))]

    def names(self, lives: Callable[[int], bool]) -> set[int]:
        """The former lives of the own name that the own stream should name: ``lives`` says which go on beside it."""
        former = [r.stream for r in self._of(self.own.robot) if not lives(r.key[1])]
        return {life for life in all_named(self.own, [s for s in former if s.seq > 0]) if not lives(life)}


def _share(replica: Replica) -> _Share:
    counts = replica.kept and replica.stream.seq > 0
    hashed = revision_hash(replica.key[0], replica.stream.revision) if counts else 0
    return hashed, replica.stream.edges, replica.waiting_bytes
