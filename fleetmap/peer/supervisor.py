"""Watches for robots that live but are not linked: Zenoh doesn't retry links that gossip made.

The sign: a robot whose token is gone goes on publishing, and its records come here only through mirrors.
"""

from __future__ import annotations

from dataclasses import dataclass, field

PATIENCE = 3
"""So many records through mirrors are taken for a lost link; the last one of a dying robot is only one."""
PAUSE_S = 30.0
"""At least so long between two attempts: each cuts all links for a moment."""


@dataclass(slots=True)
class LinkSupervisor:
    """Counts records of absent robots, and says when to connect anew."""

    _seen: dict[str, int] = field(default_factory=dict)
    _reopened_s: float = -PAUSE_S

    def linked(self, robot: str) -> None:
        """The robot's token is there."""
        self._seen.pop(robot, None)

    def detour(self, robot: str, now_s: float) -> bool:
        """An absent robot's stream advanced. True when it is time to open the link anew."""
        self._seen[robot] = self._seen.get(robot, 0) + 1
        if self._seen[robot] < PATIENCE or now_s - self._reopened_s < PAUSE_S:
            return False
        self._reopened_s = now_s
        self._seen.clear()
        return True
