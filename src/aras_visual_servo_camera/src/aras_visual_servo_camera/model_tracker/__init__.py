"""Model-based tracking: the pose of a known solid from its visible edges, and from depth images."""

from .model_tracking import ModelTracking, TrackedPose
from .solid import Solid, read_solid

__all__ = [
    "TrackedPose", "ModelTracking", "Solid", "read_solid",
]  # fmt: skip
