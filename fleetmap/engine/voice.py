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

EARLY_S, LATE_S = 0.5, 2.0
"""After a change the own seq is said: soon, for whoever missed the record, and again once nothing has changed for a
while. The first only once in ``heartbeat_s``: who hears the next record sees by itself that one is missing."""
MOVES_A_HEARTBEAT = 20
"""So often a pose or a goal that changes may be said in ``heartbeat_s``."""
CONTEST_S = 1.0
"""At least so long between two words that are said only because somebody spoke in this robot's name."""


class Voice:
    """Puts the own words into the outputs.

    Parameters
    ----------
    author : the own stream
    outputs : where they go
    ledger : counts them
    heartbeat_s : how often the own revision is announced while nothing changes
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
        self._heartbeat_s = heartbeat_s
        self._due_s, self._early_s, self._late_s = 0.0, math.inf, math.inf
        self._early_again_s = self._move_again_s = -math.inf
        self._changed = self._moved = False
        self._pose: tuple[int, int, int] | None = None
        self._goal: tuple[int, int] | None = None
        self._life = author.stream.life
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
        self.stir()

    def stir(self) -> None:
        """What is held here changed in a way that the others may not have heard of."""
        self._changed = True

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

    def move(self, pose: tuple[int, int, int] | None) -> None:
        """Announce where the robot is."""
        self._moved |= pose != self._pose
        self._pose = pose

    def head_for(self, goal: tuple[int, int] | None) -> None:
        """Announce where it is going."""
        self._moved |= goal != self._goal
        self._goal = goal

    def state(self, held: int, alive: int) -> Heartbeat:
        """How far the own stream is, and where the robot."""
        return Heartbeat(self._author.stream.seq, held, alive, self._pose, self._goal)

    def beat(self, held: Callable[[], int], alive: Callable[[], int], now_s: float) -> None:
        """Say that, if it is time."""
        if self._changed:
            self._changed, self._late_s = False, now_s + LATE_S
            if now_s >= self._early_again_s:
                self._early_s, self._early_again_s = now_s + EARLY_S, now_s + self._heartbeat_s
        moves = self._moved and now_s >= self._move_again_s
        if moves or now_s >= min(self._due_s, self._early_s, self._late_s):
            self._moved, self._move_again_s = False, now_s + self._heartbeat_s / MOVES_A_HEARTBEAT
            self._due_s = now_s + self._heartbeat_s
            self._early_s = math.inf if now_s >= self._early_s else self._early_s
            self._late_s = math.inf if now_s >= self._late_s else self._late_s
            self._put("digest", envelope.encode(self.state(held(), alive())))

    def _put(self, kind: str, payload: bytes) -> None:
        self._ledger.sent(kind, len(payload))
        self._outputs.append(Put(self._author.stream.life, kind, payload))
