"""Model-based tracking: the pose of a known solid from its visible edges, and from depth images."""

from .solid import Solid
from .starting import Start
from .tracker import ModelTracker, model_tracker, read_solid
from .tracking import Found, ModelTracking

__all__ = [
    "Found", "ModelTracker", "ModelTracking", "Solid", "Start", "model_tracker", "read_solid",
]  # fmt: skip
