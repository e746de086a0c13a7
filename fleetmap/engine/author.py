"""What this robot says: its own stream, one revision after the other, and the records between them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from fleetmap.codecs.facts import FactsStep, check_facts, supersede
from fleetmap.codecs.messages import MAX_CHUNK_BYTES
from fleetmap.engine.chain import Chain
from fleetmap.engine.log import RecordLog, record_message, snapshot_messages
from fleetmap.engine.stream import Step, Stream
from fleetmap.model.errors import ConfigError
from fleetmap.model.vectormap import VectorMap


class Author:
    """The own stream and the log of its last records.

    Parameters
    ----------
    robot : own name
    chain : the links of the own life
    """

    def __init__(self, robot: str, chain: Chain) -> None:
        self.chain = chain
        self.stream = Stream(robot, chain.life)
        self.log = RecordLog()

    def commit(
        self,
        *,
        facts: FactsStep | None = None,
        submaps: Mapping[str, VectorMap] | None = None,
        even_if_nothing: bool = False,
    ) -> tuple[bytes, Step] | None:
        """Take the next step; returns its record and the step, or None if it would change nothing.

        Raises
        ------
        ConfigError : the whole stream, or its facts, grew beyond what peers take; it stays as it was
        """
        if self.stream.seq == self.chain.revisions:
            return self._renew(facts or {}, self.stream.submaps if submaps is None else submaps)
        old = self.stream
        new = Stream(
            old.robot,
            old.life,
            old.seq + 1,
            old.facts.after(facts or {}),
            old.submaps if submaps is None else submaps,
            self.chain.link(old.seq + 1),
        )
        if old.seq > 0 and new.digest == old.digest and not even_if_nothing:
            return None
        return self._say(old, new)

    def skip_to(self, seq: int) -> None:
        """Go on behind a revision that this life has said and this process doesn't know of."""
        if seq > self.stream.seq:
            self.stream = replace(self.stream, seq=seq, link=self.chain.link(seq))
            self.log.clear()

    def _renew(self, facts: FactsStep, submaps: Mapping[str, VectorMap]) -> tuple[bytes, Step]:
        """Say all again in a new life, which supersedes this one: its chain has no link left."""
        old = self.stream
        chain = Chain(self.chain.next_seed(), revisions=self.chain.revisions)
        also = supersede({old.life: old.state})
        new = Stream(old.robot, chain.life, 1, old.facts.after({**facts, **also}), submaps, chain.link(1))
        result = self._say(Stream(old.robot, chain.life), new)
        self.chain = chain
        return result

    def _say(self, old: Stream, new: Stream) -> tuple[bytes, Step]:
        if new.facts != self.stream.facts:
            try:
                check_facts(new.facts)
            except ValueError as error:
                raise ConfigError(option="facts", value=f"{len(new.facts)} facts", reason=str(error)) from None
        record, step = record_message(old, new)
        if len(record) > MAX_CHUNK_BYTES:
            snapshot_messages(new)  # refuses what no peer could catch up with
        if old.life != self.stream.life:
            self.log.clear()
        self.stream = new
        self.log.append(old.revision, record)
        return record, step
