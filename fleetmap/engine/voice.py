"""How this robot says what it says: one word after the other, under a quota, and again if somebody doubts it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from fleetmap.accounting import Ledger
from fleetmap.codecs import envelope
from fleetmap.codecs.facts import FactsStep
from fleetmap.codecs.messages import Heartbeat
from fleetmap.engine.author import Author
from fleetmap.engine.outputs import LifeChanged, Output, Put
from fleetmap.engine.quota import Quota
from fleetmap.engine.stream import Stream
from fleetmap.model.vectormap import VectorMap

CONTEST_S = 1.0
"""At least so long between two words that are said only because somebody spoke in this robot's name."""


class Voice:
    """Puts the own words into the outputs.

    Parameters
    ----------
    author : the own stream
    outputs : where they go
    ledger : counts them
    heartbeat_s : how often the own revision is announced
    quota : when updates of the own map may be sent

    Attributes
    ----------
    waiting_maps, waiting_facts : what the quota holds back
    doubted : somebody has spoken in the own life's name, or wants it forgotten: the next word says who lives
    """

    def __init__(
        self, author: Author, outputs: list[Output], ledger: Ledger, *, heartbeat_s: float, quota: Quota
    ) -> None:
        self._author, self._outputs, self._ledger, self._quota = author, outputs, ledger, quota
        self._heartbeat_s, self._heartbeat_due_s = heartbeat_s, 0.0
        self._life = author.stream.life
        self._said: dict[str, bytes] = {}
        self._doubts_answered_s = -math.inf
        self.waiting_maps: dict[str, VectorMap] = {}
        self.waiting_facts: FactsStep = {}
        self.doubted = False

    def say(self, record: bytes) -> None:
        """Publish the revision that the author has come to; in a new life, if it has begun one."""
        if self._author.stream.life != self._life:
            self._life = self._author.stream.life
            self._outputs.append(LifeChanged(self._life))
        self._put("delta", record)

    def after(self, facts: FactsStep, maps: Mapping[str, VectorMap]) -> Stream:
        """The own stream as it would be after a step; it keeps its seq."""
        own = self._author.stream
        return Stream(own.robot, own.life, own.seq, own.facts.after(facts), {**own.submaps, **maps}, own.link)

    def wait(self, facts: FactsStep, maps: dict[str, VectorMap]) -> None:
        """Hold a step back, instead of what was held back before."""
        self.waiting_facts, self.waiting_maps = facts, maps

    def may_send(self, now_s: float) -> bool:
        """Whether what waits may go."""
        return bool(self.waiting_maps) and self._quota.may_send(now_s)

    def take_waiting(self) -> tuple[FactsStep, dict[str, VectorMap]]:
        """What waits; it waits no more."""
        waiting = self.waiting_facts, self.waiting_maps
        self.wait({}, {})
        return waiting

    def sent(self, size_bytes: int, now_s: float) -> None:
        """Note for the quota what went."""
        self._quota.sent(size_bytes, now_s)

    def answers_doubt(self, now_s: float) -> bool:
        """Whether a word is to be said now only because of a doubt."""
        if not self.doubted or now_s < self._doubts_answered_s + CONTEST_S:
            return False
        self.doubted, self._doubts_answered_s = False, now_s
        return True

    def announce(self, kind: str, payload: bytes) -> None:
        """Say something that is said again to every robot that appears."""
        self._said[kind] = payload
        self._put(kind, payload)

    def greet(self) -> None:
        """Say again what is announced: somebody has appeared."""
        for kind, payload in self._said.items():
            self._put(kind, payload)

    def beat(self, held: Callable[[], int], now_s: float) -> None:
        """Say how far the own stream is, and the hash over all that is held, if it is time."""
        if now_s >= self._heartbeat_due_s:
            self._heartbeat_due_s = now_s + self._heartbeat_s
            self._put("digest", envelope.encode(Heartbeat(self._author.stream.seq, held())))

    def _put(self, kind: str, payload: bytes) -> None:
        self._ledger.sent(kind, len(payload))
        self._outputs.append(Put(self._author.stream.life, kind, payload))
