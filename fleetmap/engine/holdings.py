"""All streams that a peer holds: its own, and the replicas of the others, bounded and revocable."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from fleetmap.codecs.messages import CLAIMED_EPOCHS
from fleetmap.engine.author import Author
from fleetmap.engine.catchup import Key
from fleetmap.engine.replica import Replica
from fleetmap.engine.stream import Stream
from fleetmap.model.hashing import hash_ints, hash_text

SALT_HELD = 18
OLDER_EPOCHS = 4
"""Streams kept of a robot's earlier lives."""
MAX_STREAMS = 1024


@dataclass(slots=True)
class Holdings:
    """The own stream and the replicas. An author's earlier epochs stay, as maps of an absent robot."""

    author: Author
    replicas: dict[Key, Replica] = field(default_factory=dict)

    @property
    def own(self) -> Stream:
        """What this robot has said."""
        return self.author.stream

    def streams(self) -> list[Stream]:
        """All streams that are held, the own one too, ascending by robot and epoch. Any thread may call it."""
        held = [self.own, *(r.stream for r in list(self.replicas.values()) if r.stream.seq > 0)]
        return sorted(held, key=lambda s: (s.robot, s.epoch))

    def held_hash(self) -> int:
        """One hash over the revisions of all streams that are held: peers with equal hashes hold the same."""
        total = sum(hash_ints((s.epoch, s.seq, s.digest), hash_text(s.robot, SALT_HELD)) for s in self.streams())
        return total & ((1 << 64) - 1)

    def held_seq(self, key: Key) -> int:
        """How far a replica is; 0 if there is none, or if it is suspect."""
        replica = self.replicas.get(key)
        return replica.stream.seq if replica and not replica.suspect else 0

    def keeps(self, key: Key) -> bool:
        """Whether there may be such a replica: not the own stream, not revoked, not too old, not one too many."""
        robot, epoch = key
        if key in self.replicas:
            return True
        newer = sum(name == robot and e > epoch for name, e in self.replicas)
        return (
            key != (self.own.robot, self.own.epoch)
            and epoch > self.revoked().get(robot, -1)
            and newer <= OLDER_EPOCHS
            and len(self.replicas) < MAX_STREAMS
        )

    def revoked(self) -> dict[str, int]:
        """Robot -> the highest of its epochs that some author revoked."""
        revoked: dict[str, int] = {}
        for stream in self.streams():
            for robot, epoch in stream.header.forgets:
                if epoch < CLAIMED_EPOCHS:
                    revoked[robot] = max(epoch, revoked.get(robot, -1))
        return revoked

    def drop_revoked(self) -> list[Stream]:
        """Drop the replicas that an author revoked; returns them as they were."""
        revoked = self.revoked()
        return self._drop(key for key in list(self.replicas) if key[1] <= revoked.get(key[0], -1))

    def drop_oldest(self, robot: str) -> list[Stream]:
        """Drop a robot's epochs beyond the newest and ``OLDER_EPOCHS`` more; returns them as they were."""
        epochs = sorted(epoch for name, epoch in self.replicas if name == robot)
        return self._drop((robot, epoch) for epoch in epochs[: -1 - OLDER_EPOCHS])

    def _drop(self, keys: Iterable[Key]) -> list[Stream]:
        return [self.replicas.pop(key).stream for key in keys]
