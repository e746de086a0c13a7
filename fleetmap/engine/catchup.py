"""Questions planned and under way: about what, to whom, and when to ask again."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, field

from fleetmap.engine.stream import Key

GRACE_S = 0.15
"""How long a gap may close by itself before a question is sent: records travel on another key than heartbeats."""
REPLY_TIMEOUT_S, FIRST_REPLY_TIMEOUT_S = 4.0, 1.5
"""How long an answer may take; and that of somebody who has never answered. A later one is still of use."""
MAX_LATE = 256
FIRST_RETRY_S, FIRST_LIST_RETRY_S, LONGEST_RETRY_S = 0.2, 0.5, 10.0
MAX_UNDER_WAY = 32
MAX_UNDER_WAY_EACH = 4
"""Questions under way at once, to all and to one: who doesn't answer keeps nobody else waiting."""
MAX_STRANGERS_LISTING, MAX_STRANGERS_UNDER_WAY = 8, 16
"""Of these, questions to who doesn't act as a peer, and about streams of such authors: a thousand tokens of nobody and
as many streams leave room for the others."""
MAX_REPLIES = 1024
"""Replies to one question, a snapshot's chunks and the records behind them."""
FAILED = 3
"""After so many questions in vain, what somebody claims is not waited for: it is asked for ever more seldom."""


@dataclass(frozen=True, slots=True)
class About:
    """What a question is about: a stream, or (with None) what the asked peer holds."""

    peer: Key
    stream: Key | None


@dataclass(slots=True)
class _Pair:
    """What came of asking a peer about a stream."""

    failures: int = 0
    again_s: float = 0.0
    asked: int = 0


@dataclass(slots=True)
class _Question:
    about: About
    deadline_s: float
    helped: int = 0


