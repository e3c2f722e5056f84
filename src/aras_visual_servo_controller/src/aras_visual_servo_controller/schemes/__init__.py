"""Schemes: what a user names. Most are features with a law."""

from .base import SCHEMES, Decision, JointController, Scheme
from .composed import INTERACTIONS, Composed
from .registry import create_scheme

__all__ = [
    "INTERACTIONS",
    "SCHEMES",
    "Composed",
    "Decision",
    "JointController",
    "Scheme",
    "create_scheme",
]
