"""Visual servoing schemes, created by name. Most schemes are one or more features with a law."""

from .base import SCHEMES, JointController, Scheme, SchemeOutput
from .feature_scheme import INTERACTIONS, FeatureScheme
from .registry import create_scheme

__all__ = [
    "INTERACTIONS",
    "SCHEMES",
    "FeatureScheme",
    "SchemeOutput",
    "JointController",
    "Scheme",
    "create_scheme",
]
