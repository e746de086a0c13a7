"""What is missing, by what the others say that they hold, and whom to ask for it."""

from __future__ import annotations

import math
from collections import OrderedDict, deque
from collections.abc import Callable, Sequence

from fleetmap.accounting import Ledger
from fleetmap.codecs import envelope
from fleetmap.codecs.messages import Heartbeat, Range, Ranges, Revision, Want
from fleetmap.engine.catchup import FIRST_REPLY_TIMEOUT_S, GRACE_S, REPLY_TIMEOUT_S, About, Catchup
from fleetmap.engine.holdings import Holdings
from fleetmap.engine.neighbours import MAX_ROUNDS, Neighbour, Neighbours
from fleetmap.engine.outputs import Ask, Output
from fleetmap.engine.ranges import MOST_RANGES, place, spans
from fleetmap.engine.replica import Replica
from fleetmap.engine.stream import Key, Stream
from fleetmap.engine.votes import most_held

STAGGER_S, LONGEST_STAGGER_S = 0.3, 1.2
"""Between the questions for lists that several tokens at once lead to."""
DOUBT_S = 1.0
"""So long a heartbeat's hash may differ from what is held here: records are on their way to both."""
ALIVE_DOUBT_S = 3.0
"""So long one peer may see somebody come or go after another one did."""
MAX_RECENT = 256
"""Hashes over all that was held here, the last ones: who says one of them is only a little behind, or was."""
ASKED_ABOUT_ONE = 2
RELIST_S = 1.0
"""After so long a list is asked for anew that promised what its sender then didn't have."""


