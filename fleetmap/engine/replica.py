"""What a peer holds of one author's stream: always some revision that the author has come to.

Who has said it matters. What the author said is replaced by the author alone; what came from a mirror, while the
author couldn't be heard, may be replaced by what more robots hold.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from enum import Enum

from fleetmap.codecs.envelope import decode_change
from fleetmap.codecs.messages import CHECK_MASK, Record, Revision, SnapshotChunk, Want
from fleetmap.engine.chain import before
from fleetmap.engine.log import RecordLog
from fleetmap.engine.stream import Key, Limits, Step, Stream, advance, step_between
from fleetmap.model.errors import WireError

MAX_EARLY = 64
"""Records kept that arrived before the one that they follow."""


MAX_PARTS = 8
"""Peers of whose snapshots parts are kept: each by itself, as one that lies would spoil those of the others."""


@dataclass(slots=True)
class Parts:
    """Chunks of a snapshot of one peer's.

    Parameters
    ----------
    of : one of them
    data : by index
    """

    of: SnapshotChunk
    data: dict[int, bytes] = field(default_factory=dict)

    def continues(self, chunk: SnapshotChunk) -> bool:
        """Whether a chunk is one of the same snapshot."""
        of = self.of
        return (of.seq, of.digest, of.link, of.count) == (chunk.seq, chunk.digest, chunk.link, chunk.count)


class Outcome(Enum):
    """What became of a record or of a part of a snapshot."""

    APPLIED = "applied"
    DUPLICATE = "duplicate"
    EARLY = "early"
    """It was kept, or is too far ahead to be kept: something before it is missing."""
    FORKED = "forked"
    """The author's life has said other bytes under this seq."""


