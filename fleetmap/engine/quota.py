"""When an author may send: a byte budget and a highest rate. No clock: who asks says what time it is."""

from __future__ import annotations

import math

from fleetmap.model.checks import check_number

BURST_S = 1.0
"""What was not sent is saved up for so long: after a pause an update may take as much at once."""


class Quota:
    """A token bucket for updates of the map. A large update is sent whole, and paid off by a longer pause.

    Parameters
    ----------
    budget_Bps : payload bytes a second, on average; None: no budget
    max_rate_hz : at most so many updates a second; None: as many as come

    Raises
    ------
    ConfigError : one of them is not above 0
    """

    def __init__(self, budget_Bps: float | None = None, max_rate_hz: float | None = None) -> None:
        for option, value in (("budget_Bps", budget_Bps), ("max_rate_hz", max_rate_hz)):
            if value is not None:
                check_number(option, value, expected="a number above 0", fits=lambda number: number > 0)
        self._budget = budget_Bps
        self._pause_s = 0.0 if max_rate_hz is None else 1 / max_rate_hz
        self._balance = 0.0 if budget_Bps is None else BURST_S * budget_Bps
        self._counted_s = -math.inf
        self._due_s = -math.inf

    def may_send(self, now_s: float) -> bool:
        """Whether an update may go now."""
        if self._budget is not None:
            saved = self._balance + (now_s - self._counted_s) * self._budget
            self._balance = min(saved, BURST_S * self._budget)
            self._counted_s = now_s
        return now_s >= self._due_s and (self._budget is None or self._balance > 0)

    def sent(self, size_bytes: int, now_s: float) -> None:
        """Note an update that went."""
        self._balance -= size_bytes
        self._due_s = now_s + self._pause_s
