"""Who is there: the lives whose tokens are seen, whether they have ever spoken, and what each says that it holds."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field

from fleetmap.codecs.messages import Revision
from fleetmap.engine.stream import Key

MAX_NEIGHBOURS = 512
MAX_LIVES = 16
"""Tokens of one name."""
MAX_WAITING = 8192
"""Tokens without room that are remembered."""
MAX_CLAIMS = 1 << 16
"""Rows of lists that are remembered, of all neighbours."""
MUTE_AFTER = 2
"""Questions that somebody left unanswered until nobody waits for it."""
MANY_DIFFERENCES = 4
LONGEST_CALM_S = 60.0


@dataclass(slots=True)
class Neighbour:
    """A life whose token is there.

    Attributes
    ----------
    spoke : it has said something that could be understood. Until then it is nobody: a token is easily forged
    steady : it has said how far it is, or answered, as a peer does; who only says records gives way to who comes
    listed : it has said what it holds since it was last asked
    unanswered : questions in a row that it left unanswered
    claims : what it says that it holds, by (robot, life)
    """

    key: Key
    spoke: bool = False
    steady: bool = False
    listed: bool = False
    unanswered: int = 0
    claims: dict[Key, Revision] = field(default_factory=dict)
    _differed: tuple[int, int] | None = None
    _differences: int = 0
    _calm_s: float = 0.0
    _calm_until_s: float = 0.0

    @property
    def mute(self) -> bool:
        """Nobody waits for it any more."""
        return self.unanswered >= MUTE_AFTER

    def differs(self, held: int, own: int, now_s: float) -> bool:
        """Note its hash over all that it holds; True if its list should be asked for.

        That is when two heartbeats in a row differed from one and the same own hash, or, where somebody speaks all the
        time, a few differed; ever more seldom, if lists don't help.
        """
        if held == own:
            self._differed, self._differences, self._calm_s, self._calm_until_s = None, 0, 0.0, 0.0
            return False
        twice, self._differed = self._differed == (held, own), (held, own)
        self._differences += 1
        if not (twice or self._differences >= MANY_DIFFERENCES) or now_s < self._calm_until_s:
            return False
        self._calm_s = min(LONGEST_CALM_S, 2 * self._calm_s or 1.0)
        self._calm_until_s = now_s + self._calm_s
        return True


@dataclass(slots=True)
class Neighbours:
    """The table of neighbours, bounded; who acts as no peer gives way to who comes, and comes back when it speaks.

    Attributes
    ----------
    refused : somebody found no room
    """

    by_key: dict[Key, Neighbour] = field(default_factory=dict)
    refused: bool = False
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
        of_name = sum(name == key[0] for name, _ in self.by_key)
        if of_name >= MAX_LIVES or len(self.by_key) >= MAX_NEIGHBOURS:
            nobody = [n for n in self.by_key.values() if not n.steady and (of_name < MAX_LIVES or n.key[0] == key[0])]
            if not nobody:
                self._wait(key)
                return False, None
            # Who has never spoken; of these, whoever was asked most often.
            silent = max(nobody, key=lambda n: (not n.spoke, n.unanswered))
            del self.by_key[silent.key]
            self._wait(silent.key)
        self._waiting.pop(key, None)
        self.by_key[key] = Neighbour(key)
        return True, silent

    def remove(self, key: Key) -> Neighbour | None:
        """Its token vanished; None if it wasn't in the table."""
        self._waiting.pop(key, None)
        return self.by_key.pop(key, None)

    def waits(self, key: Key) -> bool:
        """Whether its token was there, and no room for it."""
        return key in self._waiting

    def _wait(self, key: Key) -> None:
        self.refused = True
        self._waiting[key] = None
        if len(self._waiting) > MAX_WAITING:
            self._waiting.popitem(last=False)

    def say(self, neighbour: Neighbour, claims: dict[Key, Revision]) -> None:
        """What a neighbour says that it holds, instead of what it said before."""
        neighbour.claims, neighbour.listed = claims, True
        if sum(len(n.claims) for n in self.by_key.values()) > MAX_CLAIMS:
            most = max(self.by_key.values(), key=lambda n: len(n.claims))
            most.claims = dict(list(most.claims.items())[: MAX_CLAIMS // MAX_NEIGHBOURS])

    def holders(self, key: Key) -> dict[Key, Revision]:
        """Who says that it holds how much of a stream."""
        return {n.key: n.claims[key] for n in self.by_key.values() if key in n.claims}
