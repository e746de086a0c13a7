"""Grid to vector map and back, and the independent check of it."""

from fleetmap.vectorize.rasterize import rasterize
from fleetmap.vectorize.vectorizer import Vectorizer, vectorize
from fleetmap.vectorize.verify import Dropped, VerifyReport, Violation, verify

__all__ = ["Dropped", "Vectorizer", "VerifyReport", "Violation", "rasterize", "vectorize", "verify"]
