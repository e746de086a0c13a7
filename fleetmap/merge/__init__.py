"""The fold: from all replicas to the merged map."""

from fleetmap.merge.fold import fold
from fleetmap.merge.place import refusal
from fleetmap.merge.protocol import Merger, Source
from fleetmap.merge.verify import Violation, verify

__all__ = ["Merger", "Source", "Violation", "fold", "refusal", "verify"]