@dataclass(slots=True)
class Replica:
    """A stream as far as it is known here, its last records, and what came too early.

    Attributes
    ----------
    heard : the author itself has said this revision
    outvoted : it was replaced by what more mirrors hold
    forked : the author has said two things under this seq; its next word decides
    been : the last few (``Holdings.changes``, revision) that it has come to
    kept : it counts: it is listed, hashed, mirrored and merged. One that is superseded doesn't, and goes on if its
        author does
    """

    stream: Stream
    heard: bool = False
    outvoted: bool = False
    forked: bool = False
    kept: bool = True
    been: deque[tuple[int, Revision]] = field(default_factory=lambda: deque(maxlen=8))
    log: RecordLog = field(default_factory=RecordLog)
    steps: list[Step] = field(default_factory=list)
    _corrected: int = 0
    _early: dict[int, tuple[Record, bytes]] = field(default_factory=dict)
    _parts: dict[Key, Parts] = field(default_factory=dict)

    @property
    def key(self) -> Key:
        """(robot, life)."""
        return self.stream.key

    @property
    def corrected(self) -> bool:
        """Whether the author has already set right what was held under this seq: the next word decides now."""
        return self._corrected == self.stream.seq

    @property
    def waiting_bytes(self) -> int:
        """What early records and parts of a snapshot take."""
        early = sum(len(raw) for _, raw in self._early.values())
        return early + sum(len(data) for parts in self._parts.values() for data in parts.data.values())

    def forget_waiting(self) -> None:
        """Give early records and parts of snapshots up, for want of room."""
        self._early.clear()
        self._parts.clear()

    def as_of(self, changes: int) -> Revision | None:
        """The revision that was held after so many changes; None if that was long ago, or nothing."""
        return next((revision for change, revision in reversed(list(self.been)) if change <= changes), None)

    def take_steps(self) -> list[Step]:
        """The steps since the last call."""
        steps, self.steps = self.steps, []
        return steps

    def want(self, peer: Key) -> Want:
        """What to ask a peer for."""
        parts, partial = self._parts.get(peer), None
        if parts is not None:
            of = parts.of
            first_missing = next((i for i in range(of.count) if i not in parts.data), of.count)
            partial = (of.seq, of.digest, first_missing) if first_missing else None
        return Want(self.stream.robot, self.stream.revision, partial)

    def is_next(self, seq: int, link: int) -> bool:
        """Whether a record of this seq and link can only come from whoever has the author's word, and is of use."""
        held = self.stream
        return held.seq < seq <= held.seq + MAX_EARLY and before(link, seq, seq - held.seq) == held.link

    def offer(self, record: Record, raw: bytes, limits: Limits, *, by_author: bool) -> Outcome:
        """Apply a record if it is the next one, and whatever early ones follow it.

        Raises
        ------
        WireError : its link isn't that of this life, or it doesn't fit; nothing is changed
        """
        held, seq = self.stream, record.seq
        if seq <= held.seq:
            if seq == held.seq and record.link == held.link:
                if record.check != held.revision.check:
                    self.forked |= by_author and self.heard
                    return Outcome.FORKED
                self.heard |= by_author
            return Outcome.DUPLICATE
        if seq > held.seq + MAX_EARLY:
            return Outcome.EARLY
        self._check_link(seq, record.link, len(raw))
        if seq > held.seq + 1:
            if by_author:
                self._early[seq] = (record, raw)
            return Outcome.EARLY
        self._apply(record, raw, limits, heard=by_author)
        self._apply_early(limits)
        return Outcome.APPLIED

    def offer_chunk(
        self, chunk: SnapshotChunk, limits: Limits, *, speaker: Key, instead: Revision | None = None
    ) -> Outcome:
        """Collect the chunks of a peer's snapshot; the last missing one puts it in the stream's place.

        Parameters
        ----------
        speaker : whose. If it is the author, its word counts for more
        instead : what most say of an absent author; it may replace what wasn't heard from it

        Raises
        ------
        WireError : the link isn't that of this life, or the whole is no snapshot, or hasn't the digest that its chunks
            state
        """
        held, there = self.stream, Revision(self.stream.life, chunk.seq, chunk.digest)
        by_author = speaker == self.key
        if chunk.seq == held.seq and chunk.digest != held.digest:
            corrects = by_author and not self.corrected
            outvotes = not by_author and not self.heard and there == instead
            if not corrects and not outvotes:
                self.forked |= by_author and self.heard
                return Outcome.FORKED if by_author else Outcome.DUPLICATE
        elif chunk.seq <= held.seq:
            self.heard |= by_author and there == held.revision
            return Outcome.DUPLICATE
        parts = self._parts.get(speaker)
        if parts is None or not parts.continues(chunk):
            # Before anything is kept; and from the end that is known, whichever is nearer.
            self._check_link(chunk.seq, chunk.link, len(chunk.data))
            self._parts.pop(speaker, None)
            if len(self._parts) == MAX_PARTS:
                del self._parts[next(iter(self._parts))]
            parts = self._parts[speaker] = Parts(chunk)
        elif chunk.index in parts.data:
            return Outcome.DUPLICATE
        parts.data[chunk.index] = chunk.data
        if len(parts.data) < chunk.count:
            return Outcome.EARLY
        del self._parts[speaker]
        data = b"".join(parts.data[i] for i in sorted(parts.data))
        change = decode_change(data, robot=held.robot)
        nothing = Stream(*held.key)
        step = advance(nothing, change, seq=chunk.seq, link=chunk.link, digest=chunk.digest, limits=limits)
        if by_author and chunk.seq == held.seq:
            self._corrected = chunk.seq
        self.outvoted |= not by_author and chunk.seq == held.seq
        self._take(step_between(held, step.after), heard=by_author)
        self.log.clear()
        self._apply_early(limits)
        return Outcome.APPLIED

    def _check_link(self, seq: int, link: int, size_bytes: int) -> None:
        held = self.stream
        known, at = (held.link, held.seq) if seq >= held.seq else (held.life, 0)
        if before(link, seq, seq - at) != known:
            raise WireError(robot=held.robot, size_bytes=size_bytes, reason="claimed: the author's life isn't there")

    def _apply(self, record: Record, raw: bytes, limits: Limits, *, heard: bool) -> None:
        base = self.stream
        step = advance(
            base, record.change, seq=record.seq, link=record.link, digest=record.check, limits=limits, mask=CHECK_MASK
        )
        self._take(step, heard=heard)
        self.log.append(base.revision, raw)

    def _take(self, step: Step, *, heard: bool) -> None:
        if step.after.seq > step.before.seq:
            self.forked = False
        self.stream, self.heard = step.after, heard
        self._parts = {peer: parts for peer, parts in self._parts.items() if parts.of.seq > self.stream.seq}
        self.steps.append(step)

    def _apply_early(self, limits: Limits) -> None:
        for seq in sorted(self._early):
            if seq <= self.stream.seq:
                del self._early[seq]
            elif seq == self.stream.seq + 1:
                record, raw = self._early.pop(seq)
                try:
                    self._apply(record, raw, limits, heard=True)
                except WireError:
                    self._early.clear()
                    return
