"""Visual features s, with their desired values s* and interaction matrices.

The registry `FEATURES` contains them by name. Each module of this folder registers its features
with `FEATURES.register`.
"""

from .base import FEATURES, Feature, FeatureMeasurement, Stack, wrap

__all__ = ["FEATURES", "Feature", "FeatureMeasurement", "Stack", "wrap"]