@dataclass(slots=True)
class Catchup:
    """Bookkeeping of questions.

    A stream that is behind has one question under way at a time. Whom it is put to is the caller's to say, each time
    anew: the peers that hold more, in the order of preference.
    """

    _due_s: dict[Key, float] = field(default_factory=dict)
    _lists_due_s: dict[Key, float] = field(default_factory=dict)
    _pairs: dict[Key, dict[Key | None, _Pair]] = field(default_factory=dict)
    """By peer, by what it was asked about."""
    _under_way: dict[int, _Question] = field(default_factory=dict)
    _late: dict[int, About] = field(default_factory=dict)
    _parked: dict[Key, Key] = field(default_factory=dict)
    """Streams that wait until a peer has answered something else."""
    _next_id: int = 0
    _look_s: float = 0.0
    """Before then nothing can be due."""

    def want(self, stream: Key, due_s: float) -> None:
        """Ask about a stream at ``due_s``, or earlier if that was planned."""
        self._parked.pop(stream, None)
        self._due_s[stream] = min(due_s, self._due_s.get(stream, due_s))
        self._look_s = min(self._look_s, due_s)

    def want_list(self, peer: Key, due_s: float) -> None:
        """Ask a peer what it holds."""
        self._lists_due_s[peer] = min(due_s, self._lists_due_s.get(peer, due_s))
        self._look_s = min(self._look_s, due_s)

    @property
    def lists_waiting(self) -> int:
        """Questions for lists that are planned or under way."""
        return len(self._lists_due_s) + sum(q.about.stream is None for q in self._under_way.values())

    def peer_gone(self, peer: Key) -> None:
        """Nothing can be had from it any more."""
        self._lists_due_s.pop(peer, None)
        self._pairs.pop(peer, None)
        self._under_way = {i: q for i, q in self._under_way.items() if q.about.peer != peer}
        self._late = {i: about for i, about in self._late.items() if about.peer != peer}
        for stream in [stream for stream, at in self._parked.items() if at == peer]:
            self.want(stream, 0.0)
        self._look_s = 0.0  # what it was asked about is due still

    def listed(self, peer: Key, streams: Collection[Key]) -> None:
        """A peer says anew which streams it holds: what came of asking it for others is forgotten."""
        pairs = self._pairs.get(peer, {})
        self._pairs[peer] = {stream: pair for stream, pair in pairs.items() if stream is None or stream in streams}

    def stream_gone(self, stream: Key) -> None:
        """The stream is not wanted any more."""
        self.settled(stream)
        for pairs in self._pairs.values():
            pairs.pop(stream, None)

    def settled(self, stream: Key) -> None:
        """Nothing of a stream is missing."""
        self._due_s.pop(stream, None)
        self._parked.pop(stream, None)

    def renewed(self, about: About, now_s: float) -> None:
        """A peer says something else of a stream than before: what came of asking no longer counts."""
        pair = self._pair(about)
        if pair is not None:
            # Not at once: who says something else all the time would be asked all the time.
            pair.failures, pair.again_s = 0, min(pair.again_s, now_s + FIRST_RETRY_S)
            self._look_s = min(self._look_s, pair.again_s)

    def in_vain(self, about: About) -> bool:
        """Whether what a peer claims is not to be waited for."""
        pair = self._pair(about)
        return pair is not None and pair.failures >= FAILED

    def expired(self, now_s: float) -> list[About]:
        """Give up waiting for answers; returns what was asked in vain."""
        vain = []
        for ask_id, question in list(self._under_way.items()):
            if question.deadline_s <= now_s:
                about = self.ended(ask_id, now_s)
                vain += [about] if about is not None else []
                self._late[ask_id] = question.about
                if len(self._late) > MAX_LATE:
                    del self._late[next(iter(self._late))]
        return vain

    def due(self, now_s: float, holders: Callable[[Key], list[Key]], steady: Callable[[Key], bool]) -> list[About]:
        """The questions to send now; ``steady`` says who acts as a peer does."""
        if now_s < self._look_s:
            return []
        busy: dict[Key, int] = {}
        asked: set[Key] = set()
        listing: set[Key] = set()
        for question in self._under_way.values():
            busy[question.about.peer] = busy.get(question.about.peer, 0) + 1
            if question.about.stream is None:
                listing.add(question.about.peer)
            else:
                asked.add(question.about.stream)
        found: list[About] = []

        def take(about: About) -> bool:
            if len(self._under_way) + len(found) >= MAX_UNDER_WAY or busy.get(about.peer, 0) >= MAX_UNDER_WAY_EACH:
                return False
            busy[about.peer] = busy.get(about.peer, 0) + 1
            found.append(about)
            return True

        strangers = sum(not steady(peer) for peer in listing)
        # First those who act as peers do.
        for peer in sorted(_ready(self._lists_due_s, now_s), key=lambda peer: not steady(peer)):
            about = About(peer, None)
            if not steady(peer) and strangers >= MAX_STRANGERS_LISTING:
                break
            if self._again_s(about) > now_s:
                self._lists_due_s[peer] = self._again_s(about)
            elif peer not in listing and take(about):
                listing.add(peer)
                strangers += not steady(peer)
                del self._lists_due_s[peer]
        # And those of authors who are there: strangers' streams are many, and cost nothing.
        strangers = sum(not steady(stream) for stream in asked)
        for stream in sorted(_ready(self._due_s, now_s), key=lambda stream: not steady(stream)):
            if not steady(stream) and strangers >= MAX_STRANGERS_UNDER_WAY:
                break
            if stream in asked:
                continue
            peers = holders(stream)
            if not peers:
                del self._due_s[stream]
                continue
            if len(self._under_way) + len(found) >= MAX_UNDER_WAY:
                break
            again_s = {peer: self._again_s(About(peer, stream)) for peer in peers}
            may = [peer for peer in peers if again_s[peer] <= now_s]
            # Each in turn, whoever promises most: the author again and again while it answers.
            may.sort(key=lambda peer: self._turn(About(peer, stream)))
            if any(take(About(peer, stream)) for peer in may):
                strangers += not steady(stream)
                continue
            if len(may) < len(peers):
                self._due_s[stream] = min(due_s for due_s in again_s.values() if due_s > now_s)
            else:
                del self._due_s[stream]
                self._parked[stream] = may[0]
        later = [due_s for dues in (self._due_s, self._lists_due_s) for due_s in dues.values() if due_s > now_s]
        # What is due and was not sent waits for an answer to something else: ``ended`` looks again.
        self._look_s = min(later, default=math.inf)
        return found

    def sent(self, about: About, now_s: float, *, timeout_s: float = REPLY_TIMEOUT_S) -> int:
        """A question goes out: its id."""
        self._next_id += 1
        self._pairs.setdefault(about.peer, {}).setdefault(about.stream, _Pair()).asked = self._next_id
        self._under_way[self._next_id] = _Question(about, now_s + timeout_s)
        return self._next_id

    def about(self, ask_id: int) -> About | None:
        """What a question is about, even if nobody waits for its answer any more; None if it was long ago."""
        question = self._under_way.get(ask_id)
        return self._late.get(ask_id) if question is None else question.about

    def helped(self, ask_id: int, now_s: float) -> None:
        """A reply was of use; what is still to come may take its time, within bounds."""
        question = self._under_way.get(ask_id)
        if question is not None:
            question.helped += 1
            if question.helped < MAX_REPLIES:
                question.deadline_s = now_s + REPLY_TIMEOUT_S
        about = self.about(ask_id)
        pair = None if about is None else self._pair(about)
        if pair is not None:
            pair.failures, pair.again_s = 0, 0.0

    def ended(self, ask_id: int, now_s: float) -> About | None:
        """No more replies will come: what they didn't settle is asked again. Returns what was asked in vain, if so."""
        question = self._under_way.pop(ask_id, None)
        self._late.pop(ask_id, None)
        self._look_s = 0.0
        if question is not None:
            parked = next((stream for stream, at in self._parked.items() if at == question.about.peer), None)
            if parked is not None:
                self.want(parked, now_s)
        if question is None or question.helped:
            return None
        pair = self._pair(question.about)
        if pair is None:  # the peer is gone, or lists the stream no more
            return question.about
        first_s = FIRST_RETRY_S if question.about.stream is not None else FIRST_LIST_RETRY_S
        pair.again_s = now_s + min(first_s * 2**pair.failures, LONGEST_RETRY_S)
        pair.failures = min(pair.failures + 1, 16)
        return question.about

    def _pair(self, about: About) -> _Pair | None:
        return self._pairs.get(about.peer, {}).get(about.stream)

    def _again_s(self, about: About) -> float:
        pair = self._pair(about)
        return 0.0 if pair is None else pair.again_s

    def _turn(self, about: About) -> tuple[bool, int]:
        """When a peer is asked about a stream: its author first, unless that was in vain; who was asked last, last."""
        pair = self._pair(about)
        if pair is None:
            return about.peer != about.stream, 0
        return about.peer != about.stream or pair.failures > 0, pair.asked


def _ready(dues: dict[Key, float], now_s: float) -> list[Key]:
    """What is due, in that order."""
    return [key for _, key in sorted((due_s, key) for key, due_s in dues.items() if due_s <= now_s)]
