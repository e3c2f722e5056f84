"""Servoing schemes: which features, and which twist of the camera they ask for."""

from .base import Measurement, Scheme, SchemeResult
from .registry import SCHEMES, create, find

__all__ = ["SCHEMES", "Measurement", "Scheme", "SchemeResult", "create", "find"]
