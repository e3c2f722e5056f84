"""Visual servoing schemes, which are created by name.

Most schemes consist of one or more features and a control law.
"""

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
