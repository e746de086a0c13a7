"""A link within one process, for tests: what is lost, late, doubled or cut is decided by a script.

``fleetmap.join("r1", link=MemoryHub(LoopClock()).link("r1"))`` joins a fleet that is in memory. With a
``FakeClock``, engines are driven without an event loop.
"""

from __future__ import annotations

import asyncio
import heapq
import itertools
from collections.abc import Callable, Collection, Sequence
from functools import partial
from typing import Protocol

from fleetmap.engine import RELAY_S, Alive, Gone, Message, Query, Replying
from fleetmap.peer.link import Network, Receiver, Token

ASK_TIMEOUT_S = 20.0
OVERHEAD_BYTES = 155
"""What a payload costs beside itself where a link is narrow, as measured with Zenoh over TCP."""


class Clock(Protocol):
    """Something that calls back later."""

    def time(self) -> float:
        """Seconds, only ever growing."""
        ...

    def call_later(self, delay_s: float, call: Callable[[], None]) -> None:
        """Call after so many seconds."""
        ...


class FakeClock:
    """A clock that moves when it is told to."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self._calls: list[tuple[float, int, Callable[[], None]]] = []
        self._order = itertools.count()

    def __call__(self) -> float:
        """Seconds since it was made."""
        return self.now_s

    def time(self) -> float:
        """The same."""
        return self.now_s

    def call_later(self, delay_s: float, call: Callable[[], None]) -> None:
        """Call when the clock has moved so far; calls of one instant keep their order."""
        heapq.heappush(self._calls, (self.now_s + delay_s, next(self._order), call))

    def advance(self, seconds: float) -> None:
        """Move on, and make all calls that fall due."""
        until_s = self.now_s + seconds
        while self._calls and self._calls[0][0] <= until_s:
            self.now_s, _, call = heapq.heappop(self._calls)
            call()
        self.now_s = until_s


class LoopClock:
    """The clock of the running event loop; may be called from any thread."""

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()

    def time(self) -> float:
        """That of the loop."""
        return self._loop.time()

    def call_later(self, delay_s: float, call: Callable[[], None]) -> None:
        """Call on the loop after so many seconds."""
        self._loop.call_soon_threadsafe(self._loop.call_later, delay_s, call)


Fate = Callable[[str, str, str], Sequence[float]]
"""(sender, receiver, kind) -> the delays in seconds of the copies that arrive; none: the payload is lost."""


def arrives(sender: str, receiver: str, kind: str) -> Sequence[float]:
    """Every payload arrives once, at once."""
    return (0.0,)


class MemoryHub:
    """The medium that links share.

    Parameters
    ----------
    clock : when things arrive
    fate : which copies of a payload arrive, and when
    rate_Bps : what a link carries each way, one payload after the other; None: any amount at once
    """

    def __init__(self, clock: Clock, *, fate: Fate = arrives, rate_Bps: float | None = None) -> None:
        self.clock, self.fate, self.rate_Bps = clock, fate, rate_Bps
        self._busy_until_s: dict[tuple[str, str], float] = {}
        self._links: dict[str, MemoryLink] = {}
        self._cuts: set[frozenset[str]] = set()

    def link(self, robot: str) -> MemoryLink:
        """A new link for a robot. An older one of that name stays, as a second session would."""
        return MemoryLink(self, robot)

    def cut(self, a: str, b: str) -> None:
        """Part two robots: nothing passes, and each sees the other's token vanish."""
        self._cuts.add(frozenset((a, b)))
        for one, other in ((a, b), (b, a)):
            self._busy_until_s.pop((one, other), None)
            for link in self._named(one):
                for token in self._tokens(other):
                    link.see(token, alive=False)

    def heal(self, a: str, b: str) -> None:
        """Undo a cut."""
        self._cuts.discard(frozenset((a, b)))
        for one, other in ((a, b), (b, a)):
            for link in self._named(one):
                for token in self._tokens(other):
                    link.see(token, alive=True)

    def reaches(self, a: str, b: str) -> bool:
        """Whether ``a`` can send to ``b`` now."""
        return frozenset((a, b)) not in self._cuts

    def others(self, link: MemoryLink) -> list[MemoryLink]:
        """The open links that a link can send to."""
        return [o for o in self._links.values() if o is not link and self.reaches(link.robot, o.robot)]

    def attach(self, link: MemoryLink) -> None:
        """A link opened."""
        self._links[f"{link.robot}/{id(link)}"] = link

    def detach(self, link: MemoryLink) -> None:
        """A link closed."""
        self._links.pop(f"{link.robot}/{id(link)}", None)

    def carry(self, sender: str, receiver: str, kind: str, size_bytes: int, deliver: Callable[[], None]) -> float:
        """Let a payload meet its fate; returns the seconds until its last copy arrives."""
        last_s = 0.0
        for delay_s in self.fate(sender, receiver, kind):
            delay_s += self._queue(sender, receiver, size_bytes)
            self.clock.call_later(delay_s, deliver)
            last_s = max(last_s, delay_s)
        return last_s

    def _queue(self, sender: str, receiver: str, size_bytes: int) -> float:
        if self.rate_Bps is None:
            return 0.0
        now_s = self.clock.time()
        free_s = max(now_s, self._busy_until_s.get((sender, receiver), now_s))
        self._busy_until_s[sender, receiver] = free_s + size_bytes / self.rate_Bps
        return self._busy_until_s[sender, receiver] - now_s

    def _named(self, robot: str) -> list[MemoryLink]:
        return [link for link in self._links.values() if link.robot == robot]

    def _tokens(self, robot: str) -> list[Token]:
        return [link.token for link in self._named(robot) if link.token is not None]


