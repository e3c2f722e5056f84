"""Target of the demo: two plates."""

from ..geometry import ARAS, Target
from .base import SHAPES, TargetShape


@SHAPES.register("aras")
class Plates(TargetShape):
    """The two plates of the demo, of fixed size."""

    def make(self) -> Target:
        """Return the plates."""
        return ARAS
