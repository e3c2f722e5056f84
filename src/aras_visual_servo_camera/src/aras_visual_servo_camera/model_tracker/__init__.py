"""Model-based tracking of a known solid by its visible edges and by depth images."""

from .solid import Solid, read_solid
from .solid_tracking import SolidTracking, TrackedPose

__all__ = ["Solid", "SolidTracking", "TrackedPose", "read_solid"]
