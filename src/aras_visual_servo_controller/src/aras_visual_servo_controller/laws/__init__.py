"""Control laws, which compute the desired rate of each error.

The registry `LAWS` contains them by name.
"""

from .base import LAWS, Law, create_law
from .proportional import Proportional

__all__ = ["LAWS", "Law", "Proportional", "create_law"]
