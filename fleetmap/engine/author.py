"""What this robot says: its own stream, one revision after the other, and the records between them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from fleetmap.codecs.messages import MAX_CHUNK_BYTES, Header
from fleetmap.engine.log import RecordLog, record_message, snapshot_messages
from fleetmap.engine.stream import Stream, Submap


@dataclass(slots=True)
class Author:
    """The own stream and the log of its last records."""

    stream: Stream
    log: RecordLog = field(default_factory=RecordLog)

    def commit(self, *, header: Header | None = None, submaps: Mapping[str, Submap] | None = None) -> bytes | None:
        """Take the next step; returns its record, or None if it would change nothing.

        Raises
        ------
        ConfigError : the whole stream grew beyond what a snapshot may hold; it stays as it was
        """
        old = self.stream
        new = Stream(
            old.robot,
            old.epoch,
            old.seq + 1,
            old.header if header is None else header,
            old.submaps if submaps is None else submaps,
        )
        if old.seq > 0 and new.header == old.header and new.digest == old.digest:
            return None
        record = record_message(old, new)
        if len(record) > MAX_CHUNK_BYTES:
            snapshot_messages(new)  # refuses what no peer could catch up with
        self.stream = new
        self.log.append(old.revision, record)
        return record

    def restart(self, epoch: int) -> bytes | None:
        """Say the same under a new epoch, and revoke the earlier ones; returns the record.

        Two lives may have used one epoch without knowing of each other, and no peer could tell those apart.
        """
        old = self.stream
        self.log.clear()
        self.stream = Stream(old.robot, epoch)
        return self.commit(header=revoking(old.header, old.robot, epoch - 1), submaps=old.submaps)


def revoking(header: Header, robot: str, epoch: int) -> Header:
    """The same header, revoking also a robot's streams up to an epoch."""
    return replace(header, forgets=tuple(sorted({**dict(header.forgets), robot: epoch}.items())))
