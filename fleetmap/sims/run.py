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
    duration_s: float = 0.0
