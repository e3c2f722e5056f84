"""Visual features s, with their desired values s* and interaction matrices.

`FEATURES` lists them by name; each module of this folder registers its own with
`FEATURES.register`.
"""

from .base import FEATURES, Feature, FeatureMeasurement, Stack, wrap

__all__ = ["FEATURES", "Feature", "FeatureMeasurement", "Stack", "wrap"]
