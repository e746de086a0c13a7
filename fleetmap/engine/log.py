"""The last records of a stream, and the answer to a peer that asks for what it lacks."""

from __future__ import annotations

from collections import OrderedDict, deque

from fleetmap.codecs.envelope import encode, encode_change
from fleetmap.codecs.messages import MAX_CHUNK_BYTES, MAX_CHUNKS, Record, Revision, SnapshotChunk, Want
from fleetmap.engine.stream import Key, Step, Stream, change_between
from fleetmap.model.errors import ConfigError

MAX_LOG_BYTES = 1 << 20
MAX_LOG_RECORDS = 512
"""Bounds of one stream's log; a peer that is farther behind gets a snapshot."""
MAX_ANSWER_BYTES = 32 << 10
"""The answer to one question: who lacks more asks again, so that no answer clogs a slow link."""
MAX_SNAPSHOTS_BYTES = 8 << 20
"""Encoded snapshots that are remembered, of all streams."""


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


class Snapshots:
    """Encoded snapshots by stream: each revision is encoded once, however many ask for it."""

    def __init__(self) -> None:
        self._known: OrderedDict[Key, tuple[Revision, list[bytes]]] = OrderedDict()
        self._size_bytes = 0

    def of(self, stream: Stream) -> list[bytes]:
        """The whole stream in chunks; ``ConfigError`` if it is larger than a snapshot may be."""
        known = self._known.get(stream.key)
        if known is not None and known[0] == stream.revision:
            self._known.move_to_end(stream.key)
            return known[1]
        chunks = snapshot_messages(stream)
        if known is not None:
            self._size_bytes -= sum(map(len, known[1]))
        self._known[stream.key] = (stream.revision, chunks)
        self._known.move_to_end(stream.key)
        self._size_bytes += sum(map(len, chunks))
        while self._size_bytes > MAX_SNAPSHOTS_BYTES and len(self._known) > 1:
            self._size_bytes -= sum(map(len, self._known.popitem(last=False)[1][1]))
        return chunks

    def rest(self, stream: Stream, log: RecordLog, partial: tuple[int, int, int]) -> list[bytes] | None:
        """The chunks of an earlier snapshot that are still missing, and the records since; None if they are gone."""
        seq, digest, chunks_held = partial
        known = self._known.get(stream.key)
        base = Revision(stream.life, seq, digest)
        if known is None or known[0] != base:
            return None
        records = [] if base == stream.revision else log.since(base)
        return None if records is None else known[1][chunks_held:] + records


def answer(stream: Stream, log: RecordLog, want: Want, snapshots: Snapshots) -> list[bytes]:
    """Messages that lead from what the asker holds towards ``stream``: missing records, or chunks of a snapshot."""
    held = want.revision
    if stream.seq == 0 or held == stream.revision or held.seq > stream.seq:
        return []
    records = log.since(held)
    # An edge of a snapshot takes about a byte: records are sent as long as they are no longer than that.
    if records is not None and sum(map(len, records)) <= max(2048, stream.edges):
        return _first(records)
    if want.partial is not None:
        rest = snapshots.rest(stream, log, want.partial)
        if rest is not None:
            return _first(rest)
    return _first(snapshots.of(stream))


def _first(messages: list[bytes]) -> list[bytes]:
    """As many as an answer may hold, and one in any case."""
    size_bytes, count = 0, 0
    for message in messages:
        size_bytes += len(message)
        if count and size_bytes > MAX_ANSWER_BYTES:
            break
        count += 1
    return messages[:count]


def snapshot_messages(stream: Stream) -> list[bytes]:
    """The whole stream, as a change from nothing, in chunks.

    Raises
    ------
    ConfigError : the stream is larger than a snapshot may be
    """
    data = encode_change(change_between(Stream(stream.robot, stream.life), stream)[0])
    count = max(1, -(-len(data) // MAX_CHUNK_BYTES))
    if count > MAX_CHUNKS:
        raise ConfigError(
            option="publish",
            value=f"{len(data)} B",
            reason=f"a robot's map may take {MAX_CHUNKS * MAX_CHUNK_BYTES} B; split it among robots, or coarsen it",
        )
    seq, digest, size = stream.seq, stream.digest, MAX_CHUNK_BYTES
    return [
        encode(SnapshotChunk(seq, digest, stream.link, i, count, data[i * size : (i + 1) * size])) for i in range(count)
    ]


def record_message(old: Stream, new: Stream) -> tuple[bytes, Step]:
    """The record that leads from one revision to the next, and the step."""
    change, step = change_between(old, new)
    return encode(Record(new.seq, new.link, new.revision.check, change)), step
