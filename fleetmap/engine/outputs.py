"""What the engine gives back: things for the link to do, and events for the user."""

from __future__ import annotations

from dataclasses import dataclass

from fleetmap.codecs.messages import Revision
from fleetmap.engine.inputs import Replying


@dataclass(frozen=True, slots=True)
class Put:
    """Publish ``payload`` under the own robot's key ``kind``, as the word of a life."""

    life: int
    kind: str
    payload: bytes


@dataclass(frozen=True, slots=True)
class Ask:
    """Query ``kind`` of a life of a robot; hand replies and the end of the replies back under ``ask_id``."""

    ask_id: int
    robot: str
    life: int
    kind: str
    payload: bytes


@dataclass(frozen=True, slots=True)
class Answer:
    """Reply to a question: ``reply`` is what came with it, to be told whether that is all."""

    reply: Replying
    payloads: tuple[bytes, ...]
    last: bool = True


@dataclass(frozen=True, slots=True)
class LifeChanged:
    """The own stream goes on in another life: the one before had said all the revisions that a life has."""

    life: int


@dataclass(frozen=True, slots=True)
class MapChanged:
    """A stream that the engine keeps changed.

    Parameters
    ----------
    frame : (robot, life, submap); submap is "" where only facts changed or the stream was dropped
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
    """A robot appeared, came back or became absent; ``via``: it is heard by way of that one alone."""

    robot: str
    alive: bool
    via: str = ""


@dataclass(frozen=True, slots=True)
class LookAgain:
    """There is room for peers whose tokens were refused before: look which are there."""


Event = LifeChanged | MapChanged | PeersChanged | LookAgain
Output = Put | Ask | Answer | Event
