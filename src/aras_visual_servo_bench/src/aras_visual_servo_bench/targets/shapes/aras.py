"""Target of the demo: two plates."""

from ..geometry import ARAS, Target
from .base import SHAPES, TargetShape


@SHAPES.register("aras")
class Plates(TargetShape):
    """Target of the demo: two plates of fixed size."""

    def make(self) -> Target:
        """Return the target with the two plates."""
        return ARAS
