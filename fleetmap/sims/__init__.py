"""Simulated fleets: real processes and real links in a simulated world."""

from fleetmap.sims.config import Death, Progress, RobotProgress, SimConfig, SimResult
from fleetmap.sims.fleet import run_fleet

__all__ = ["Death", "Progress", "RobotProgress", "SimConfig", "SimResult", "run_fleet"]
