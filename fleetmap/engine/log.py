"""The last records of a stream, and the answer to a peer that asks for what it lacks."""

from __future__ import annotations

from collections import deque

from fleetmap.codecs.envelope import encode, encode_change
from fleetmap.codecs.messages import MAX_CHUNK_BYTES, MAX_CHUNKS, Record, Revision, SnapshotChunk
from fleetmap.engine.stream import Stream, change_between
from fleetmap.model.errors import ConfigError

MAX_LOG_BYTES = 1 << 20
MAX_LOG_RECORDS = 512
"""Bounds of one stream's log; a peer that is farther behind gets a snapshot."""


class RecordLog:
    """Encoded records in sequence, with the revision that each one starts from."""

    def __init__(self) -> None:
        self._entries: deque[tuple[Revision, bytes]] = deque()
        self._size_bytes = 0

    def append(self, base: Revision, record: bytes) -> None:
        """Note the record that follows ``base``; the oldest ones fall out."""
        if self._entries and self._entries[-1][0].seq + 1 != base.seq:
            self.clear()
        self._entries.append((base, record))
        self._size_bytes += len(record)
        while self._size_bytes > MAX_LOG_BYTES or len(self._entries) > MAX_LOG_RECORDS:
            self._size_bytes -= len(self._entries.popleft()[1])

    def clear(self) -> None:
        """Forget all records: the stream was replaced by a snapshot."""
        self._entries.clear()
        self._size_bytes = 0

    def since(self, revision: Revision) -> list[bytes] | None:
        """The records after ``revision``; None if the log doesn't reach back to it."""
        for i, (base, _) in enumerate(self._entries):
            if base == revision:
                return [record for _, record in list(self._entries)[i:]]
        return None


def answer(stream: Stream, log: RecordLog, held: Revision) -> list[bytes]:
    """Messages that lead from what the asker holds to ``stream``: missing records, or a snapshot in chunks."""
    if stream.seq == 0 or held == stream.revision:
        return []
    records = log.since(held)
    # An edge of a snapshot takes about a byte: records are sent as long as they are no longer than that.
    if records is not None and sum(map(len, records)) <= max(2048, stream.edges):
        return records
    return snapshot_messages(stream)


def snapshot_messages(stream: Stream) -> list[bytes]:
    """The whole stream, as a change from nothing, in chunks.

    Raises
    ------
    ConfigError : the stream is larger than a snapshot may be
    """
    data = encode_change(change_between(Stream(stream.robot, stream.epoch), stream))
    count = max(1, -(-len(data) // MAX_CHUNK_BYTES))
    if count > MAX_CHUNKS:
        raise ConfigError(
            option="publish",
            value=f"{len(data)} B",
            reason=f"a robot's map may take {MAX_CHUNKS * MAX_CHUNK_BYTES} B; split it among robots, or coarsen it",
        )
    return [
        encode(SnapshotChunk(stream.revision, i, count, data[i * MAX_CHUNK_BYTES : (i + 1) * MAX_CHUNK_BYTES]))
        for i in range(count)
    ]


def record_message(old: Stream, new: Stream) -> bytes:
    """The record that leads from one revision to the next."""
    return encode(Record(new.epoch, new.seq, new.revision.check, change_between(old, new)))