class Asking:
    """Compares what is held with what neighbours claim, and asks.

    Parameters
    ----------
    holdings : the own stream and the replicas
    neighbours : who is there, and what each claims
    alive : the hash over who lives, as it is seen here
    outputs : where questions go
    ledger : counts them

    Attributes
    ----------
    catchup : questions planned and under way
    """

    def __init__(
        self,
        holdings: Holdings,
        neighbours: Neighbours,
        alive: Callable[[], int],
        outputs: list[Output],
        ledger: Ledger,
    ) -> None:
        self._holdings, self._neighbours, self._alive = holdings, neighbours, alive
        self._outputs, self._ledger = outputs, ledger
        self.catchup = Catchup()
        self._recent: OrderedDict[int, int] = OrderedDict()
        self._alive_since: deque[tuple[float, int]] = deque(maxlen=MAX_RECENT)

    # What the others say

    def appeared(self, key: Key, now_s: float) -> None:
        """A token is there: plan to ask what it holds."""
        # One after the other: when the first has been listened to, most of the others hold the same.
        self.catchup.want_list(key, now_s + min(STAGGER_S * self.catchup.lists_waiting, LONGEST_STAGGER_S))

    def heartbeat(self, neighbour: Neighbour, message: Heartbeat, now_s: float) -> None:
        """How far an author is, and the hash over all that it holds."""
        neighbour.held, neighbour.alive, neighbour.heard_s = message.held, message.alive, now_s
        self.claim(neighbour, neighbour.key, message.seq, now_s + GRACE_S)
        agrees = self._agrees(neighbour)
        if not neighbour.listed:
            # It is about to be asked, or has been; now that it can be heard, soon again if that was in vain.
            self.catchup.renewed(About(neighbour.key, None), now_s)
            return
        if not agrees:
            self.catchup.want_list(neighbour.key, neighbour.next_look_s(now_s + DOUBT_S))
        elif not self._sees_the_same(neighbour, now_s):
            self.catchup.want_list(neighbour.key, now_s + DOUBT_S)

    def look_for(self, key: Key, now_s: float) -> None:
        """Somebody is not seen any more: ask some others whether they see it, each peer another two."""
        me = place(self._holdings.own.key)
        others = [n for n in self._neighbours.by_key.values() if n.steady and n.key != key]
        for neighbour in sorted(others, key=lambda n: place(n.key) ^ me)[:ASKED_ABOUT_ONE]:
            neighbour.listed = False
            self.catchup.want_list(neighbour.key, now_s + GRACE_S)

    def listed(self, neighbour: Neighbour, ranges: Sequence[Range], now_s: float) -> None:
        """What a neighbour holds, as the answer to a question."""
        index = self._holdings.index()
        asked, neighbour.further = neighbour.further[:MOST_RANGES], neighbour.further[MOST_RANGES:]
        told = [r for r in ranges if r.rows is not None]
        before = neighbour.rows
        if asked or told:
            # What was asked about and isn't answered is the same.
            inside = spans([*asked, *told])
            neighbour.rows = {key: revision for key, revision in before.items() if not inside(place(key))}
        found = {key: revision for of in told for key, revision in index.differences(of).items()}
        neighbour.rows = neighbour.rows | found
        self._neighbours.bound_rows()
        neighbour.further = sorted([*neighbour.further, *index.ask_further(ranges)], key=lambda r: r.first)
        neighbour.rounds += 1
        if neighbour.further and neighbour.rounds < MAX_ROUNDS:
            self.catchup.want_list(neighbour.key, now_s)
        else:
            neighbour.agreed = self._holdings.changes
            neighbour.compared()
        self.catchup.listed(neighbour.key, neighbour.rows)
        for key, revision in found.items():
            if before.get(key) != revision:
                self.catchup.renewed(About(neighbour.key, key), now_s)
            if revision.seq and self.behind(key):
                # Of an absent author the others may say something else: their lists come first.
                known = key in self._neighbours or key in self._holdings.replicas or key == self._holdings.own.key
                self.catchup.want(key, now_s if known else now_s + GRACE_S)

    def claim(self, neighbour: Neighbour, key: Key, seq: int, due_s: float) -> None:
        """A neighbour shows that it holds so much of a stream; its digest isn't said, and not asked for."""
        known = neighbour.rows.get(key)
        if seq > self._holdings.revision(key).seq and (known is None or known.seq < seq):
            neighbour.rows[key] = Revision(key[1], seq, 0)
            self.catchup.renewed(About(neighbour.key, key), due_s)
        if self.behind(key):
            self.catchup.want(key, due_s)

    def _agrees(self, neighbour: Neighbour) -> bool:
        """Whether a neighbour's last heartbeat says what is held here, or was a little while ago."""
        self._note_held()
        at = self._recent.get(neighbour.held)
        if at is not None:
            neighbour.agree(at)
        return at is not None

    def _note_held(self) -> int:
        """The hash over all that is held now, which counts as one of the last ones from then on."""
        held = self._holdings.held_hash()
        self._recent[held] = self._holdings.changes
        self._recent.move_to_end(held)
        if len(self._recent) > MAX_RECENT:
            self._recent.popitem(last=False)
        return held

    def _sees_the_same(self, neighbour: Neighbour, now_s: float) -> bool:
        """Whether a neighbour's last heartbeat names whom this peer sees, or saw when it came; or was looked into."""
        alive, since = self._alive(), self._alive_since
        if not since or since[-1][1] != alive:
            since.append((now_s, alive))
        if neighbour.asked_alive == (neighbour.alive, alive):
            return True
        ends = [*(at for at, _ in list(since)[1:]), math.inf]
        from_s = neighbour.heard_s - ALIVE_DOUBT_S
        return any(seen == neighbour.alive and end > from_s for (_, seen), end in zip(since, ends, strict=True))

    def announced(self, key: Key, seq: int, due_s: float) -> None:
        """An author's word that can't be used yet shows that there is more."""
        neighbour = self._neighbours.by_key.get(key)
        if neighbour is not None:
            self.claim(neighbour, key, seq, due_s)
            self.catchup.want(key, due_s)

    def dropped(self, stream: Stream) -> None:
        """A stream is held no more; if somebody holds another state of it, that is looked at."""
        self.catchup.stream_gone(stream.key)
        if self.behind(stream.key):
            self.catchup.want(stream.key, 0.0)

    # What is missing

    def lacking(self) -> list[str]:
        """What living peers hold and this one doesn't, in words; what was asked for in vain doesn't count."""
        unlisted = [n.key for n in self._neighbours.by_key.values() if not n.listed and not n.mute]
        claimed = {key for n in self._neighbours.by_key.values() for key in n.rows}
        return [
            *(f"the list of {robot}" for robot, _ in sorted(unlisted)),
            *(
                f"{robot} life {life:016x}"
                for robot, life in sorted(claimed)
                if self.behind((robot, life), waiting=True)
            ),
        ]

    def behind(self, key: Key, *, waiting: bool = False) -> bool:
        """Whether somebody can be asked for more of a stream; ``waiting``: and was not asked for it in vain."""
        return bool(self._holders(key, waiting=waiting))

    def claims(self, key: Key) -> dict[Key, Revision]:
        """Who says that it holds how much of a stream. Any thread may ask."""
        replica = self._holdings.replicas.get(key)
        claims: dict[Key, Revision] = {}
        for n in list(self._neighbours.by_key.values()):
            revision = n.rows.get(key) or (replica.as_of(n.agreed) if replica is not None else None)
            if revision is not None and revision.seq:
                claims[n.key] = revision
        return claims

    def _holders(self, key: Key, *, waiting: bool = False) -> list[Key]:
        """Whom to ask about a stream, in the order of preference: its author, then who holds what most names hold."""
        claims = self.claims(key)
        if waiting:
            claims = {peer: r for peer, r in claims.items() if not self.catchup.in_vain(About(peer, key))}
        own = self._holdings.own
        if key == own.key:
            # Nobody waits for the own words; but a copy of this process may have said more than it.
            return sorted(peer for peer, revision in claims.items() if revision.seq > own.seq and not waiting)
        held, replica = self._holdings.revision(key), self._holdings.replicas.get(key)
        peers = [peer for peer, r in claims.items() if r.seq > held.seq and not self._holdings.was_dropped(key, r)]
        if key in self._neighbours:
            said = claims.get(key)
            # Its own list says other bytes than are held: once for each seq that may set them right.
            other = said is not None and said.digest and said.seq == held.seq and said.digest != held.digest
            if other and replica is not None and not replica.corrected:
                peers.append(key)
        elif replica is not None and not replica.heard:
            best = self._most_held(claims, replica)
            if best is not None and best.digest != held.digest:
                peers += [peer for peer, revision in claims.items() if revision == best]
        return sorted(peers, key=lambda peer: (peer != key, -claims[peer].seq, peer))

    def believed(self, replica: Replica) -> Revision | None:
        """What most say of a stream, if its author is absent."""
        return self._most_held(self.claims(replica.key), replica)

    def _most_held(self, claims: dict[Key, Revision], replica: Replica) -> Revision | None:
        # What is held here only because somebody was the first to offer it is no vote, until it was outvoted once:
        # from then on it is, or two peers would change sides for ever.
        own = self._holdings.own.key
        held = replica.stream.revision
        return most_held({**claims, own: held} if replica.outvoted else claims, held.seq)

    # Questions

    def ask_due(self, now_s: float) -> None:
        """Put the questions that are due."""
        for about in self.catchup.expired(now_s):
            self.in_vain(about, now_s)
        for about in self.catchup.due(now_s, self._holders, self._neighbours.steady):
            robot, life = about.peer
            if about.stream is None:
                neighbour = self._neighbours.by_key[about.peer]
                if neighbour.listed and self._agrees(neighbour) and self._sees_the_same(neighbour, now_s):
                    continue  # it was only behind for a moment
                neighbour.listed, neighbour.asked_alive = False, (neighbour.alive, self._alive())
                kind, payload = "revisions", self._question(neighbour)
            else:
                kind = "snapshot" if about.peer == about.stream else "mirror"
                payload = envelope.encode(self._want(about.stream, about.peer))
            self._ledger.sent("want", len(payload))
            timeout_s = REPLY_TIMEOUT_S if self._neighbours.present(about.peer) else FIRST_REPLY_TIMEOUT_S
            ask_id = self.catchup.sent(about, now_s, timeout_s=timeout_s)
            self._outputs.append(Ask(ask_id, robot, life, kind, payload))

    def in_vain(self, about: About | None, now_s: float) -> None:
        """A question was not answered, or by nothing of use."""
        neighbour = None if about is None else self._neighbours.by_key.get(about.peer)
        if about is None or neighbour is None:
            return
        if about.stream is None:
            neighbour.unanswered += 1
            if not neighbour.listed:
                self.catchup.want_list(neighbour.key, now_s)
        elif not self.catchup.in_vain(about):
            # Perhaps it has dropped the stream since it said that it holds it.
            neighbour.listed = False
            self.catchup.want_list(neighbour.key, now_s + RELIST_S)

    def _want(self, stream: Key, peer: Key) -> Want:
        own, replica = self._holdings.own, self._holdings.replicas.get(stream)
        if stream == own.key:
            return Want(own.robot, own.revision)
        return replica.want(peer) if replica is not None else Want(stream[0], Revision(stream[1], 0, 0))

    def _question(self, neighbour: Neighbour) -> bytes:
        """What to ask somebody who may hold something else: first whether it does."""
        if neighbour.further:
            return envelope.encode(Ranges(tuple(neighbour.further[:MOST_RANGES])))
        return envelope.encode(Heartbeat(self._holdings.own.seq, self._note_held(), self._alive()))
