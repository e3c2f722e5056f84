"""Control laws: how fast each error should shrink."""

from .base import Law
from .dynamic import ProportionalIntegral, SlidingMode
from .proportional import Adaptive, Diagonal, Proportional
from .registry import LAWS, create_law
from .wrappers import ContinuousStart, Ramp

__all__ = [
    "LAWS",
    "Adaptive",
    "ContinuousStart",
    "Diagonal",
    "Law",
    "Proportional",
    "ProportionalIntegral",
    "Ramp",
    "SlidingMode",
    "create_law",
]
