"""Who is listened to, and how much work a name may cause."""

from __future__ import annotations

from collections.abc import Callable, Collection

from fleetmap.codecs.envelope import record_head
from fleetmap.codecs.names import NAME, check_name
from fleetmap.engine.budget import Budget, Budgets
from fleetmap.engine.replica import Replica
from fleetmap.engine.stream import Key
from fleetmap.model.errors import WireError

WORK_BPS, WORK_BURST_BYTES, WORKERS = 256 << 10, 8 << 20, 2048
"""What one name may have a peer decode; a snapshot is 4 MB at most."""
REFUSED_COUNTS = 16
"""What was decoded in vain counts so many times."""
ANYBODY = ""
"""Names that nobody knows share one budget, for there are endlessly many."""


class Guard:
    """Refuses names that are not allowed, and work that nobody has paid for.

    Parameters
    ----------
    robot : own name
    allow : names that are listened to beside it; None: all
    present : whether a life is there, and has ever spoken
    """

    def __init__(self, robot: str, allow: Collection[str] | None, present: Callable[[Key], bool]) -> None:
        self._allow = None if allow is None else {robot, *(check_name("allow", name) for name in allow)}
        self._present = present
        self._work = Budgets(WORK_BPS, WORK_BURST_BYTES, names=WORKERS)

    def allows(self, robot: str) -> bool:
        """Whether a name is one, and is listened to."""
        return NAME.fullmatch(robot) is not None and (self._allow is None or robot in self._allow)

    def payer_of_record(self, key: Key, replica: Replica | None, payload: bytes) -> Budget:
        """Whose work a record is: its author's only if its link shows that.

        Else whoever speaks as that author could use its budget up, and it would be heard no more.
        """
        head = record_head(payload)
        if replica is not None and head is not None and replica.is_next(*head):
            return self._work.of(key[0])
        return self._work.of(ANYBODY)

    def payer_of_reply(self, peer: Key, replica: Replica | None) -> Budget:
        """Whose work an answer is: that of whoever was asked."""
        return self._work.of(peer[0] if replica is not None or self._present(peer) else ANYBODY)

    def check(self, payer: Budget, robot: str, payload: bytes, now_s: float) -> None:
        """``WireError`` if whoever is to pay has nothing left."""
        if payer.left(now_s) <= 0:
            raise WireError(robot=robot, size_bytes=len(payload), reason="claimed: too much work")
