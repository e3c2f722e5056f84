"""Control laws: how fast each error should shrink. One file a law, `LAWS` has them by name."""

from .base import LAWS, Law
from .proportional import Proportional
from .registry import create_law

__all__ = ["LAWS", "Law", "Proportional", "create_law"]
