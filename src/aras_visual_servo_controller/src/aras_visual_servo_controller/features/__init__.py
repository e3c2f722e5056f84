"""Features: what is compared with the goal, and how it moves with the camera."""

from .base import Feature, Measured, Stack, wrap
from .registry import FEATURES, create_feature

__all__ = ["FEATURES", "Feature", "Measured", "Stack", "create_feature", "wrap"]
