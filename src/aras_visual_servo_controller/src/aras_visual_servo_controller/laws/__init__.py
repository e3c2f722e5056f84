"""Control laws: how fast each error should shrink. One file a law, `LAWS` has them by name."""

from .base import LAWS, Law, create_law
from .proportional import Proportional

__all__ = ["LAWS", "Law", "Proportional", "create_law"]
