"""Independent checks: rooms that make something don't check it themselves. Imports the model alone."""

from fleetmap.verify.drawn import find_openings

__all__ = ["find_openings"]
