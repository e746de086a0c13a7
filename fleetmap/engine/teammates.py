"""Poses and goals: the last ones that each robot announced. A lost one is not repaired."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from fleetmap.codecs.messages import GoalMessage, PoseMessage
from fleetmap.model.errors import WireError

MAX_TEAMMATES = 512


@dataclass(frozen=True, slots=True)
class Teammate:
    """The last pose and goal of a robot, in the map frame of its ``life``; heard when, by the caller's clock."""

    life: int
    pose: PoseMessage | None = None
    goal_mm: tuple[int, int] | None = None
    heard_s: float = 0.0


@dataclass(slots=True)
class Teammates:
    """Bounded store of teammates by name."""

    by_name: dict[str, Teammate] = field(default_factory=dict)

    def hear(self, key: tuple[str, int], message: PoseMessage | GoalMessage, now_s: float) -> None:
        """Note what a life of a robot announced; ``WireError`` when there are too many robots."""
        robot, life = key
        known = self.by_name.get(robot)
        if known is None and len(self.by_name) >= MAX_TEAMMATES:
            raise WireError(robot=robot, size_bytes=0, reason="too many peers")
        if known is None or known.life != life:
            known = Teammate(life)
        if isinstance(message, PoseMessage):
            self.by_name[robot] = replace(known, pose=message, heard_s=now_s)
        else:
            self.by_name[robot] = replace(known, goal_mm=message.goal_mm, heard_s=now_s)

    def gone(self, robot: str) -> None:
        """The robot is absent."""
        self.by_name.pop(robot, None)
