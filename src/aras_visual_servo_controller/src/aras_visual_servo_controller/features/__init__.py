"""Features: what is compared with the goal, and how it moves with the camera.

`FEATURES` has them by name; a module of this folder declares each with `FEATURES.register`.
"""

from .base import FEATURES, Feature, FeatureMeasurement, Stack, wrap

__all__ = ["FEATURES", "Feature", "FeatureMeasurement", "Stack", "wrap"]
