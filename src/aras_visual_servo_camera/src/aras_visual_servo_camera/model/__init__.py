"""Model-based tracking: the pose of a known solid from its visible edges, and from depth images."""

from .solid import Solid
from .starting import Start
from .tracking import Found, ModelTracking

__all__ = [
    "Found", "ModelTracking", "Solid", "Start",
]
