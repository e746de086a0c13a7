"""What is missing, whom to ask for it, and when to ask again."""

from __future__ import annotations

from dataclasses import dataclass, field

Key = tuple[str, int]
"""(robot, epoch) of a stream; (robot, LIST) stands for that peer's list of revisions."""

LIST = -1
GRACE_S = 0.15
"""How long a gap may close by itself before a question is sent: records travel on another key than heartbeats."""
REPLY_TIMEOUT_S = 3.0
FIRST_RETRY_S, LONGEST_RETRY_S = 0.2, 5.0
MAX_PENDING = 32
"""Questions under way at once; the others wait for their turn."""


@dataclass(slots=True)
class Pending:
    """A question under way, or one that is to be asked at ``due_s``."""

    due_s: float
    attempt: int = 0
    ask_id: int | None = None
    deadline_s: float = 0.0


@dataclass(slots=True)
class Catchup:
    """Bookkeeping: who holds how much of each stream, and the questions planned and under way."""

    _holders: dict[Key, dict[str, int]] = field(default_factory=dict)
    _pending: dict[Key, Pending] = field(default_factory=dict)
    _by_id: dict[int, tuple[Key, str]] = field(default_factory=dict)
    _next_id: int = 0

    def announced(self, key: Key, peer: str, seq: int) -> None:
        """``peer`` says that it holds a stream up to ``seq``."""
        self._holders.setdefault(key, {})[peer] = seq

    def ahead(self, key: Key, seq: int) -> list[str]:
        """The peers that hold more of a stream than ``seq``: the author first, then its mirrors."""
        peers = [peer for peer, held in self._holders.get(key, {}).items() if held > seq]
        return sorted(peers, key=lambda peer: (peer != key[0], peer))

    def announced_keys(self) -> list[Key]:
        """All streams that living peers have announced, ascending."""
        return sorted(self._holders)

    def peer_gone(self, peer: str) -> None:
        """What a peer announced can't be had from it any more."""
        self.settled((peer, LIST))
        self.forget_announced(peer)

    def forget_announced(self, peer: str) -> None:
        """Whatever ``peer`` announced is out of date: it is gone, or says anew what it holds."""
        for holders in self._holders.values():
            holders.pop(peer, None)
        self._holders = {key: holders for key, holders in self._holders.items() if holders}

    def stream_gone(self, key: Key) -> None:
        """The stream is not wanted any more."""
        self._holders.pop(key, None)
        self.settled(key)

    def want(self, key: Key, due_s: float) -> None:
        """Ask for ``key`` at ``due_s``, unless that is under way or planned for earlier."""
        pending = self._pending.get(key)
        if pending is None:
            self._pending[key] = Pending(due_s)
        elif pending.ask_id is None:
            pending.due_s = min(pending.due_s, due_s)

    def due(self, now_s: float) -> list[tuple[Key, int]]:
        """The questions to send now, with how often each was sent before; expired ones are planned anew."""
        for pending in self._pending.values():
            if pending.ask_id is not None and pending.deadline_s <= now_s:
                self._again(pending, now_s)
        under_way = sum(p.ask_id is not None for p in self._pending.values())
        ready = sorted((p.due_s, k) for k, p in self._pending.items() if p.ask_id is None and p.due_s <= now_s)
        return [(key, self._pending[key].attempt) for _, key in ready[: MAX_PENDING - under_way]]

    def sent(self, key: Key, peer: str, now_s: float) -> int:
        """A question about ``key`` goes to ``peer``: its id."""
        self._next_id += 1
        pending = self._pending[key]
        pending.ask_id, pending.deadline_s = self._next_id, now_s + REPLY_TIMEOUT_S
        self._by_id[self._next_id] = (key, peer)
        return self._next_id

    def about(self, ask_id: int) -> tuple[Key, str] | None:
        """(key, peer) of a question; None if it is over."""
        return self._by_id.get(ask_id)

    def ended(self, ask_id: int, now_s: float) -> None:
        """No more replies will come; what they didn't settle is asked again."""
        found = self._by_id.get(ask_id)
        if found is not None:
            self._again(self._pending[found[0]], now_s)

    def settled(self, key: Key) -> None:
        """Nothing is missing any more."""
        pending = self._pending.pop(key, None)
        if pending is not None and pending.ask_id is not None:
            del self._by_id[pending.ask_id]

    def _again(self, pending: Pending, now_s: float) -> None:
        if pending.ask_id is not None:
            del self._by_id[pending.ask_id]
        pending.ask_id = None
        pending.due_s = now_s + min(FIRST_RETRY_S * 2**pending.attempt, LONGEST_RETRY_S)
        pending.attempt += 1
