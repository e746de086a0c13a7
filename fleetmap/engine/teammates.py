"""Poses and goals: the last ones that each robot announced. A lost one is not repaired."""

from __future__ import annotations

from dataclasses import dataclass, field

from fleetmap.codecs.messages import Heartbeat
from fleetmap.model.errors import WireError

MAX_TEAMMATES = 512


@dataclass(frozen=True, slots=True)
class Teammate:
    """The last pose (x mm, y mm, yaw mrad) and goal of a robot, in the map frame of its ``life``; when it was heard."""

    life: int
    pose: tuple[int, int, int] | None = None
    goal_mm: tuple[int, int] | None = None
    heard_s: float = 0.0


@dataclass(slots=True)
class Teammates:
    """Bounded store of teammates by name."""

    by_name: dict[str, Teammate] = field(default_factory=dict)

    def hear(self, key: tuple[str, int], message: Heartbeat, now_s: float) -> None:
        """Note where a life of a robot is, and where it is going; ``WireError`` when there are too many robots."""
        robot, life = key
        if message.pose is None and message.goal is None:
            self.gone(robot)
            return
        if robot not in self.by_name and len(self.by_name) >= MAX_TEAMMATES:
            raise WireError(robot=robot, size_bytes=0, reason="too many peers")
        self.by_name[robot] = Teammate(life, message.pose, message.goal, now_s)

    def gone(self, robot: str) -> None:
        """The robot is absent."""
        self.by_name.pop(robot, None)
