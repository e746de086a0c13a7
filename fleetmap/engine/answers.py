"""What a peer answers: which streams it keeps, and what somebody lacks of one of them."""

from __future__ import annotations

from collections.abc import Callable

from fleetmap.accounting import Ledger
from fleetmap.codecs import envelope
from fleetmap.codecs.messages import Heartbeat, Living, Message, Ranges, RevisionList, Want
from fleetmap.engine.budget import Budget
from fleetmap.engine.holdings import Holdings
from fleetmap.engine.log import Snapshots, answer
from fleetmap.engine.neighbours import Neighbours
from fleetmap.model.errors import ConfigError, WireError, reason_without_numbers

ANSWER_BPS, ANSWER_BURST_BYTES = 4 << 20, 32 << 20
"""What a peer sends in answers, all together: nobody knows who asks."""
MAX_QUESTION_BYTES = 16 << 10
SHORT_LIST = 16
"""So many streams are listed as they are; of more those are looked for that differ."""


class Answers:
    """Answers questions from what is held, each revision encoded once.

    Parameters
    ----------
    holdings : the own stream and the replicas
    neighbours : who is there
    state : the own heartbeat of now
    ledger : counts questions and answers
    """

    def __init__(
        self, holdings: Holdings, neighbours: Neighbours, state: Callable[[], Heartbeat], ledger: Ledger
    ) -> None:
        self._holdings, self._neighbours, self._state, self._ledger = holdings, neighbours, state, ledger
        self._snapshots = Snapshots()
        self._budget = Budget(ANSWER_BPS, ANSWER_BURST_BYTES)

    def answer(self, kind: str, payload: bytes, now_s: float) -> tuple[bytes, ...]:
        """The replies to a question under the own key ``kind``; none if it makes no sense, or there were too many."""
        self._ledger.received("?", f"{kind}?", len(payload))
        try:
            if kind == "revisions" and len(payload) > MAX_QUESTION_BYTES:
                raise WireError(robot="?", size_bytes=len(payload), reason="too long a question")
            self._budget.spend(len(payload))
            if self._budget.left(now_s) <= 0:
                raise WireError(robot="?", size_bytes=len(payload), reason="too many questions")
            replies = self._list(payload) if kind == "revisions" else self._stream(payload)
        except (WireError, ConfigError) as error:
            self._ledger.dropped("?", f"{kind}?", len(payload), reason=reason_without_numbers(error))
            return ()
        for reply in replies:
            self._budget.spend(len(reply))
            self._ledger.sent("list" if kind == "revisions" else "repair", len(reply))
        return tuple(replies)

    def _list(self, payload: bytes) -> list[bytes]:
        asked = envelope.decode(payload, robot="?") if payload else None
        if isinstance(asked, Ranges):
            return [envelope.encode(Ranges(tuple(self._holdings.index().answer(asked.ranges))))]
        state = self._state()
        replies: list[Message] = []
        same = isinstance(asked, Heartbeat) and asked.held == state.held
        if same or state.pose is not None or state.goal is not None:
            replies.append(state)
        if not same:
            streams = self._holdings.streams()
            if len(streams) <= SHORT_LIST:
                replies.append(RevisionList(tuple((s.robot, s.revision) for s in streams)))
            else:
                replies.append(Ranges(tuple(self._holdings.index().describe())))
        if isinstance(asked, Heartbeat) and asked.alive != state.alive:
            replies.append(Living(tuple(self._neighbours.living(self._holdings.own.key))))
        return [envelope.encode(message) for message in replies]

    def _stream(self, payload: bytes) -> list[bytes]:
        want = envelope.decode(payload, robot="?")
        if not isinstance(want, Want):
            raise WireError(robot="?", size_bytes=len(payload), reason="not a question")
        author, key = self._holdings.author, (want.robot, want.revision.life)
        if key == author.stream.key:
            return answer(author.stream, author.log, want, self._snapshots)
        replica = self._holdings.replicas.get(key)
        if replica is None or not replica.kept:
            raise WireError(robot="?", size_bytes=len(payload), reason="stream not held")
        return answer(replica.stream, replica.log, want, self._snapshots)