class MemoryLink:
    """A robot's end of a ``MemoryHub``."""

    def __init__(self, hub: MemoryHub, robot: str) -> None:
        self.robot = robot
        self.token: Token | None = None
        self._hub = hub
        self._receiver: Receiver | None = None

    async def open(self, receiver: Receiver) -> list[Token]:
        """Connect; returns the peers that are alive."""
        return self.connect(receiver)

    def connect(self, receiver: Receiver) -> list[Token]:
        """What ``open`` does, for tests without an event loop."""
        self._receiver = receiver
        self._hub.attach(self)
        tokens = [other.token for other in self._hub.others(self) if other.token is not None]
        for token in tokens:
            self.see(token, alive=True)
        return tokens

    async def show(self, life: int) -> None:
        """Show the own token, instead of the one before."""
        self.display(life)

    def display(self, life: int | None) -> None:
        """What ``show`` does, for tests without an event loop; None takes the token away."""
        before, self.token = self.token, None if life is None else (self.robot, life)
        for other in self._hub.others(self):
            if self.token is not None:
                other.see(self.token, alive=True)
            if before is not None and before != self.token:
                other.see(before, alive=False)

    def see(self, token: Token, *, alive: bool) -> None:
        """Another link's token appeared or vanished."""
        self._hub.clock.call_later(0.0, lambda: self._see(token, alive=alive))

    def put(self, life: int, kind: str, payload: bytes) -> None:
        """Publish under the own key."""
        if self._receiver is None:
            return
        message = Message(self.robot, life, kind, payload)
        for other in self._hub.others(self):
            arrive = partial(other.receive, message)
            self._hub.carry(self.robot, other.robot, kind, OVERHEAD_BYTES + len(payload), arrive)

    def receive(self, message: Message) -> None:
        """A sample of another peer arrives."""
        if self._receiver is not None and self._hub.reaches(message.robot, self.robot):
            self._receiver.deliver(message)

    def ask(
        self,
        peer: Token,
        kind: str,
        payload: bytes,
        *,
        on_reply: Callable[[bytes], None],
        on_end: Callable[[], None],
    ) -> None:
        """Query a key of a peer; the replies end with the last one, or after a timeout."""
        asked = [o for o in self._hub.others(self) if o.token == peer] if self._receiver else []
        waiting = len(asked)
        ended = False

        def end() -> None:
            nonlocal ended
            if not ended:
                ended = True
                on_end()

        def take(reply: bytes) -> None:
            if not ended:
                on_reply(reply)

        def answered(other: MemoryLink, replies: Sequence[bytes], *, last: bool = True) -> None:
            nonlocal waiting
            last_s = 0.0
            for reply in replies if self._hub.reaches(other.robot, self.robot) else ():
                size_bytes = OVERHEAD_BYTES + len(reply)
                arrives_s = self._hub.carry(other.robot, self.robot, "reply", size_bytes, partial(take, reply))
                last_s = max(last_s, arrives_s)
            waiting -= last
            if last and waiting == 0:
                # Behind the replies.
                self._hub.clock.call_later(last_s, end)

        if not asked:
            self._hub.clock.call_later(0.0, end)
            return
        self._hub.clock.call_later(RELAY_S if kind == "relay" else ASK_TIMEOUT_S, end)
        for other in asked:
            arrive = partial(other.asked, kind, payload, partial(answered, other))
            self._hub.carry(self.robot, other.robot, kind, OVERHEAD_BYTES + len(payload), arrive)

    def asked(self, kind: str, payload: bytes, reply: Replying) -> None:
        """A question arrives."""
        if self._receiver is not None:
            self._receiver.deliver(Query(kind, payload, reply))

    async def tokens(self) -> list[Token]:
        """The peers that are there now."""
        return [other.token for other in self._hub.others(self) if other.token is not None]

    async def look(self, seen: Collection[str], heard: Sequence[str]) -> Network:
        """Nothing is ever wrong with it."""
        return Network()

    async def close(self) -> None:
        """Disconnect."""
        self.vanish()

    def vanish(self) -> None:
        """What ``close`` does, for tests without an event loop: also what a killed process looks like."""
        self.display(None)
        self._hub.detach(self)
        self._receiver = None

    def _see(self, token: Token, *, alive: bool) -> None:
        if self._receiver is not None:
            self._receiver.deliver(Alive(*token) if alive else Gone(*token))
