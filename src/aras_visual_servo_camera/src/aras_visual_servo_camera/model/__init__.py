"""Model-based tracking: the pose of a known solid from its visible edges, and from depth images."""

from .solid import Solid, read_solid
from .tracking import Found, ModelTracking

__all__ = [
    "Found", "ModelTracking", "Solid", "read_solid",
]  # fmt: skip
