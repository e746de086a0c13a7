"""What is known of a run while it lasts: what the parent gathers, and what the outcome is made from."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.pose import Pose2
from fleetmap.sims.config import RobotProgress, SimConfig
from fleetmap.sims.worlds import World


@dataclass
class Run:
    """One run, in progress or done.

    Parameters
    ----------
    config, world, starts, reachable : what it is about
    """

    config: SimConfig
    world: World
    starts: list[Pose2]
    reachable: NDArray[np.bool_]
    endpoint: str = ""
    fleet: str = ""
    latest: dict[str, RobotProgress] = field(default_factory=dict)
    series: list[dict[str, RobotProgress]] = field(default_factory=list)
    finished: bool = False
    """Whether exploration ended because nothing was left to explore."""
    converged: bool = False
    sync: dict[str, dict[str, object]] = field(default_factory=dict)
    """Robot -> its digest and revisions at the end."""
    stats: dict[str, dict[str, object]] = field(default_factory=dict)
    """Robot -> its peer's statistics at the end."""
    maps: dict[str, Path] = field(default_factory=dict)
    """Robot -> its merged map."""
    frames: dict[str, str] = field(default_factory=dict)
    """Robot -> whose map frame that has; none where it is the world's."""
    duration_s: float = 0.0

    def T_world_merged(self, robot: str) -> Pose2:  # noqa: N802 - the field's notation
        """Where the frame of a robot's merged map really lies: a robot's map frame begins where it started."""
        return self.T_world_frame(self.frames.get(robot))

    def T_world_frame(self, frame: str | None) -> Pose2:  # noqa: N802 - the field's notation
        """Where the map frame of a robot really lies, or that of the fleet."""
        return Pose2() if frame is None else self.start_of(frame)

    def start_of(self, robot: str) -> Pose2:
        """Where a robot really started."""
        return self.starts[list(self.latest).index(robot)]
