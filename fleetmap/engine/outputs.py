"""What the engine gives back: things for the link to do, and events for the user."""

from __future__ import annotations

from dataclasses import dataclass

from fleetmap.codecs.messages import Revision


@dataclass(frozen=True, slots=True)
class Put:
    """Publish ``payload`` under the own robot's key ``suffix``."""

    suffix: str
    payload: bytes


@dataclass(frozen=True, slots=True)
class Ask:
    """Query the key ``robot/suffix``; hand replies and the end of the replies back under ``ask_id``."""

    ask_id: int
    robot: str
    suffix: str
    payload: bytes


@dataclass(frozen=True, slots=True)
class EpochChanged:
    """The own stream goes on under a new epoch: an older life of this name was found in the fleet."""

    epoch: int


@dataclass(frozen=True, slots=True)
class Changed:
    """A stream that the engine holds changed.

    Parameters
    ----------
    frame : (robot, epoch, submap); submap is "" where only the header changed or the stream was dropped
    box_m : (x_min, y_min, x_max, y_max) of the changed edges in metres in the robot's map frame; None if no edge
    edges_added, edges_removed : how many
    revision : what the stream is at now
    """

    frame: tuple[str, int, str]
    box_m: tuple[float, float, float, float] | None
    edges_added: int
    edges_removed: int
    revision: Revision


@dataclass(frozen=True, slots=True)
class PeersChanged:
    """A robot appeared, came back or became absent."""

    robot: str
    alive: bool


@dataclass(frozen=True, slots=True)
class Detour:
    """The stream of a robot that seems absent advanced, through a mirror: the link to it may be broken."""

    robot: str


@dataclass(frozen=True, slots=True)
class NameTaken:
    """Another living peer has the own name, and came first."""


Event = EpochChanged | Changed | PeersChanged | Detour | NameTaken
Output = Put | Ask | Event
