"""What merging is: sources in, one merged map out, and nothing else read."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

from fleetmap.model.frame import Frame
from fleetmap.model.mergedmap import MergedMap
from fleetmap.model.pose import FixedPose
from fleetmap.model.vectormap import VectorMap


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """One vector map and where it lies in the component's frame.

    Parameters
    ----------
    frame : (robot, life, submap); for reports, and where maps lie too far from (0, 0) for the lattice, for the
        choice of its origin (``merge.origin``). Nothing else of the merged map depends on it
    T_fleet_frame : start @ anchor, composed by the caller in integers
    vector_map : as its author published it
    """

    frame: Frame
    T_fleet_frame: FixedPose
    vector_map: VectorMap


class Merger(Protocol):
    """A pure function of the sources: any order, any repetition, the same bytes on every machine.

    ``fold`` is the one that a fleet uses; others are run beside it to compare.
    """

    def __call__(self, sources: Iterable[Source]) -> MergedMap:
        """Merge; a source that can't be placed is left out: ``MergedMap.left_out`` says which and why."""
        ...
