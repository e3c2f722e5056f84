"""Control laws, which compute the desired rate of each error.

The registry `LAWS` contains them by name.
"""

from .base import LAWS, Law
from .proportional import Proportional
from .wrappers import create_law

__all__ = ["LAWS", "Law", "Proportional", "create_law"]
