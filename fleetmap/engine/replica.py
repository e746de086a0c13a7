"""What a peer holds of one author's stream: always some revision that the author really had."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

from fleetmap.codecs.envelope import decode_change
from fleetmap.codecs.messages import CHECK_MASK, Record, Revision, SnapshotChunk
from fleetmap.engine.log import RecordLog
from fleetmap.engine.stream import Stream, advance
from fleetmap.model.errors import WireError

MAX_EARLY = 64
"""Records kept that arrived before the one that they follow."""


class Outcome(Enum):
    """What became of a record."""

    APPLIED = "applied"
    DUPLICATE = "duplicate"
    EARLY = "early"
    REFUSED = "refused"


@dataclass(slots=True)
class Replica:
    """A stream as far as it is known here, its last records, and records that came too early.

    ``suspect`` is set when a record didn't fit: the next question asks for everything.
    """

    stream: Stream
    log: RecordLog = field(default_factory=RecordLog)
    suspect: bool = False
    _early: dict[int, tuple[Record, bytes]] = field(default_factory=dict)
    _chunks: dict[int, bytes] = field(default_factory=dict)
    _chunks_of: Revision | None = None

    @property
    def held(self) -> Revision:
        """The revision to name when asking for more."""
        return Revision(self.stream.epoch, 0, 0) if self.suspect else self.stream.revision

    def offer(self, record: Record, raw: bytes) -> Outcome:
        """Apply a record if it is the next one, and whatever early ones follow it.

        The caller compares ``stream`` before and after; a refused record changes nothing.
        """
        seq = record.seq
        if seq <= self.stream.seq:
            self.suspect |= seq == self.stream.seq and record.check != self.stream.revision.check
            return Outcome.REFUSED if self.suspect else Outcome.DUPLICATE
        if seq > self.stream.seq + 1:
            if len(self._early) < MAX_EARLY:
                self._early[seq] = (record, raw)
            return Outcome.EARLY
        try:
            self._apply(record, raw)
        except WireError:
            self.suspect = True
            return Outcome.REFUSED
        self._apply_early()
        return Outcome.APPLIED

    def offer_chunk(self, chunk: SnapshotChunk) -> Outcome:
        """Collect the chunks of a snapshot; the last missing one puts it in the stream's place.

        Raises
        ------
        WireError : the whole is no snapshot, or hasn't the digest that its chunks state
        """
        if chunk.revision.seq < self.stream.seq or (chunk.revision == self.stream.revision and not self.suspect):
            return Outcome.DUPLICATE
        if chunk.revision != self._chunks_of:
            self._chunks_of, self._chunks = chunk.revision, {}
        self._chunks[chunk.index] = chunk.data
        if len(self._chunks) < chunk.count:
            return Outcome.EARLY
        data = b"".join(self._chunks[i] for i in sorted(self._chunks))
        self._chunks_of, self._chunks = None, {}
        robot, revision = self.stream.robot, chunk.revision
        change = decode_change(data, robot=robot)
        self.stream = advance(Stream(robot, revision.epoch), change, seq=revision.seq, digest=revision.digest)
        self.log.clear()
        self.suspect = False
        self._apply_early()
        return Outcome.APPLIED

    def _apply(self, record: Record, raw: bytes) -> None:
        base = self.stream.revision
        self.stream = advance(self.stream, record.change, seq=record.seq, digest=record.check, mask=CHECK_MASK)
        self.log.append(base, raw)
        self.suspect = False

    def _apply_early(self) -> None:
        for seq in sorted(self._early):
            if seq <= self.stream.seq:
                del self._early[seq]
            elif seq == self.stream.seq + 1:
                record, raw = self._early.pop(seq)
                try:
                    self._apply(record, raw)
                except WireError:
                    self.suspect = True
                    return
