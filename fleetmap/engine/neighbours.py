"""Who is there: the lives whose tokens are seen, whether they have ever spoken, and what each holds otherwise."""

from __future__ import annotations

from collections import Counter, OrderedDict
from dataclasses import dataclass, field

from fleetmap.codecs.messages import Range, Revision
from fleetmap.engine.ranges import place
from fleetmap.engine.stream import Key

MAX_NEIGHBOURS = 512
MAX_LIVES = 16
"""Tokens of one name."""
MAX_WAITING = 8192
"""Tokens without room that are remembered."""
MAX_CLAIMS = 1 << 16
"""Rows that are remembered, of all neighbours: what each holds otherwise than this peer."""
ALIVE_MASK = (1 << 32) - 1
MUTE_AFTER = 2
"""Questions that somebody left unanswered until nobody waits for it."""
FIRST_CALM_S, LONGEST_CALM_S = 1.0, 60.0
"""Between two comparisons that hashes lead to: where they don't help, they come ever more seldom."""
MAX_ROUNDS = 16
"""Questions of one comparison; five find what differs among all that anybody may hold."""


@dataclass(slots=True)
class Neighbour:
    """A life whose token is there.

    Attributes
    ----------
    spoke : it has said something that could be understood. Until then it is nobody: a token is easily forged
    steady : it has said how far it is, or answered, as a peer does; who only says records gives way to who comes
    listed : it has said what it holds since it was last asked
    unanswered : questions in a row that it left unanswered
    agreed : after how many changes here (``Holdings.changes``) it held the same, but for ``rows``; -1: never
    rows : what it says that it holds otherwise, by (robot, life); with seq 0 what it lacks
    said : its last heartbeat; ``held`` and ``alive``: the hashes in it; ``heard_s``: when it came
    asked_alive : the hashes over who lives, its and the own one, when it was asked last whom it sees
    further : what to ask it next, of a comparison that is under way
    rounds : questions of that comparison so far
    """

    key: Key
    spoke: bool = False
    steady: bool = False
    listed: bool = False
    unanswered: int = 0
    agreed: int = -1
    rows: dict[Key, Revision] = field(default_factory=dict)
    held: int = 0
    alive: int = 0
    heard_s: float = 0.0
    asked_alive: tuple[int, int] = (0, 0)
    said: bytes = b""
    further: list[Range] = field(default_factory=list)
    rounds: int = 0
    _calm_s: float = 0.0
    _calm_until_s: float = 0.0

    @property
    def mute(self) -> bool:
        """Nobody waits for it any more."""
        return self.unanswered >= MUTE_AFTER

    def agree(self, changes: int) -> None:
        """It holds what was held here after so many changes."""
        if changes >= self.agreed:
            self.agreed = changes
            self.rows.clear()
        self.listed = True
        self.further, self.rounds, self._calm_s, self._calm_until_s = [], 0, 0.0, 0.0

    def compared(self) -> None:
        """All has been asked for that it may hold otherwise."""
        self.listed, self.further, self.rounds = True, [], 0

    def next_look_s(self, now_s: float) -> float:
        """When to ask what it holds, as its hash differs; ever later, if that doesn't help."""
        if now_s < self._calm_until_s:
            return self._calm_until_s
        self._calm_s = min(LONGEST_CALM_S, 2 * self._calm_s or FIRST_CALM_S)
        self._calm_until_s = now_s + self._calm_s
        return now_s


@dataclass(slots=True)
class Neighbours:
    """The table of neighbours, bounded; who acts as no peer gives way to who comes, and comes back when it speaks.

    Attributes
    ----------
    refused : somebody found no room
    """

    by_key: dict[Key, Neighbour] = field(default_factory=dict)
    refused: bool = False
    _of_name: Counter[str] = field(default_factory=Counter)
    """How many lives of each name there are."""
    _waiting: OrderedDict[Key, None] = field(default_factory=OrderedDict)
    """Tokens for which there is no room, until they speak."""

    def __contains__(self, key: Key) -> bool:
        return key in self.by_key

    def robots(self) -> set[str]:
        """Names that live: at least one life of theirs has spoken. Any thread may call it."""
        return {n.key[0] for n in list(self.by_key.values()) if n.spoke}

    def present(self, key: Key) -> bool:
        """Whether a life is there, and has ever spoken."""
        neighbour = self.by_key.get(key)
        return neighbour is not None and neighbour.spoke

    def steady(self, key: Key) -> bool:
        """Whether a life is there, and acts as a peer does."""
        neighbour = self.by_key.get(key)
        return neighbour is not None and neighbour.steady

    def add(self, key: Key) -> tuple[bool, Neighbour | None]:
        """A token appeared: whether there is room for it, and who gave way."""
        if key in self.by_key:
            return True, None
        silent = None
        crowded = self._of_name[key[0]] >= MAX_LIVES
        if crowded or len(self.by_key) >= MAX_NEIGHBOURS:
            nobody = (n for n in self.by_key.values() if not n.steady and (not crowded or n.key[0] == key[0]))
            # Who has never spoken, the one that has had the longest time for it; else who says records alone.
            spoken = None
            for silent in nobody:
                if not silent.spoke:
                    break
                spoken = spoken or silent
            else:
                silent = spoken
            if silent is None:
                self._wait(key)
                return False, None
            self.remove(silent.key)
            self._wait(silent.key)
        self._waiting.pop(key, None)
        self.by_key[key] = Neighbour(key)
        self._of_name[key[0]] += 1
        return True, silent

    def remove(self, key: Key) -> Neighbour | None:
        """Its token vanished; None if it wasn't in the table."""
        self._waiting.pop(key, None)
        neighbour = self.by_key.pop(key, None)
        if neighbour is not None:
            self._of_name[key[0]] -= 1
            if not self._of_name[key[0]]:
                del self._of_name[key[0]]
        return neighbour

    def waits(self, key: Key) -> bool:
        """Whether its token was there, and no room for it."""
        return key in self._waiting

    def _wait(self, key: Key) -> None:
        self.refused = True
        self._waiting[key] = None
        if len(self._waiting) > MAX_WAITING:
            self._waiting.popitem(last=False)

    def bound_rows(self) -> None:
        """Forget rows where all say too much otherwise."""
        if sum(len(n.rows) for n in self.by_key.values()) > MAX_CLAIMS:
            most = max(self.by_key.values(), key=lambda n: len(n.rows))
            most.rows = dict(list(most.rows.items())[: MAX_CLAIMS // MAX_NEIGHBOURS])

    def living(self, own: Key) -> list[Key]:
        """Who is there, ascending, the own life too."""
        return sorted([own, *(n.key for n in self.by_key.values() if n.spoke)])

    def alive(self, own: Key) -> int:
        """One hash of 32 bits over who is there, the own life too."""
        return (place(own) + sum(place(n.key) for n in self.by_key.values() if n.spoke)) & ALIVE_MASK
