"""What is missing, by what the others say that they hold, and whom to ask for it."""

from __future__ import annotations

from fleetmap.accounting import Ledger
from fleetmap.codecs import envelope
from fleetmap.codecs.messages import Heartbeat, Revision, Want
from fleetmap.engine.catchup import FIRST_REPLY_TIMEOUT_S, GRACE_S, REPLY_TIMEOUT_S, About, Catchup
from fleetmap.engine.holdings import Holdings
from fleetmap.engine.neighbours import Neighbour, Neighbours
from fleetmap.engine.outputs import Ask, Output
from fleetmap.engine.replica import Replica
from fleetmap.engine.stream import Key, Stream
from fleetmap.engine.votes import most_held

STAGGER_S, LONGEST_STAGGER_S = 0.3, 1.2
"""Between the questions for lists that several tokens at once lead to."""
RELIST_S = 1.0
"""After so long a list is asked for anew that promised what its sender then didn't have."""


class Asking:
    """Compares what is held with what neighbours claim, and asks.

    Parameters
    ----------
    holdings : the own stream and the replicas
    neighbours : who is there, and what each claims
    outputs : where questions go
    ledger : counts them

    Attributes
    ----------
    catchup : questions planned and under way
    """

    def __init__(self, holdings: Holdings, neighbours: Neighbours, outputs: list[Output], ledger: Ledger) -> None:
        self._holdings, self._neighbours = holdings, neighbours
        self._outputs, self._ledger = outputs, ledger
        self.catchup = Catchup()
        self._same: tuple[int, dict[Key, Revision]] = (-1, {})

    # What the others say

    def appeared(self, key: Key, now_s: float) -> None:
        """A token is there: plan to ask what it holds."""
        # One after the other: when the first has been listened to, most of the others hold the same.
        self.catchup.want_list(key, now_s + min(STAGGER_S * self.catchup.lists_waiting, LONGEST_STAGGER_S))

    def heartbeat(self, neighbour: Neighbour, message: Heartbeat, now_s: float, *, asked: bool = False) -> None:
        """How far an author is, and the hash over all that it holds; ``asked``: as the answer to a question."""
        key, held = neighbour.key, self._holdings.held_hash()
        if message.held == held:
            # It holds what is held here, whatever its last list said.
            neighbour.claims, neighbour.listed = self._same_as_here(held), True
        known = neighbour.claims.get(key)
        if known is None or known.seq != message.seq:
            # Its digest isn't said, and not asked for as long as the seq is right.
            neighbour.claims = {**neighbour.claims, key: Revision(key[1], message.seq, 0)}
            self.catchup.renewed(About(key, key), now_s)
        if self.behind(key):
            self.catchup.want(key, now_s + GRACE_S)
        if asked and message.held != held:
            # It answered that it holds the same; meanwhile something was said.
            self.catchup.want_list(key, now_s + GRACE_S)
        elif not asked and neighbour.differs(message.held, held, now_s):
            neighbour.listed = False
            self.catchup.want_list(key, now_s)

    def listed(self, neighbour: Neighbour, claims: dict[Key, Revision], now_s: float) -> None:
        """All that a neighbour says that it holds."""
        before = neighbour.claims
        self._neighbours.say(neighbour, claims)
        self.catchup.listed(neighbour.key, neighbour.claims)
        for key, revision in claims.items():
            if before.get(key) != revision:
                self.catchup.renewed(About(neighbour.key, key), now_s)
            if self.behind(key):
                # Of an absent author the others may say something else: their lists come first.
                known = key in self._neighbours or key in self._holdings.replicas or key == self._holdings.own.key
                self.catchup.want(key, now_s if known else now_s + GRACE_S)

    def announced(self, key: Key, seq: int, due_s: float) -> None:
        """An author's word that can't be used yet shows that there is more."""
        neighbour = self._neighbours.by_key.get(key)
        if neighbour is not None:
            known = neighbour.claims.get(key)
            if known is None or known.seq < seq:
                neighbour.claims = {**neighbour.claims, key: Revision(key[1], seq, 0)}
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
        claimed = {key for n in self._neighbours.by_key.values() for key in n.claims}
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

    def _holders(self, key: Key, *, waiting: bool = False) -> list[Key]:
        """Whom to ask about a stream, in the order of preference: its author, then who holds what most names hold."""
        claims = self._neighbours.holders(key)
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
        return self._most_held(self._neighbours.holders(replica.key), replica)

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
                # Who holds the same says so, and no list.
                kind, message = "revisions", Heartbeat(self._holdings.own.seq, self._holdings.held_hash())
                payload = envelope.encode(message)
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

    def _same_as_here(self, held: int) -> dict[Key, Revision]:
        """What a list of this peer would say; one for all neighbours that hold the same."""
        if self._same[0] != held:
            self._same = (held, {s.key: s.revision for s in self._holdings.streams()})
        return self._same[1]
