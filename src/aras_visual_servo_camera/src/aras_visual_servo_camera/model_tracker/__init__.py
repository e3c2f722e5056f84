"""Model-based tracking of a known solid by its visible edges and by depth images."""

from .model_tracking import ModelTracking, TrackedPose
from .solid import Solid, read_solid

__all__ = [
    "TrackedPose", "ModelTracking", "Solid", "read_solid",
]  # fmt: skip
