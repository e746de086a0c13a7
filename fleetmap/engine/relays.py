"""For two that have no link to each other: a third one that hears both hands on what they say.

Zenoh tries once to link two peers that a third one told of each other, and peers pass nothing on. So whoever learns
from a neighbour that somebody lives whom it doesn't see itself asks that neighbour for all that this one says: an
answer that stays open, and is asked for again before it ends.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from fleetmap.engine.inputs import Replying
from fleetmap.engine.outputs import Answer, Output
from fleetmap.engine.stream import Key

RELAY_S = 60.0
"""How long an answer stays open."""
RENEW_S = 50.0
MAX_RELAYED = 64
"""Peers without a link that are listened to."""
MAX_LISTENERS, MAX_LISTENERS_EACH = 256, 32
"""Open answers of one peer, and of these about one life."""
MAX_BY_ONE = 16
"""Of ``MAX_RELAYED``, by way of one neighbour, which may invent whom it sees."""
SILENT_S = 15.0
"""After so long a neighbour by which nothing has come gives way to another one."""
FIRST_RETRY_S, LONGEST_RETRY_S = 1.0, 60.0


@dataclass(slots=True)
class Way:
    """By which neighbour somebody is heard.

    Parameters
    ----------
    via : the neighbour
    since_s : since when
    renew_s : when to ask it again
    ask_ids : its open answers, and one that is coming
    spoke : something came this way
    """

    via: Key
    since_s: float
    renew_s: float
    ask_ids: set[int] = field(default_factory=set)
    spoke: bool = False


@dataclass(slots=True)
class Listening:
    """Who is heard by way of others.

    Attributes
    ----------
    ways : by (robot, life)
    """

    ways: dict[Key, Way] = field(default_factory=dict)
    _failed: dict[Key, tuple[float, float, Key]] = field(default_factory=dict)
    """Whom a neighbour didn't hand on: until when nobody is asked, for how long, and who it was."""
    _next_id: int = 0

    def robots(self) -> set[str]:
        """Names that are heard. Any thread may call it."""
        return {key[0] for key, way in list(self.ways.items()) if way.spoke}

    def told(self, via: Key, living: Iterable[Key], now_s: float) -> None:
        """A neighbour sees these, and this peer doesn't."""
        by_it = sum(way.via == via for way in self.ways.values())
        for key in sorted(set(living) - self.ways.keys()):
            until_s, _, by_whom = self._failed.get(key, (0.0, 0.0, None))
            # Another one first.
            may = now_s >= until_s + (LONGEST_RETRY_S if by_whom == via else 0.0)
            if may and by_it < MAX_BY_ONE and len(self.ways) < MAX_RELAYED:
                self.ways[key] = Way(via, now_s, now_s)
                by_it += 1

    def due(self, now_s: float) -> list[tuple[int, Key, Key]]:
        """(id, neighbour, whom) of the questions to put now."""
        asks = []
        for key, way in self.ways.items():
            if now_s >= way.renew_s:
                self._next_id -= 1
                way.renew_s = now_s + RENEW_S
                way.ask_ids.add(self._next_id)
                asks.append((self._next_id, way.via, key))
        return asks

    def silent(self, now_s: float) -> list[Key]:
        """Give up ways by which nothing has come; returns who is to be looked for anew."""
        given_up = [key for key, way in self.ways.items() if not way.spoke and now_s >= way.since_s + SILENT_S]
        for key in given_up:
            self._failed_again(key, self.ways.pop(key).via, now_s)
        return given_up

    def way_of(self, ask_id: int) -> tuple[Key, Way] | None:
        """Whom an answer is about."""
        return next(((key, way) for key, way in self.ways.items() if ask_id in way.ask_ids), None)

    def ended(self, ask_id: int, now_s: float) -> Key | None:
        """An answer ended; returns who is heard no more."""
        found = self.way_of(ask_id)
        if found is None:
            return None
        key, way = found
        way.ask_ids.discard(ask_id)
        if way.ask_ids:
            return None
        del self.ways[key]
        if way.spoke:
            return key
        self._failed_again(key, way.via, now_s)
        return None

    def _failed_again(self, key: Key, via: Key, now_s: float) -> None:
        before_s = self._failed[key][1] if key in self._failed else 0.0
        pause_s = min(LONGEST_RETRY_S, 2 * before_s or FIRST_RETRY_S)
        self._failed[key] = (now_s + pause_s, pause_s, via)
        if len(self._failed) > MAX_RELAYED:
            del self._failed[next(iter(self._failed))]

    def lost(self, via: Key) -> list[Key]:
        """A neighbour is gone; returns who is heard no more."""
        through = [key for key, way in self.ways.items() if way.via == via]
        return [key for key in through if self.ways.pop(key).spoke]

    def linked(self, key: Key) -> None:
        """It is seen itself now."""
        self._failed.pop(key, None)
        self.ways.pop(key, None)


@dataclass(slots=True)
class Relaying:
    """Who is handed on, and to whom.

    Parameters
    ----------
    outputs : where open answers go
    """

    outputs: list[Output]
    _open: dict[Key, list[tuple[float, Replying]]] = field(default_factory=dict)

    def begin(self, key: Key, reply: Replying, now_s: float) -> bool:
        """Keep an answer open; False if there is no room."""
        self._end_old(now_s)
        if sum(map(len, self._open.values())) >= MAX_LISTENERS or len(self._open.get(key, ())) >= MAX_LISTENERS_EACH:
            return False
        self._open.setdefault(key, []).append((now_s + RELAY_S, reply))
        return True

    def hand_on(self, key: Key, payload: bytes, now_s: float) -> int:
        """Say what a life has said to all who want to hear it; returns to how many."""
        if key not in self._open:
            return 0
        self._end_old(now_s)
        listeners = self._open.get(key, ())
        self.outputs.extend(Answer(reply, (payload,), last=False) for _, reply in listeners)
        return len(listeners)

    def gone(self, key: Key) -> None:
        """It is not heard any more."""
        self.outputs.extend(Answer(reply, ()) for _, reply in self._open.pop(key, ()))

    def _end_old(self, now_s: float) -> None:
        for key, replies in list(self._open.items()):
            self._open[key] = [(until_s, reply) for until_s, reply in replies if until_s > now_s]
            self.outputs.extend(Answer(reply, ()) for until_s, reply in replies if until_s <= now_s)
            if not self._open[key]:
                del self._open[key]
