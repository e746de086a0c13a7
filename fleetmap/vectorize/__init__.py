"""Grid to vector map and back, and the independent check of it."""

from fleetmap.vectorize.paper_method import vectorize_by_paper
from fleetmap.vectorize.rasterize import rasterize
from fleetmap.vectorize.specks import drop_specks
from fleetmap.vectorize.vectorizer import PROFILES, Vectorizer, vectorize
from fleetmap.vectorize.verify import Dropped, VerifyReport, Violation, verify

__all__ = [
    "PROFILES",
    "Dropped",
    "Vectorizer",
    "VerifyReport",
    "Violation",
    "drop_specks",
    "rasterize",
    "vectorize",
    "vectorize_by_paper",
    "verify",
]
