"""What may be spent: a bucket that fills at a steady rate. No clock: who asks says what time it is."""

from __future__ import annotations

import math
from collections import OrderedDict


class Budget:
    """A token bucket. It may be overdrawn once, and is paid off by a longer pause.

    Parameters
    ----------
    rate : units a second
    burst : what is saved up at most
    """

    def __init__(self, rate: float, burst: float) -> None:
        self._rate, self._burst, self._balance, self._counted_s = rate, burst, burst, -math.inf

    def left(self, now_s: float) -> float:
        """What may be spent now; not above 0: nothing."""
        # A clock that was set back adds nothing.
        self._balance = min(self._burst, self._balance + self._rate * max(0.0, now_s - self._counted_s))
        self._counted_s = now_s
        return self._balance

    def spend(self, amount: float) -> None:
        """Note what was spent."""
        self._balance -= amount


class Budgets:
    """One bucket a name; the names that were heard of last have theirs, all others share one.

    A stranger who changes names has no more than one bucket for all but ``names`` of them in a moment.
    """

    def __init__(self, rate: float, burst: float, *, names: int) -> None:
        self._rate, self._burst, self._names = rate, burst, names
        self._by_name: OrderedDict[str, Budget] = OrderedDict()

    def of(self, name: str) -> Budget:
        """The bucket of a name."""
        budget = self._by_name.get(name)
        if budget is None:
            budget = self._by_name[name] = Budget(self._rate, self._burst)
            if len(self._by_name) > self._names:
                self._by_name.popitem(last=False)
        self._by_name.move_to_end(name)
        return budget
